"""One thing that ROS 2 needs, and whether it has it."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """A question that ROS 2 would answer too late, or in silence."""

    what: str
    problem: str = ""
    """What is wrong; empty if nothing is."""
    fix: str = ""
    """The way out."""

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return not self.problem
