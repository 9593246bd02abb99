"""The crypto plugin of Cyclone DDS: its participant, and one of ours that it has met."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from ctypes import byref, c_int32
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from tests.interop.cyclone_abi import (
    CRYPTO,
    KEY_EXCHANGE,
    KEY_FACTORY,
    TRANSFORM,
    Plugin,
    started,
)
from tests.interop.cyclone_types import (
    DataHolders,
    EndpointAttributes,
    Handles,
    Octets,
    ParticipantAttributes,
    Properties,
    Token,
)

_IDENTITY, _PERMISSIONS = 11, 12
"""Handles that other plugins would give; all but zero will do."""
_VOLATILE = "BuiltinParticipantVolatileMessageSecure"


class Protection(NamedTuple):
    """How governance protects an endpoint: its submessages and its payloads alike."""

    encrypts: bool = True
    origin: bool = False
    """Origin authentication, of submessages."""
    bits: int = 256

    def __str__(self) -> str:
        return f"{'encrypt' if self.encrypts else 'sign'}{' origin' * self.origin} {self.bits}"

    @property
    def attributes(self) -> EndpointAttributes:
        # Submessages encrypted, payloads encrypted, origin authenticated: bits 0, 1, 2.
        plugin = 3 * self.encrypts | self.origin << 2
        return EndpointAttributes(submessage=1, payload=1, plugin=plugin)

    @property
    def properties(self) -> Properties:
        return Properties.of([("dds.sec.crypto.keysize", str(self.bits))])


@dataclass(frozen=True)
class Endpoint:
    """A writer or reader of Cyclone DDS, and its peer of the other kind."""

    crypto: "Crypto"
    kind: str
    """What it is: "writer" or "reader"."""
    own: int
    peer: int

    @property
    def peers_kind(self) -> str:
        return {"writer": "reader", "reader": "writer"}[self.kind]

    def another(self) -> "Endpoint":
        """The same with another peer."""
        return self.crypto.matched(self.kind, self.own)

    def tokens(self) -> tuple[Token, ...]:
        """The key material that it sends its peer."""
        out, function = DataHolders(), f"create_local_data{self.kind}_crypto_tokens"
        self.crypto.key_exchange.call(function, out, self.own, self.peer)
        return out.tokens

    def take(self, tokens: Sequence[Token]) -> None:
        """Take note of its peer's key material."""
        function = f"set_remote_data{self.peers_kind}_crypto_tokens"
        self.crypto.key_exchange.call(function, self.own, self.peer, DataHolders.of(tokens))

    def protect(self, submessage: bytes, *others: "Endpoint") -> bytes:
        """A submessage for its peer, and for those of `others`."""
        plain, out = Octets.of(submessage), Octets()
        peers = Handles.of([self.peer, *(each.peer for each in others)])
        call, function = self.crypto.transform.call, f"encode_data{self.kind}_submessage"
        if self.kind == "reader":
            call(function, out, plain, self.own, peers)
            return out.data
        # One call for each receiver, as long as there is something to add for it.
        index = c_int32(0)
        while index.value < peers.length:
            call(function, out, plain, self.own, peers, byref(index))
        return out.data

    def unprotect(self, data: bytes) -> bytes:
        """What its peer protected; RefusedError."""
        out, function = Octets(), f"decode_data{self.peers_kind}_submessage"
        self.crypto.transform.call(function, out, Octets.of(data), self.own, self.peer)
        return out.data

    def protect_payload(self, payload: bytes) -> bytes:
        """A payload that a writer sends."""
        out, nothing = Octets(), Octets()
        function = "encode_serialized_payload"
        self.crypto.transform.call(function, out, nothing, Octets.of(payload), self.own)
        return out.data

    def unprotect_payload(self, data: bytes) -> bytes:
        """The payload that a reader got; RefusedError."""
        out, nothing = Octets(), Octets()
        arguments = (out, Octets.of(data), nothing, self.own, self.peer)
        self.crypto.transform.call("decode_serialized_payload", *arguments)
        return out.data


class Crypto:
    """Cyclone DDS's participant, and ours that shares a secret with it."""

    def __init__(self, plugin: Plugin, secret: int, *, rtps: bool) -> None:
        self.key_factory = plugin.part("key_factory", KEY_FACTORY)
        self.key_exchange = plugin.part("key_exchange", KEY_EXCHANGE)
        self.transform = plugin.part("transform", TRANSFORM)
        self._secret = secret
        attributes = ParticipantAttributes(rtps=rtps, plugin=rtps)
        self._own = self.key_factory.call(
            "register_local_participant", _IDENTITY, _PERMISSIONS, Properties(), attributes
        )
        function = "register_matched_remote_participant"
        self._peer = self.key_factory.call(function, self._own, _IDENTITY, _PERMISSIONS, secret)

    def tokens(self) -> tuple[Token, ...]:
        """The participant's key material, for ours."""
        out, function = DataHolders(), "create_local_participant_crypto_tokens"
        self.key_exchange.call(function, out, self._own, self._peer)
        return out.tokens

    def take(self, tokens: Sequence[Token]) -> None:
        """Take note of our participant's key material. Once only: then it needs a domain."""
        function = "set_remote_participant_crypto_tokens"
        self.key_exchange.call(function, self._own, self._peer, DataHolders.of(tokens))

    def endpoint(self, kind: str, protection: Protection) -> Endpoint:
        """A writer or reader, matched with one of ours."""
        return self._endpoint(kind, protection.properties, protection.attributes)

    def volatile(self, kind: str) -> Endpoint:
        """The writer or reader that exchanges keys."""
        name = [("dds.sec.builtin_endpoint_name", _VOLATILE + kind.capitalize())]
        attributes = EndpointAttributes(submessage=1, plugin=1)
        return self._endpoint(kind, Properties.of(name), attributes)

    def matched(self, kind: str, own: int) -> Endpoint:
        """The local endpoint `own`, with a new peer."""
        call = self.key_factory.call
        if kind == "writer":
            function = "register_matched_remote_datareader"
            peer = call(function, own, self._peer, self._secret, 0)
        else:
            peer = call("register_matched_remote_datawriter", own, self._peer, self._secret)
        return Endpoint(self, kind, own, peer)

    def _endpoint(
        self, kind: str, properties: Properties, attributes: EndpointAttributes
    ) -> Endpoint:
        function = f"register_local_data{kind}"
        own = self.key_factory.call(function, self._own, properties, attributes)
        return self.matched(kind, own)


@contextmanager
def crypto(plugins: Path, secret: int, *, rtps: bool = True) -> Iterator[Crypto]:
    """Cyclone DDS's side after a handshake that ended with the handle `secret`.

    With `rtps`, whole messages are encrypted, too, and participants have keys.
    """
    with started(plugins / "libdds_security_crypto.so", "crypto", CRYPTO) as plugin:
        yield Crypto(plugin, secret, rtps=rtps)
