"""The changes from one policy to another, as values and as text."""

from enum import StrEnum

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access._topics import Topics
from pqsec_pki.access.question import Action


class Sense(StrEnum):
    """The direction of a change."""

    GRANTED = "granted"
    TAKEN = "taken away"
    WEAKER = "weaker"
    STRONGER = "stronger"
    OTHER = "otherwise"
    """Neither more nor less, or not comparable."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """One change; `text` says all of it, the other fields are for programs."""

    sense: Sense
    text: str
    subject: str = ""
    """The subject whose rights change; empty for governance, which applies to all."""
    actions: tuple[Action, ...] = ()
    topics: tuple[Topics, ...] = ()
    domains: str = ""
    interpretation: str = "spec"
    """The interpretation that changes; `stacks` if it depends on the stack."""


@dataclass(frozen=True, slots=True)
class Difference:
    """All that changes.

    `complete` is False if the patterns can match in more ways than were tried: the changes are
    real, and there may be more. `same_text` means that both documents have equal values.
    """

    changes: tuple[Change, ...]
    complete: bool
    same_text: bool = False
