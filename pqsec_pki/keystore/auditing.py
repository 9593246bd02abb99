"""Checks that the ledger is intact and has a line for each issued file of the keystore."""

import hashlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors, read
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import (
    FileError,
    MissingError,
    PqsecError,
    VerificationError,
    located,
)
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._chain import START, Entry, Line, problems
from pqsec_pki.keystore._ledger import PLACE
from pqsec_pki.keystore._replaced_cas import expected_cas
from pqsec_pki.keystore.anchoring import head_problems, ledger_tree, read_anchors
from pqsec_pki.keystore.heads import other_sets
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.overlap import TRUST, trusted_last

_WORDS = {
    **dict.fromkeys(("identity-ca", "permissions-ca"), "CA certificate"),
    "participant": "certificate",
    "crl": "list",
}
"""What a file is, if its line has another word."""


def audit(
    keystore: Keystore, head: str | None = None, anchors: Path | None = None
) -> tuple[int, str]:
    """The number of lines and the newest chain value, if no problem is found.

    The chain must be complete from the first line. Every certificate, signed document and list
    in the keystore must have a line, the newest one unless other machines use this ledger (then
    see `older_copies`). `head`, from an earlier audit, must be in the chain, and the tree must have
    all signed heads: the newest one, and those in the folder `anchors`. VerificationError lists all
    problems.

    Someone who may write the ledger can replace it by another complete one: to detect that,
    keep heads elsewhere (anchoring.py).
    """
    keystore = keystore.as_found
    if anchors and not anchors.is_dir():
        raise FileError(f"{anchors} is not a folder", hint="`pqsec log --anchor` makes one")
    lines, there = keystore.lines(), read_anchors(anchors) if anchors else {}
    if anchors and not there:  # an empty or unmounted folder proves nothing
        raise FileError(
            f"{anchors} has no heads to compare with",
            hint="name the folder that has them; `pqsec log --anchor` writes the newest one",
        )
    broken = [*problems(lines), *_head_problems(lines, head)]
    found = [*broken, *_other_sets(keystore)]
    for each in keystore.sets:
        found += _unknown(each, [line for line in lines if line.entry.set_name == each.set_name])
    if there or not broken:  # a broken chain says more than the newest head
        found += head_problems(keystore, ledger_tree(keystore), there)
    if found:
        raise VerificationError(
            *found,
            hint="compare it with a backup: an earlier copy was put back, or somebody with write"
            " access changed it",
        )
    return len(lines), lines[-1].chain if lines else START


def _other_sets(keystore: Keystore) -> Iterator[str]:
    """The error if the settings name other sets of credentials than the ledger has."""
    with keystore.open_ledger() as ledger:
        if wrong := other_sets(keystore.root, ledger):
            yield str(wrong)


def _head_problems(lines: list[Line], head: str | None) -> Iterator[str]:
    if head is not None and head.lower() not in {START, *(line.chain for line in lines)}:
        yield "the head is not in the ledger: lines up to it were removed or rewritten"


def older_copies(keystore: Keystore) -> list[Path]:
    """The files that are of an earlier line of the ledger than the newest about them.

    Another machine with this ledger made them again since, or somebody put an earlier copy back.
    With other machines, the next change gets the governance and the list; `CurrentFiles` uses no
    older file. Errors as of `audit`.
    """
    keystore = keystore.as_found
    lines, found = keystore.lines(), list[Path]()
    with disk_errors(keystore.root):
        for each in keystore.sets:
            own = [line for line in lines if line.entry.set_name == each.set_name]
            newest = _Newest.of(each, own)
            found += [path for path, *what in _issued(each) if newest.is_beyond(path, *what)]
    return found


