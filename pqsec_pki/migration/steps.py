"""The values of a migration plan."""

from collections.abc import Iterator

from pqsec_pki._dataclass import dataclass
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
    """The profile before the step; of several sets of credentials all, with commas."""
    after: str
    """The profile after it; the same if only the robots change."""
    commands: tuple[str, ...]
    at_once: bool
    """Whether the domain stops meanwhile; else robots change one by one."""
    stacks: tuple[StackNeeds, ...] = ()
    mixed: str
    """What robots before and after the step can do with each other."""
    lost: tuple[str, ...] = ()
    """What is protected less against quantum computers after it."""
    if_skipped: tuple[str, ...]
    """What breaks without it."""
    added: tuple[str, ...] = ()
    """What is there in addition after it, and for which participants."""
    removed: tuple[str, ...] = ()
    back: tuple[str, ...] = ()
    """How to go back to the state before, if something is added."""
    reissued: int = 0
    """Participants that pqsec reissues."""
    left_out: dict[str, str]
    """Participants that are not reissued, and why."""
    level: int
    """NIST category of traffic after the step; 0 if it can be recorded and decrypted later."""

    @property
    def how(self) -> str:
        """In which order robots change."""
        return "stop the domain, change all robots, start it" if self.at_once else "robot by robot"

    def facts(self) -> Iterator[tuple[str, str]]:
        """The step in words: (kind, text) of each fact."""
        yield from (("lost", each) for each in self.lost)
        yield from (("adds", each) for each in self.added)
        yield from (("removes", each) for each in self.removed)
        yield from (("run", each) for each in self.commands)
        yield from (("needs", f"{each.stack}: {each.needs}") for each in self.stacks)
        yield "mixed", self.mixed
        yield from (("skipped", each) for each in self.if_skipped)
        yield from (("back", each) for each in self.back)
        if self.reissued:
            plural = "" if self.reissued == 1 else "s"
            yield "reissues", f"{self.reissued} participant{plural}"
        yield from (("not", f"{name}: {why}") for name, why in self.left_out.items())
        yield "level", f"{self.level} of traffic after the step (NIST category; 0: none)"

    def lines(self, number: int) -> Iterator[str]:
        """The step as text: its title, and a line for each fact."""
        yield f"{number}. {self.title} ({self.how})"
        yield from (f"   {kind:8} {text}" for kind, text in self.facts())


@dataclass(frozen=True, slots=True, kw_only=True)
class MigrationPlan:
    """The steps from a keystore's profile to another, or to several; names as in a step."""

    before: str
    target: str
    steps: tuple[MigrationStep, ...]
    deadlines: tuple[Deadline, ...] = DEADLINES

    def to_json(self) -> dict[str, object]:
        """The plan for programs."""
        return {
            "from": self.before,
            "to": self.target,
            "steps": self.steps,
            "deadlines": [
                {"date": each.day.isoformat(), "what": each.what, "source": each.source}
                for each in self.deadlines
            ],
        }
