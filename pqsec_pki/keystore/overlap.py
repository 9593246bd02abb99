"""Two identity CAs trusted at once: what a keystore says of that.

Both certificates stand in public/identity_ca.cert.pem, which every enclave links to: first
the CA that issues, behind it the other. Stacks that read the first one only go on as
before (docs/adr/0010-two-identity-cas-in-one-file.md).
"""

import hashlib
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Self

from pqsec_pki._files import read
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import KeystoreError, located
from pqsec_pki.keystore import _layout
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore.keystore import Keystore


class Phase(StrEnum):
    """How far an overlap is."""

    BEGUN = "begun"
    """Both are trusted, and the old one issues."""
    SWITCHED = "switched"
    """Both are trusted, and the new one issues."""


TRUST, TRUST_END = "trust", "trust-end"
"""The kinds of the ledger's lines on a file of two trusted identity CAs: that it was written,
and, with the same hash, that it counts no more."""
WAIT = "no CA makes way for another before that has come to its end"
_WAY_ON = {
    Phase.BEGUN: "`pqsec ca rotate --overlap switch` goes on, and `--overlap cancel` back",
    Phase.SWITCHED: "`pqsec ca rotate --overlap finish` ends it",
}


@dataclass(frozen=True, slots=True)
class Overlap:
    """Whom the participants trust, while they trust two."""

    phase: Phase
    issuing: Certificate
    other: Certificate

    @classmethod
    def of(cls, keystore: Keystore) -> Self | None:
        """The keystore's; None if it has one identity CA.

        Of several certificates that are not what the ledger says last, or says the end of,
        only the first counts: others put them there. Errors as of `load_first_certificate`, and
        KeystoreError for a damaged ledger.
        """
        path = keystore.root / _layout.PUBLIC / _layout.IDENTITY_CA
        with located(path):
            data = read(path)
            found = Certificate.all_from_pem(data)
        if len(found) != 2:  # noqa: PLR2004 -- the two generations
            return None
        with keystore.open_ledger() as ledger:
            line = trusted_last((*ledger.of_kind(TRUST), *ledger.of_kind(TRUST_END)))
        if line is None or line.sha256 != hashlib.sha256(data).hexdigest():
            return None
        return cls(Phase(line.details["overlap"]), *found)

    @classmethod
    def that_is(cls, keystore: Keystore, phase: Phase) -> Self:
        """The keystore's; KeystoreError if it has none, or is not as far or further."""
        found = cls.of(keystore)
        if found is None:
            raise KeystoreError(
                "the keystore trusts one identity CA: no overlap has begun",
                hint="begin one with `pqsec ca rotate --overlap begin`",
            )
        if found.phase is not phase:
            raise KeystoreError(f"the overlap is {found.phase}", hint=found.way_on)
        return found

    @property
    def way_on(self) -> str:
        """What ends it, for a hint."""
        return _WAY_ON[self.phase]


def refuse_overlap(keystore: Keystore, what: str) -> None:
    """KeystoreError if two identity CAs are trusted, and `what` has to wait for the end."""
    overlap = Overlap.of(keystore)
    if overlap:
        raise KeystoreError(f"two identity CAs are trusted: {what}", hint=overlap.way_on)


def trust_file(authorities: Sequence[Certificate]) -> bytes:
    """What public/identity_ca.cert.pem holds when these are trusted, the one that issues first."""
    return b"".join(each.pem for each in authorities)


def trust_entry(overlap: Overlap, now: datetime, *, end: str = "") -> Entry:
    """The ledger's line on that file of both; `end` says how it ended, if it did."""
    both = trust_file((overlap.issuing, overlap.other))
    return Entry(
        at=now.isoformat(timespec="seconds"),
        kind=TRUST_END if end else TRUST,
        name=overlap.issuing.subject_name,
        serial=None,
        sha256=hashlib.sha256(both).hexdigest(),
        not_after=None,
        details={"overlap": end or overlap.phase.value},
    )


def trusted_last(entries: Collection[Entry]) -> Entry | None:
    """The newest line on a file of two CAs, the oldest first; None if that has ended."""
    lines = [each for each in entries if each.kind == TRUST][-1:]
    ended = {each.sha256 for each in entries if each.kind == TRUST_END}
    return next((each for each in lines if each.sha256 not in ended), None)
