"""A check of one requirement of ROS 2."""

from pqsec_pki._dataclass import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """A requirement that ROS 2 would check too late, or without a message."""

    what: str
    problem: str = ""
    """What is wrong; empty if nothing is."""
    fix: str = ""
    """How to fix it."""

    def to_json(self) -> dict[str, object]:
        """The requirement for --json."""
        return {"what": self.what, "ok": self.ok, "problem": self.problem, "fix": self.fix}

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return not self.problem
