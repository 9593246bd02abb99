"""The values of a migration plan."""

from dataclasses import dataclass

from pqsec_pki.migration.deadlines import DEADLINES, Deadline


@dataclass(frozen=True, slots=True, kw_only=True)
class StackNeeds:
    """What robots with one stack need for a step."""

    stack: str
    """Its product, with the version if that matters."""
    needs: str
    """What to do there; "nothing" if it runs unmodified."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MigrationStep:
    """One step: a command, or work on every robot. The next begins when it is complete."""

    title: str
    commands: tuple[str, ...]
    at_once: bool
    """Whether the domain stops meanwhile; else robots change one by one."""
    stacks: tuple[StackNeeds, ...] = ()
    mixed: str
    """What robots before and after the step can do with each other."""
    if_skipped: tuple[str, ...]
    """What breaks without it."""
    reissued: int = 0
    """Participants that pqsec reissues."""
    left_out: dict[str, str]
    """Participants that are not reissued, and why."""
    level: int
    """NIST category of traffic after the step; 0 if it can be recorded and decrypted later."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MigrationPlan:
    """The steps from a keystore's profile to another."""

    before: str
    target: str
    steps: tuple[MigrationStep, ...]
    deadlines: tuple[Deadline, ...] = DEADLINES