@dataclass(frozen=True, slots=True)
class _Newest:
    """The newest lines about the files of one set."""

    numbers: dict[tuple[str, str], int]
    """The number of each line, by its kind and SHA-256."""
    last: dict[tuple[str, str], int]
    """The number of the newest line of a kind and name."""
    cas: dict[str, list[str]]
    """The certificates that each file of CAs must have."""

    @classmethod
    def of(cls, keystore: Keystore, lines: Sequence[Line]) -> Self:
        entries = [(line.number, line.entry) for line in lines]
        with keystore.open_ledger() as ledger:
            cas = expected_cas(ledger, keystore.profile)
        return cls(
            {(each.kind, each.sha256): number for number, each in entries},
            {(each.kind, _own_name(each)): number for number, each in entries},
            cas,
        )

    def is_beyond(self, path: Path, kind: str, name: str) -> bool:
        """Whether the file at `path` is of an earlier line than the newest one about that file."""
        try:
            hashes = _hashes(path)
        except PqsecError:  # `audit` reports it
            return False
        if path.name in self.cas:
            known = all((kind, each) in self.numbers for each in hashes)
            return known and hashes != self.cas[path.name]
        here = self.numbers.get((kind, hashes[0]), 0)
        return 0 < here < self.last.get((kind, name), 0)


def _own_name(entry: Entry) -> str:
    """The name of the participant whose file it is about, also if it was signed by hand."""
    place = entry.details.get(PLACE)
    return entry.name if place is None else place.removeprefix(layout.ENCLAVES)


def _unknown(keystore: Keystore, lines: list[Line]) -> Iterator[str]:
    """The files of the set that have none of these lines, which are about it, or a wrong one."""
    entries = [line.entry for line in lines]
    known = {(each.kind, _line_name(each.kind, each.name), each.sha256) for each in entries}
    trusted, shared = trusted_last(entries), keystore.ledger_address is not None
    newest = None if shared else _Newest.of(keystore, lines)
    with disk_errors(keystore.root):
        for path, kind, name in _issued(keystore):
            try:
                hashes = _hashes(path)
            except MissingError:
                continue
            except FileError:
                raise  # an unreadable file may still be right
            except PqsecError as error:
                yield str(error)
                continue
            if any((kind, _line_name(kind, name), each) not in known for each in hashes):
                yield f"{path} is not in the ledger"
            elif len(hashes) > 1 and not _is_trusted(path, entries, trusted, shared=shared):
                yield f"{path} has {len(hashes)} certificates, but the ledger has one"
            elif newest and newest.is_beyond(path, kind, name):
                yield f"{path} is not the newest {_WORDS.get(kind, kind)} in the ledger"


def _line_name(kind: str, name: str) -> str:
    """The name that a file's line must have; empty if it may be any, as `pqsec sign` gave it."""
    return name if kind == "participant" else ""


def _is_trusted(
    path: Path, entries: Sequence[Entry], trusted: Entry | None, *, shared: bool
) -> bool:
    """Whether it is the file of two CAs of the present overlap, or if others share the ledger, of
    an earlier step."""
    sha256 = hashlib.sha256(read(path)).hexdigest()
    files = {each.sha256 for each in entries if each.kind == TRUST}
    return sha256 in files if shared else trusted is not None and trusted.sha256 == sha256


def _issued(keystore: Keystore) -> Iterator[tuple[Path, str, str]]:
    """The path of each file, the kind of its line, and the participant's name, if it has one."""
    public, enclaves = keystore.folder / layout.PUBLIC, keystore.folder / layout.ENCLAVES
    yield public / layout.IDENTITY_CA, "identity-ca", ""
    yield public / layout.PERMISSIONS_CA, "permissions-ca", ""
    yield public / layout.PERMISSIONS_ALT_CA, "permissions-ca", ""
    yield public / layout.CA_LIST, "crl", ""
    yield enclaves / layout.GOVERNANCE, "governance", ""
    for name in keystore.names():
        folder = keystore.folder / layout.enclave_folder(name)
        yield folder / layout.CERTIFICATE, "participant", name
        yield folder / layout.PERMISSIONS, "permissions", name


def _hashes(path: Path) -> list[str]:
    """SHA-256 as in the ledger: of each certificate's DER, or of any other file.

    All certificates of a file count: Fast DDS trusts every certificate in a CA's file.
    """
    data = read(path)
    if path.name.endswith(layout.CERTIFICATE):
        with located(path):
            return [each.fingerprint for each in Certificate.all_from_pem(data)]
    return [hashlib.sha256(data).hexdigest()]
