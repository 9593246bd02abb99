"""What was seen in a domain: participants and their endpoints."""

from pathlib import Path
from typing import NamedTuple

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access import Action


class Endpoint(NamedTuple):
    """A writer or reader that was seen."""

    domain: int
    action: Action
    """PUBLISH or SUBSCRIBE."""
    topic: str
    """Its DDS name."""
    partitions: tuple[str, ...] = ()
    """Empty for the default partition."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenParticipant:
    """A participant, or all those with the same name."""

    name: str
    """Its enclave; without one the first of its nodes; empty if it has neither."""
    label: str = ""
    """Another name: its entity name or its process."""
    nodes: tuple[str, ...] = ()
    """The full names of its ROS 2 nodes."""
    endpoints: frozenset[Endpoint] = frozenset()


class UnreadLine(NamedTuple):
    """A line that cannot be read."""

    path: Path
    line: int
    reason: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.reason}"


class NotProposed(NamedTuple):
    """Something that was seen, and why it is not proposed."""

    what: str
    reason: str
