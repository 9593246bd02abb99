"""Relays that change one message and let all others pass."""

from collections.abc import Callable, Mapping
from dataclasses import replace

from pqsec_pki.attacks._context import values_in, with_values
from pqsec_pki.handshake import DataHolder, GenericMessage
from pqsec_pki.selfcheck import Relay

Edit = Callable[[bytes], bytes]
"""Changes the sample of a message on its way."""
Change = Callable[[DataHolder], DataHolder]
"""Changes the token of a message."""


def on(message: str, edit: Edit, occurrence: int = 1) -> Relay:
    """Edits the message of that name; if both send one, the initiator's is occurrence 1."""
    heard = 0

    def relay(name: str, data: bytes) -> bytes:
        nonlocal heard
        heard += name == message
        return edit(data) if name == message and heard == occurrence else data

    return relay


def enveloped(message: str, edit: Callable[[GenericMessage], GenericMessage]) -> Relay:
    """Edits the whole message, including the fields around its token."""
    return on(message, lambda sample: edit(GenericMessage.decode(sample)).encode())


def changing_token(message: str, change: Change, occurrence: int = 1) -> Relay:
    """Changes the token; the fields around it stay unchanged."""

    def edit(sample: bytes) -> bytes:
        told = GenericMessage.decode(sample)
        return replace(told, tokens=(change(told.tokens[0]),)).encode()

    return on(message, edit, occurrence)


def instead(message: str, token: DataHolder, occurrence: int = 1) -> Relay:
    """Replaces the token by another one."""
    return changing_token(message, lambda _: token, occurrence)


def putting(message: str, values: Mapping[str, bytes | None], occurrence: int = 1) -> Relay:
    """Sets fields to other values; None removes a field (`with_values`)."""
    return changing_token(message, lambda token: with_values(token, values), occurrence)


def editing(message: str, name: str, edit: Edit) -> Relay:
    """Edits the value of one field."""

    def change(token: DataHolder) -> DataHolder:
        found = dict(token.binary_properties)
        value = found[name] if name in found else values_in(token)[name]
        return with_values(token, {name: edit(value)})

    return changing_token(message, change)


def adding(message: str, *fields: tuple[str, bytes]) -> Relay:
    """Adds fields after the token's own."""

    def change(token: DataHolder) -> DataHolder:
        return replace(token, binary_properties=token.binary_properties + fields)

    return changing_token(message, change)


def preceding(message: str, *fields: tuple[str, bytes]) -> Relay:
    """Adds fields before the token's own."""

    def change(token: DataHolder) -> DataHolder:
        return replace(token, binary_properties=fields + token.binary_properties)

    return changing_token(message, change)
