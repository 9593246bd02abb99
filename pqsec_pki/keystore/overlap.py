"""The state of an overlap, in which two identity CAs are trusted.

Both certificates are in public/identity_ca.cert.pem, which every enclave links to: the issuing
CA first, then the other. Stacks that read only the first one are not affected
(docs/explanation/adr/0010-two-identity-cas-in-one-file.md).
"""

import hashlib
from collections.abc import Collection, Sequence
from dataclasses import field
from datetime import datetime
from enum import StrEnum
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import read
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import KeystoreError, located
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore.keystore import Keystore


class Phase(StrEnum):
    """The phase of an overlap."""

    BEGUN = "begun"
    """Both are trusted, and the old one issues."""
    SWITCHED = "switched"
    """Both are trusted, and the new one issues."""


TRUST, TRUST_END = "trust", "trust-end"
"""The kinds of ledger lines for a file of two trusted identity CAs: the first says that it was
written; the second, with the same hash, that it is no longer valid."""
WAIT = "no CA can be replaced before the overlap ends"
_NEXT_STEPS = {
    Phase.BEGUN: "continue with `{rotate} --overlap switch`, or undo it with `{rotate} --overlap"
    " cancel`",
    Phase.SWITCHED: "end it with `{rotate} --overlap finish`",
}


@dataclass(frozen=True, slots=True)
class Overlap:
    """The two identity CAs that the participants trust."""

    phase: Phase
    issuing: Certificate
    other: Certificate
    rotate: str = field(default="pqsec ca rotate", compare=False)
    """The command that makes the next step."""

    @classmethod
    def of(cls, keystore: Keystore) -> Self | None:
        """The keystore's overlap; None if it trusts one identity CA.

        It is also None if the file is not the one in the ledger's newest line, or that overlap
        has ended: then only the first certificate counts. Errors as of `load_first_certificate`,
        and KeystoreError for a damaged ledger.
        """
        path = keystore.folder / layout.PUBLIC / layout.IDENTITY_CA
        with located(path):
            data = read(path)
            found = Certificate.all_from_pem(data)
        if len(found) != 2:  # noqa: PLR2004 -- the two generations
            return None
        with keystore.open_ledger() as ledger:
            line = trusted_last((*ledger.of_kind(TRUST), *ledger.of_kind(TRUST_END)))
        if line is None or line.sha256 != hashlib.sha256(data).hexdigest():
            return None
        try:
            phase = Phase(line.details.get("overlap", ""))
        except ValueError as error:
            raise line.damaged(str(error)) from None
        return cls(phase, *found, rotate=rotate_command(keystore))

    @classmethod
    def that_is(cls, keystore: Keystore, phase: Phase) -> Self:
        """The keystore's overlap; KeystoreError if there is none, or in another phase."""
        found = cls.of(keystore)
        if found is None:
            raise KeystoreError(
                "the keystore trusts one identity CA: no overlap has begun",
                hint=f"begin one with `{rotate_command(keystore)} --overlap begin`",
            )
        if found.phase is not phase:
            raise KeystoreError(f"the overlap is {found.phase}", hint=found.next_step)
        return found

    @property
    def next_step(self) -> str:
        """The commands that continue or end the overlap, for a hint."""
        return _NEXT_STEPS[self.phase].format(rotate=self.rotate)


def rotate_command(keystore: Keystore) -> str:
    """The command that replaces CAs of this set of credentials."""
    several = len(keystore.profiles) > 1
    return f"pqsec ca rotate --set {keystore.profile.name}" if several else "pqsec ca rotate"


def refuse_overlap(keystore: Keystore, why: str) -> None:
    """KeystoreError if two identity CAs are trusted; `why` says why that prevents the action."""
    overlap = Overlap.of(keystore)
    if overlap:
        raise KeystoreError(f"two identity CAs are trusted: {why}", hint=overlap.next_step)


def trust_file(authorities: Sequence[Certificate]) -> bytes:
    """The content of public/identity_ca.cert.pem for these CAs, the issuing CA first."""
    return b"".join(each.pem for each in authorities)


def trust_entry(overlap: Overlap, now: datetime, *, end: str = "") -> Entry:
    """The ledger entry for the file of both CAs; `end` is how the overlap ended, if it did."""
    sha256 = hashlib.sha256(trust_file((overlap.issuing, overlap.other))).hexdigest()
    kind, details = TRUST_END if end else TRUST, {"overlap": end or overlap.phase.value}
    return Entry.of(kind, overlap.issuing.subject_name, sha256, now, details=details)


def trusted_last(entries: Collection[Entry]) -> Entry | None:
    """The newest entry for a file of two CAs; None if that overlap has ended.

    `entries` are ordered from the oldest to the newest.
    """
    lines = [each for each in entries if each.kind == TRUST][-1:]
    ended = {each.sha256 for each in entries if each.kind == TRUST_END}
    return next((each for each in lines if each.sha256 not in ended), None)
