"""What an attacker knows, and what it tries.

It recorded an earlier handshake of the two participants. In their next handshake it is on
the way between them, or in the place of one of them. An attempt is that second handshake.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import field, replace
from typing import Any, NamedTuple

from pqsec_pki._dataclass import dataclass
from pqsec_pki.handshake import DataHolder, GenericMessage, compacted, expanded
from pqsec_pki.selfcheck import HandshakeSession, Relay, Sent, SessionSide

_VERSION = "ver"
"""The property that only tokens of the second version have."""
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
    """`side` with a changed identity: certificate, key, GUID or permissions, in this set only."""
    own = replace(side.terms.own, **changes)
    return replace(side, terms=replace(side.terms, own=own), sets=None)


def token_in(sample: bytes) -> DataHolder:
    """The token of a message sample."""
    return GenericMessage.decode(sample).tokens[0]


def value_in(sample: bytes, name: str) -> bytes:
    """A value of the token of a message sample, by its name in the first version."""
    return values_in(token_in(sample))[name]


def values_in(token: DataHolder) -> dict[str, bytes]:
    """The values of a token by their names in the first version."""
    found = dict(token.binary_properties)
    return expanded(token.class_id, found) if _VERSION in found else found


def with_values(token: DataHolder, values: Mapping[str, bytes | None]) -> DataHolder:
    """The token with other values, by their names in its own version or in the first; None
    removes one. What its version does not have is left out."""
    found = dict(token.binary_properties)
    second = _VERSION in found and not values.keys() <= found.keys()
    before = values_in(token) if second else found
    after = ((name, values.get(name, value)) for name, value in before.items())
    kept = {name: value for name, value in after if value is not None}
    pairs = compacted(token.class_id, kept) if second else tuple(kept.items())
    return replace(token, binary_properties=pairs)
