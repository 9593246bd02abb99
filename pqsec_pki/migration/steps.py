"""The values of a migration plan."""

from collections.abc import Iterator
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
    before: str
    """The profile before the step."""
    after: str
    """The profile after it; the same if only the robots change."""
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

    def lines(self, number: int) -> Iterator[str]:
        """The step in words: its title, and a line for each fact."""
        how = "stop the domain, change all robots, start it" if self.at_once else "robot by robot"
        yield f"{number}. {self.title} ({how})"
        yield from (f"   run      {each}" for each in self.commands)
        yield from (f"   needs    {each.stack}: {each.needs}" for each in self.stacks)
        yield f"   mixed    {self.mixed}"
        yield from (f"   skipped  {each}" for each in self.if_skipped)
        if self.reissued:
            plural = "" if self.reissued == 1 else "s"
            yield f"   reissues {self.reissued} participant{plural}"
        yield from (f"   not      {name}: {why}" for name, why in self.left_out.items())
        yield f"   level    {self.level} of traffic after the step (NIST category; 0: none)"


@dataclass(frozen=True, slots=True, kw_only=True)
class MigrationPlan:
    """The steps from a keystore's profile to another."""

    before: str
    target: str
    steps: tuple[MigrationStep, ...]
    deadlines: tuple[Deadline, ...] = DEADLINES
