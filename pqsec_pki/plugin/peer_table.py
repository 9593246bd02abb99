"""The peers and handshakes that the authentication plugin remembers.

Any host on the network can be discovered as a peer with any number of GUIDs, and can begin
handshakes with a certificate that it has seen. Therefore unfinished peers and handshakes are
limited (`pending.py`), and old ones are dropped. A peer with a finished handshake stays until
Cyclone DDS returns it, unless a newer handshake with it is finished too.
"""

import os
from collections.abc import Callable, Iterator
from dataclasses import field
from datetime import datetime

from pqsec_pki._dataclass import dataclass
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import VerificationError
from pqsec_pki.handshake import CHALLENGE_SIZE, Done, IdentityToken, ReplySent, RequestSent
from pqsec_pki.plugin.handles import Handles
from pqsec_pki.plugin.identity import Local
from pqsec_pki.plugin.participant import Participant
from pqsec_pki.plugin.pending import MAX_HELD, PendingReplies, Rates

MAX_WAITING = 4096
"""Peers that have not authenticated. As many may join a domain at a time."""
MAX_EARLIER = 8
"""Earlier Requests of ours for which a late Reply may still come."""


@dataclass(slots=True)
class PeerState:
    """The state between a local participant and a peer, before and during their handshake."""

    said: IdentityToken = field(default_factory=IdentityToken)
    """The IdentityToken that the peer announced in discovery."""
    announced: bytes | None = None
    """The challenge in our AuthRequest, if we sent one."""
    heard: bytes | None = None
    """The challenge in the peer's AuthRequest, if it sent one."""
    handshake: int | None = None
    """The handle of the latest handshake."""


@dataclass(slots=True, eq=False)
class Remote:
    """A peer that was discovered, by one or more of our participants."""

    guid: bytes
    states: dict[int, PeerState] = field(default_factory=dict)
    """Handle of the local identity -> state."""


@dataclass(slots=True, eq=False)
class Handshake:
    """The state of a handshake. A refused message does not change it.

    A new Request, ours or the peer's, starts it again. The finished handshake stays valid until the
    new one is finished too, because any process on the network can send a Request.
    """

    identity: int
    """The handle of the local participant."""
    remote: int
    """The handle of the peer's identity."""
    asked: RequestSent | None = None
    """Our latest Request, which waits for a Reply."""
    asked_by: Local | None = None
    """The set of that Request."""
    earlier: list[bytes] = field(default_factory=list)
    """dh1 of earlier Requests, which the latest one replaces."""
    answer: ReplySent | None = None
    """Our latest Reply, which waits for a Final."""
    number: int = 0
    """The number of that Reply in `PendingReplies`."""
    done: Done | None = None


