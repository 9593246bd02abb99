"""What the authentication plugin remembers of peers, and of handshakes with them."""

from dataclasses import dataclass, field

from pqsec_pki.handshake import Done, ReplySent, RequestSent
from pqsec_pki.plugin.identity import Local


@dataclass(slots=True)
class Relation:
    """What passed between a local participant and a peer before and in their handshake."""

    announced: bytes | None = None
    """The challenge in our AuthRequest, if we sent one."""
    heard: bytes | None = None
    """That in the peer's."""
    handshake: int | None = None
    """The handle of the latest."""


@dataclass(slots=True, eq=False)
class Remote:
    """A peer that was discovered, by one or more of our participants."""

    guid: bytes
    relations: dict[int, Relation] = field(default_factory=dict)
    """By the handle of the local identity."""


@dataclass(slots=True)
class Handshake:
    """Where a handshake stands. A message that is refused leaves it there."""

    local: Local
    remote: int
    """The handle of the peer's identity."""
    state: RequestSent | ReplySent | Done
