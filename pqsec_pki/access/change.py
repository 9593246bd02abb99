"""What changes from one policy to another, as values with their words."""

from dataclasses import dataclass
from enum import StrEnum

from pqsec_pki.access._topics import Topics
from pqsec_pki.access.question import Action


class Sense(StrEnum):
    """Which way something changes."""

    GRANTED = "granted"
    TAKEN = "taken away"
    WEAKER = "weaker"
    STRONGER = "stronger"
    OTHER = "otherwise"
    """Neither more nor less, or not comparable."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """One change; `text` says all of it, the rest is what a program may ask for."""

    sense: Sense
    text: str
    subject: str = ""
    """Whose rights change; empty for governance, which is for all."""
    actions: tuple[Action, ...] = ()
    topics: tuple[Topics, ...] = ()
    domains: str = ""
    interpretation: str = "spec"
    """By whose reading of the documents; `stacks` where that is for each stack to say."""


@dataclass(frozen=True, slots=True)
class Difference:
    """All that changes.

    `complete` is False if the patterns can meet in more ways than were tried: what is told
    is true, and there may be more. `same_text` says that the two hold equal values.
    """

    changes: tuple[Change, ...]
    complete: bool
    same_text: bool = False
