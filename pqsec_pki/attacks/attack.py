"""An attack: one row of the table, and the row acts."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import StrEnum

from pqsec_pki.attacks._scene import Attempt, Scene
from pqsec_pki.selfcheck.encounter import Encounter


class Attacker(StrEnum):
    """Who attacks, by what it has."""

    ON_THE_WAY = "on the way"
    """Reads and changes whatever is sent; has no key."""
    OUTSIDER = "outsider"
    """Has what was ever sent, and keys and certificates of its own making."""
    QUANTUM = "quantum computer"
    """An outsider who has found the classical keys, but not the post-quantum ones."""
    INSIDER = "insider"
    """Is a participant of the domain."""


def _anywhere(encounter: Encounter) -> str | None:
    del encounter
    return None


def two_keys(encounter: Encounter) -> str | None:
    if encounter.profile.alternative_key:
        return None
    return f"participants of profile {encounter.profile.name} have one key"


@dataclass(frozen=True, slots=True, kw_only=True)
class Attack:
    """One way to attack two who would meet."""

    name: str
    """What a user types."""
    attacker: Attacker
    title: str
    """What the attacker does, in words for who is no expert."""
    refused_at: tuple[str, ...]
    """Where it has to fail: a word of the name of the step."""
    act: Callable[[Scene], Iterator[Attempt]] = field(repr=False)
    pointless: Callable[[Encounter], str | None] = field(default=_anywhere, repr=False)
    """Why it is none for those two, if it is none."""
