"""Compares what was seen with the permissions in a keystore."""

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access import Difference, Sense, permissions_diff
from pqsec_pki.documents import Permissions, parse_subject, same_subject
from pqsec_pki.keystore import Keystore
from pqsec_pki.learning.proposing import Proposal
from pqsec_pki.policy import own_permissions


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """One participant: its proposal, and its permissions in the keystore."""

    name: str
    known: bool
    """Whether it is in the keystore; if not, nothing is granted to it."""
    not_granted: tuple[str, ...]
    """What was seen and is not granted."""
    never_seen: tuple[str, ...]
    """What is granted and was never seen."""
    complete: bool
    """Whether nothing else differs; patterns can be too many to compare all."""


@dataclass(frozen=True, slots=True)
class Comparisons:
    """All comparisons."""

    comparisons: tuple[Comparison, ...]
    never_seen: tuple[str, ...]
    """Participants of the keystore that were never seen."""

    @property
    def ok(self) -> bool:
        """Whether everything that was seen is granted."""
        return not any(each.not_granted for each in self.comparisons)


def compare(keystore: Keystore, proposals: Sequence[Proposal], *, now: datetime) -> Comparisons:
    """Compare each proposal with the participant's permissions. Signatures are not checked.

    Validity is not compared. FileError if a permissions document cannot be read.
    """
    names = set(keystore.names())
    comparisons = tuple(_compared(keystore, each, names, now) for each in proposals)
    never = names - {each.name for each in proposals}
    return Comparisons(comparisons, tuple(sorted(never)))


def _compared(keystore: Keystore, proposal: Proposal, names: set[str], now: datetime) -> Comparison:
    known = proposal.name in names
    granted = own_permissions(keystore, proposal.name, now, None).value if known else None
    difference = permissions_diff(granted, _alike(proposal, granted))
    return Comparison(
        name=proposal.name,
        known=known,
        not_granted=_texts(difference, Sense.GRANTED),
        never_seen=_texts(difference, Sense.TAKEN),
        complete=difference.complete,
    )


def _alike(proposal: Proposal, granted: Permissions | None) -> Permissions:
    """The proposal with the subject and the validity of the grant that it is compared with."""
    grant = proposal.grant
    subject = parse_subject(grant.subject_name)
    grants = granted.grants if granted else ()
    for each in grants:
        if len(grants) == 1 or same_subject(parse_subject(each.subject_name), subject):
            return Permissions(grants=(replace(each, rules=grant.rules, default=grant.default),))
    return Permissions(grants=(grant,))


def _texts(difference: Difference, sense: Sense) -> tuple[str, ...]:
    return tuple(dict.fromkeys(e.text for e in difference.changes if e.sense is sense))
