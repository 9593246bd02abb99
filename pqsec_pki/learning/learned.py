"""What was learned from recordings: a proposal, and how it differs from a keystore."""

from collections.abc import Iterable, Mapping
from datetime import datetime

from pqsec_pki._dataclass import dataclass
from pqsec_pki.keystore import Keystore
from pqsec_pki.learning.comparing import Comparisons, compare
from pqsec_pki.learning.proposing import Proposal, document_of, propose
from pqsec_pki.learning.recording import Recording
from pqsec_pki.learning.seen import NotProposed, UnreadLine


@dataclass(frozen=True, slots=True)
class Learned:
    """The proposals, what is not in them, and the differences to a keystore, if there is one."""

    proposals: tuple[Proposal, ...]
    differences: Comparisons | None
    left_out: tuple[NotProposed, ...]
    unread: tuple[UnreadLine, ...]

    @property
    def ok(self) -> bool:
        """Whether nothing that was seen is known not to be granted."""
        return self.differences is None or self.differences.ok

    def document(self, head: Iterable[str], notes: Mapping[str, Iterable[str]]) -> str:
        """The proposals in YAML with these comments, as of document_of; empty if there are none."""
        return document_of(self.proposals, head, notes) if self.proposals else ""

    def to_json(self) -> dict[str, object]:
        """All but the proposals, which are a document."""
        return {
            "participants": self.differences.comparisons if self.differences else None,
            "never_seen": self.differences.never_seen if self.differences else None,
            "left_out": [each._asdict() for each in self.left_out],
            "unread": [each._asdict() for each in self.unread],
        }


def learn(
    recording: Recording, keystore: Keystore | None, *, validity: str, now: datetime
) -> Learned:
    """Propose permissions for all that was recorded, valid for a duration such as `90d`.

    They are compared with those of the keystore. FileError if it cannot be read.
    """
    found = propose(recording.participants, validity=validity, now=now)
    return Learned(
        proposals=found.proposals,
        differences=compare(keystore, found.proposals, now=now) if keystore else None,
        left_out=(*recording.left_out, *found.left_out),
        unread=recording.unread,
    )
