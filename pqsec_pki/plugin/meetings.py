"""What the authentication plugin remembers of peers, and of handshakes with them.

Anyone on the network can be discovered as a peer by as many GUIDs as it likes, and whoever
heard a certificate can begin handshakes with it. So those that wait have limits, and the
oldest of them make room; who has finished a handshake stays until Cyclone DDS returns it.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import VerificationError
from pqsec_pki.handshake import Done, ReplySent, RequestSent
from pqsec_pki.plugin.handles import Handles
from pqsec_pki.plugin.identity import Local

MAX_WAITING = 4096
"""Peers that have not authenticated. As many may join a domain at a time."""
MAX_ANSWERED = 1024
"""Handshakes that wait for a Final; each keeps what the Request carried."""


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
    identity: int
    """Its handle."""
    remote: int
    """The handle of the peer's identity."""
    state: RequestSent | ReplySent | Done


class Meetings:
    """The peers and handshakes of a connection; `note` is told when a limit is reached."""

    def __init__(self, handles: Handles, note: Callable[[str], None]) -> None:
        self._handles, self._note = handles, note
        self._remotes: dict[bytes, int] = {}
        """The handle of the latest peer with that GUID."""
        self._waiting: dict[int, None] = {}
        """The handles of peers that have not authenticated, the oldest first."""
        self._answered: dict[int, None] = {}
        """The handles of handshakes that were answered, the oldest first."""

    def relation(self, identity: int, guid: bytes) -> tuple[int, Relation]:
        """A fresh one. A peer that one of ours has met already was lost and found again:
        it gets another handle, because the former is still to be returned."""
        handle = self._remotes.get(guid)
        known = self._handles.get(handle, Remote) if handle else None
        if handle is None or known is None or identity in known.relations:
            self._make_room()
            known = Remote(guid)
            handle = self._remotes[guid] = self._handles.add(known)
            self._waiting[handle] = None
        relation = known.relations[identity] = Relation()
        return handle, relation

    def met(self, identity: int, peer: int) -> tuple[Local, Remote, Relation]:
        """VerificationError if they have not."""
        local, remote = self._handles.get(identity, Local), self._handles.get(peer, Remote)
        if identity not in remote.relations:
            raise VerificationError("a handshake with a peer that was not validated")
        return local, remote, remote.relations[identity]

    def asked(self, relation: Relation, handshake: Handshake) -> int:
        """The handle of a handshake that was begun, in the place of an earlier one."""
        handle = self._begun(relation, handshake)
        self._answered.pop(handle, None)
        return handle

    def answered(self, relation: Relation, handshake: Handshake) -> int:
        """The handle of a handshake that waits for a Final, in the place of an earlier one."""
        handle = self._begun(relation, handshake)
        self._answered.pop(handle, None)
        self._answered[handle] = None
        if len(self._answered) > MAX_ANSWERED:
            self._note(f"more than {MAX_ANSWERED} handshakes wait for a Final: the oldest ends")
            self.drop_handshake(next(iter(self._answered)))
        return handle

    def finished(self, handle: int, handshake: Handshake) -> None:
        """The peer has authenticated."""
        self._answered.pop(handle, None)
        self._waiting.pop(handshake.remote, None)

    def authenticated(self) -> Iterator[tuple[int, int, Certificate]]:
        """Who has: the handles of the local identity and of the peer's, and its certificate."""
        for _, handshake in self._handles.all(Handshake):
            if isinstance(handshake.state, Done):
                yield handshake.identity, handshake.remote, handshake.state.peer.certificate

    def drop(self, handle: int) -> None:
        """A participant is gone, or a peer, and their handshakes with it."""
        gone = self._handles.drop(handle)
        self._waiting.pop(handle, None)
        relations: list[Relation | None] = []
        if isinstance(gone, Local):
            relations = [each.relations.pop(handle, None) for _, each in self._handles.all(Remote)]
        elif isinstance(gone, Remote):
            relations = list(gone.relations.values())
            if self._remotes.get(gone.guid) == handle:
                del self._remotes[gone.guid]
        for relation in relations:
            if relation and relation.handshake:
                self.drop_handshake(relation.handshake)

    def drop_handshake(self, handle: int) -> None:
        """It ends, however far it came."""
        self._answered.pop(handle, None)
        self._handles.drop(handle)

    def _make_room(self, newest: int = 0) -> None:
        """For a peer, or a handshake with `newest`: the oldest that wait are lost."""
        while len(self._waiting) >= MAX_WAITING and not newest:
            self._note(f"more than {MAX_WAITING} peers have not authenticated: the oldest is lost")
            self.drop(next(iter(self._waiting)))
        while self._handles.are_many:
            oldest = next((each for each in self._waiting if each != newest), None)
            if oldest is None:
                return
            self._note("more peers and handshakes than fit: the oldest not authenticated is lost")
            self.drop(oldest)

    def _begun(self, relation: Relation, handshake: Handshake) -> int:
        if relation.handshake is None:
            self._make_room(handshake.remote)
            relation.handshake = self._handles.add(handshake)
        else:
            self._handles.replace(relation.handshake, handshake)
        return relation.handshake