class PeerTable:
    """The peers and handshakes of a connection; `note` is called when a limit is reached."""

    def __init__(
        self, handles: Handles, answers: PendingReplies, note: Callable[[str], None]
    ) -> None:
        self._handles, self._answers, self._note = handles, answers, note
        self._remotes: dict[bytes, int] = {}
        """The handle of the latest peer with that GUID."""
        self._waiting: dict[int, None] = {}
        """The handles of peers that have not authenticated, the oldest first."""
        self._rates: dict[int, Rates] = {}
        """Handle of the local identity -> rates."""
        self._challenges: dict[tuple[int, bytes], bytes] = {}
        """Handle of the local identity and GUID of the peer -> the announced challenge."""

    def peer_state(self, identity: int, guid: bytes) -> tuple[int, PeerState]:
        """The handle of a peer, and a new state. A peer that is discovered again by the same local
        participant gets another handle, because the stack still has to return the old one."""
        handle = self._remotes.get(guid)
        known = self._handles.get(handle, Remote) if handle else None
        if handle is None or known is None or identity in known.states:
            self._make_room()
            known = Remote(guid)
            handle = self._remotes[guid] = self._handles.add(known)
            self._waiting[handle] = None
        peer_state = known.states[identity] = PeerState()
        return handle, peer_state

    def challenge(self, identity: int, guid: bytes) -> bytes:
        """Our challenge for an AuthRequest: 32 bytes, the same until a handshake is finished.

        A stack that loses a peer and discovers it again starts a new handshake, but the peer may
        not, and refuses another challenge than the one that it got first until its handshake times
        out.
        """
        found = self._challenges.pop((identity, guid), None) or os.urandom(CHALLENGE_SIZE)
        self._challenges[identity, guid] = found
        if len(self._challenges) > MAX_WAITING:
            del self._challenges[next(iter(self._challenges))]
        return found

    def met(self, identity: int, peer: int) -> tuple[Participant, Remote, PeerState]:
        """The two, and the state between them; VerificationError if they have not met."""
        local, remote = self._handles.get(identity, Participant), self._handles.get(peer, Remote)
        if identity not in remote.states:
            raise VerificationError("a handshake with a peer that was not validated")
        return local, remote, remote.states[identity]

    def refuse_early(self, identity: int, certificate: Certificate, now: datetime) -> None:
        """VerificationError if too many Requests were answered lately for that certificate."""
        self._rates.setdefault(identity, Rates()).refuse_early(certificate, now)

    def asked(self, local: Local, identity: int, peer: int, state: RequestSent) -> int:
        """Record the Request of that set, in place of an earlier one: the handshake's handle."""
        handle, handshake = self._handshake(identity, peer)
        if handshake.asked:
            handshake.earlier = [*handshake.earlier, handshake.asked.request.dh1][-MAX_EARLIER:]
        handshake.asked, handshake.asked_by = state, local
        return handle

    def answered(self, identity: int, peer: int, state: ReplySent, now: datetime) -> int:
        """Record our Reply, in place of an earlier one: the handshake's handle."""
        handle, handshake = self._handshake(identity, peer)
        certificate = state.peer.certificate
        self._rates.setdefault(identity, Rates()).count(certificate, now)
        self._forget_answer(handshake)

        def end() -> None:
            handshake.answer = None
            if not (handshake.asked or handshake.done):
                self._handles.drop(handle)

        document = self._answers.one_copy(certificate, state.peer.permissions)
        handshake.answer = state.sharing(document)
        handshake.number = self._answers.add(certificate, document, end)
        if self._answers.make_room():
            self._note(
                f"handshakes that wait for a Final hold more than {MAX_HELD >> 20} MiB: of the"
                " certificate with the most, the largest handshake is dropped"
            )
        return handle

    def finished(self, handshake: Handshake, done: Done) -> None:
        """Record that the peer has authenticated."""
        self._forget_answer(handshake)
        handshake.asked, handshake.done = None, done
        self._answers.proved(done.peer.certificate, done.peer.permissions)
        self._waiting.pop(handshake.remote, None)
        remote = self._handles.find(handshake.remote, Remote)
        if remote is not None:
            self._challenges.pop((handshake.identity, remote.guid), None)

    def authenticated(self) -> Iterator[tuple[int, int, Certificate]]:
        """For each authenticated peer: (handle of the local identity, of the peer's,
        certificate)."""
        for _, handshake in self._handles.all(Handshake):
            if handshake.done:
                yield handshake.identity, handshake.remote, handshake.done.peer.certificate

    def drop(self, handle: int) -> None:
        """Forget a participant or a peer, with its handshakes."""
        gone = self._handles.drop(handle)
        self._waiting.pop(handle, None)
        self._rates.pop(handle, None)
        states: list[PeerState | None] = []
        if isinstance(gone, Participant):
            for key in [each for each in self._challenges if each[0] == handle]:
                del self._challenges[key]
            states = [each.states.pop(handle, None) for _, each in self._handles.all(Remote)]
        elif isinstance(gone, Remote):
            states = list(gone.states.values())
            if self._remotes.get(gone.guid) == handle:
                del self._remotes[gone.guid]
        for peer_state in states:
            if peer_state and peer_state.handshake:
                self.drop_handshake(peer_state.handshake)

    def drop_handshake(self, handle: int) -> None:
        """Forget the handshake, in any state."""
        handshake = self._handles.find(handle, Handshake)
        if handshake is not None:
            self._handles.drop(handle)
            self._forget_answer(handshake)

    def drop_all(self) -> None:
        """Forget all handshakes."""
        for handle, _ in self._handles.all(Handshake):
            self.drop_handshake(handle)

    def _forget_answer(self, handshake: Handshake) -> None:
        self._answers.drop(handshake.number)
        handshake.answer = None

    def _make_room(self, newest: int = 0) -> None:
        """Drop the oldest unauthenticated peers if there is no room for one, or for `newest`."""
        while len(self._waiting) >= MAX_WAITING and not newest:
            self._note(
                f"more than {MAX_WAITING} peers have not authenticated: the oldest is dropped"
            )
            self.drop(next(iter(self._waiting)))
        while self._handles.are_many:
            oldest = next((each for each in self._waiting if each != newest), None)
            if oldest is None:
                return
            self._note("too many peers and handshakes: the oldest unauthenticated peer is dropped")
            self.drop(oldest)

    def _handshake(self, identity: int, peer: int) -> tuple[int, Handshake]:
        """The handle and the handshake of the two; a new one if there is none."""
        _, _, peer_state = self.met(identity, peer)
        if peer_state.handshake is not None:
            handshake = self._handles.find(peer_state.handshake, Handshake)
            if handshake is not None:
                return peer_state.handshake, handshake
        self._make_room(peer)
        handshake = Handshake(identity, peer)
        peer_state.handshake = self._handles.add(handshake)
        return peer_state.handshake, handshake
