"""What an attacker finds, and what it tries.

It heard the two meet before. Then they meet again, and it stands on the way between them
or in the place of one of them. An attempt is that second encounter.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from pqsec_pki.handshake import DataHolder, GenericMessage
from pqsec_pki.selfcheck.report import Sent
from pqsec_pki.selfcheck.session import HandshakeSession, Relay, Side

Impersonation = Callable[[Side, Side], Side]
"""What the attacker shows in the place of the first, to the second."""


class Attempt(NamedTuple):
    """One encounter with an attacker in it."""

    what: str
    session: HandshakeSession
    attacker: str | None = None
    """In whose place it is. What that side refuses is refused by nobody."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AttackContext:
    """Two who would meet, and all they sent when they met before."""

    session: HandshakeSession
    recorded: tuple[Sent, ...] = field(repr=False)

    def heard(self, name: str, occurrence: int = 1) -> bytes:
        """The message of that name; where both send one, the initiator's is the first."""
        return [each.data for each in self.recorded if each.name == name][occurrence - 1]

    def token(self, name: str, occurrence: int = 1) -> DataHolder:
        """The token in it."""
        return token_in(self.heard(name, occurrence))

    def value(self, message: str, name: str) -> bytes:
        """One of its binary properties."""
        return value_in(self.heard(message), name)

    def between(self, what: str, *relays: Relay) -> Attempt:
        """The attacker on the way: each message goes through all its relays."""

        def relay(name: str, data: bytes) -> bytes:
            for each in relays:
                data = each(name, data)
            return data

        return Attempt(what, replace(self.session, relay=relay))

    def impersonating(self, what: str, impersonation: Impersonation) -> Iterator[Attempt]:
        """The attacker in the place of the initiator, then of the replier."""
        yield self.as_initiator(what, impersonation)
        yield self.as_replier(what, impersonation)

    def as_initiator(self, what: str, impersonation: Impersonation) -> Attempt:
        """The attacker speaks first."""
        one, other = self.session.sides
        impersonated = replace(self.session, initiator=impersonation(one, other))
        return Attempt(f"{what}, as initiator", impersonated, one.name)

    def as_replier(self, what: str, impersonation: Impersonation) -> Attempt:
        """The attacker is spoken to."""
        one, other = self.session.sides
        impersonated = replace(self.session, replier=impersonation(other, one))
        return Attempt(f"{what}, as replier", impersonated, other.name)


def with_identity(side: Side, **changes: Any) -> Side:
    """`side` with another identity: certificate, key, GUID or permissions."""
    own = replace(side.terms.own, **changes)
    return replace(side, terms=replace(side.terms, own=own))


def token_in(sample: bytes) -> DataHolder:
    """The token of a message."""
    return GenericMessage.decode(sample).tokens[0]


def value_in(sample: bytes, name: str) -> bytes:
    """One of the binary properties of its token."""
    return dict(token_in(sample).binary_properties)[name]
