"""What an attacker knows, and what it tries.

It recorded an earlier handshake of the two participants. In their next handshake it is on
the way between them, or in the place of one of them. An attempt is that second handshake.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from pqsec_pki.handshake import DataHolder, GenericMessage
from pqsec_pki.selfcheck import HandshakeSession, Relay, Sent, SessionSide

Impersonation = Callable[[SessionSide, SessionSide], SessionSide]
"""Takes the side that is impersonated and its peer, and returns the attacker's side."""


class Attempt(NamedTuple):
    """One handshake with an attacker in it."""

    what: str
    session: HandshakeSession
    attacker: str | None = None
    """The participant it impersonates. A refusal by that side does not count."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AttackContext:
    """A session of two participants, and all messages of an earlier run."""

    session: HandshakeSession
    recorded: tuple[Sent, ...] = field(repr=False)

    def message(self, name: str, occurrence: int = 1) -> bytes:
        """The recorded message of that name; if both send one, the initiator's is occurrence 1."""
        return [each.data for each in self.recorded if each.name == name][occurrence - 1]

    def token(self, name: str, occurrence: int = 1) -> DataHolder:
        """The token in the recorded message of that name."""
        return token_in(self.message(name, occurrence))

    def value(self, message: str, name: str) -> bytes:
        """A binary property of the recorded message."""
        return value_in(self.message(message), name)

    def between(self, what: str, *relays: Relay) -> Attempt:
        """An attempt by an attacker on the way: each message goes through all `relays`."""

        def relay(name: str, data: bytes) -> bytes:
            for each in relays:
                data = each(name, data)
            return data

        return Attempt(what, replace(self.session, relay=relay))

    def impersonating(self, what: str, impersonation: Impersonation) -> Iterator[Attempt]:
        """Attempts with the attacker in the place of the initiator, then of the replier."""
        yield self.as_initiator(what, impersonation)
        yield self.as_replier(what, impersonation)

    def as_initiator(self, what: str, impersonation: Impersonation) -> Attempt:
        """The attempt with the attacker as initiator."""
        one, other = self.session.sides
        impersonated = replace(self.session, initiator=impersonation(one, other))
        return Attempt(f"{what}, as initiator", impersonated, one.name)

    def as_replier(self, what: str, impersonation: Impersonation) -> Attempt:
        """The attempt with the attacker as replier."""
        one, other = self.session.sides
        impersonated = replace(self.session, replier=impersonation(other, one))
        return Attempt(f"{what}, as replier", impersonated, other.name)


def with_identity(side: SessionSide, **changes: Any) -> SessionSide:
    """`side` with a changed identity: certificate, key, GUID or permissions."""
    own = replace(side.terms.own, **changes)
    return replace(side, terms=replace(side.terms, own=own))


def token_in(sample: bytes) -> DataHolder:
    """The token of a message sample."""
    return GenericMessage.decode(sample).tokens[0]


def value_in(sample: bytes, name: str) -> bytes:
    """A binary property of the token of a message sample."""
    return dict(token_in(sample).binary_properties)[name]
