"""The number of a bundle: that of the newest ledger line among its files, of all sets.

It needs no counter, so a user who may only read a keystore can write bundles. Each change of a
participant's files adds lines, so the number grows with it.
"""

import hashlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import field
from functools import cache, partial
from typing import TYPE_CHECKING, Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import KeystoreError, MalformedError
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._ledger import Ledger
from pqsec_pki.keystore._shared_files import pem_fingerprint
from pqsec_pki.keystore.current_files import CurrentFiles
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.overlap import TRUST, TRUST_END

if TYPE_CHECKING:
    from pqsec_pki.keystore.proofs import LedgerProofs
    from pqsec_pki.transparency import MerkleTree

_KINDS = (
    *("identity-ca", "permissions-ca", "participant"),
    *("permissions", "governance", "crl", TRUST),
)
"""The kinds of lines about files that are in bundles."""
MAX_NUMBER = (1 << 63) - 1
"""The largest number of a row in SQLite, and so of a ledger line."""


@dataclass(frozen=True, slots=True)
class BundleNumbers:
    """The ledger's lines about files, for all bundles that are made at once."""

    line_of: Callable[[str], int | None] = field(repr=False)
    """The number of a line, by its SHA-256; 0 or None for none."""
    least: int
    """The line that ended the last overlap, which put an older CA file into every enclave; 0 if
    there is none."""
    proofs: "LedgerProofs | None" = field(default=None, repr=False)
    """The proofs for bundles; None if there are none, or they were not asked for."""
    current: Mapping[str, CurrentFiles] = field(default_factory=dict, repr=False)
    """The files for bundles, by the set of credentials; empty if they were not asked for."""

    @classmethod
    @contextmanager
    def of(cls, keystore: Keystore, tree: "MerkleTree | None" = None) -> Iterator[Self]:
        """Numbers, files and proofs for bundles; KeystoreError if the ledger is damaged.

        `tree` is as in `LedgerProofs.of`.
        """
        from pqsec_pki.keystore.proofs import LedgerProofs  # noqa: PLC0415 -- `status` makes none

        with keystore.open_ledger() as ledger:
            proofs = LedgerProofs.of(keystore.root, ledger, tree)
            current = {each.set_name: CurrentFiles.within(each, ledger) for each in keystore.sets}
            least = _least([each.ledger for each in current.values()])
            yield cls(cache(partial(ledger.line_of, _KINDS)), least, proofs, current)

    @classmethod
    def among(cls, keystore: Keystore, ledger: Ledger) -> Self:
        """The numbers for all robots at once; all are read from the ledger now."""
        sets = [ledger.of(each.set_name) for each in keystore.sets]
        lines = {
            sha256: line
            for each in sets
            for kind in _KINDS
            for sha256, line in each.numbers(kind).items()
        }
        return cls(lines.get, _least(sets))

    def sets_of(self, names: Collection[str]) -> tuple[Keystore, ...]:
        """The sets of credentials that a bundle for these participants has, the first one first.

        A participant that has no certificate in a set, by the ledger, waits for a request.
        KeystoreError if others in `names` have one there: on their robot the set is needed.
        """
        first, *others = self.current.values()
        found = [first.keystore]
        for each in others:
            lacking = [name for name in names if not each.ledger.count("participant", name)]
            if lacking and len(lacking) < len(names):
                raise KeystoreError(
                    f"{', '.join(lacking)} has no certificate in the set of credentials"
                    f" {each.keystore.set_name}, and others of this bundle have one",
                    hint="write a bundle for each",
                )
            found += [] if lacking else [each.keystore]
        return tuple(found)

    def files(self, name: str, set_name: str = layout.FIRST) -> dict[str, bytes]:
        """The files for that participant's bundle, of one set; errors as of
        `CurrentFiles.enclave`."""
        if not self.current:
            raise ValueError("these numbers are not for bundles")
        return self.current[set_name].enclave(name)

    def number_of(self, enclaves: Iterable[Mapping[str, bytes]]) -> int | None:
        """The number of a bundle with these enclaves, as of `number`."""
        return max(filter(None, map(self.number, enclaves)), default=None)

    def number(self, files: Mapping[str, bytes]) -> int | None:
        """The number of a bundle with these files of an enclave, by name.

        None if the ledger knows none of them.
        """
        found = [line for each in _hashes(files) if (line := self.line_of(each))]
        return max(*found, self.least) if found else None


def _least(ledgers: Iterable[Ledger]) -> int:
    """The newest end of an overlap, by the ledger for each set."""
    return max((line for each in ledgers for line in each.numbers(TRUST_END).values()), default=0)


def bundle_number(value: object) -> int | None:
    """A bundle's number as JSON has it, if any; MalformedError if no ledger line can have it."""
    if value is None or (type(value) is int and 0 < value <= MAX_NUMBER):
        return value
    raise MalformedError("the bundle's number is not the number of a ledger line")


def _hashes(files: Mapping[str, bytes]) -> Iterator[str]:
    """SHA-256 of the files as in the ledger: of a certificate's DER, or of any file."""
    for name, data in files.items():
        if name.endswith(layout.CERTIFICATE):
            yield pem_fingerprint(data) or ""
        yield hashlib.sha256(data).hexdigest()
