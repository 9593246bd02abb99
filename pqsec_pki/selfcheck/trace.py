"""Decode everything that two participants sent, and what they derived from it.

For implementers of another side: all bytes are included, for replay, and each value has its
name and place. Private keys, including ephemeral ones, are not in a report and so never in
a trace; the shared secrets are, and are marked as secret.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import field
from typing import Any

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import PqsecError
from pqsec_pki.handshake import (
    Done,
    GenericMessage,
    Transcript,
    key_exchange_material,
    unprotect_submessage,
)
from pqsec_pki.selfcheck._dissection import (
    MEANINGS,
    Describe,
    Dissection,
    Piece,
    protected_pieces,
)
from pqsec_pki.selfcheck.report import MESSAGE, HandshakeReport, Sent

__all__ = ["DecodedMessage", "Piece", "Trace", "trace"]


@dataclass(frozen=True, slots=True, kw_only=True)
class DecodedMessage:
    """One message, decoded."""

    name: str
    sender: str
    receiver: str
    header: dict[str, str]
    """The fields around the token, as text."""
    pieces: tuple[Piece, ...]
    sample: bytes = field(repr=False)

    def to_json(self) -> dict[str, Any]:
        """The message for --json. Nothing in it is secret, since it was sent."""
        return {
            "name": self.name,
            "from": self.sender,
            "to": self.receiver,
            **self.header,
            "bytes": len(self.sample),
            "sample": self.sample.hex(),
            "pieces": [piece.to_json(show_secrets=False) for piece in self.pieces],
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Trace:
    """A handshake up to its end, or up to the step that failed."""

    report: HandshakeReport
    messages: tuple[DecodedMessage, ...]
    derived: tuple[Piece, ...]
    """The values that both sides derived."""

    def to_json(self, *, show_secrets: bool) -> dict[str, Any]:
        """The trace for --json."""
        return {
            "report": self.report.to_json(),
            "messages": [message.to_json() for message in self.messages],
            "derived": [piece.to_json(show_secrets=show_secrets) for piece in self.derived],
        }


def trace(report: HandshakeReport, describe: Describe) -> Trace:
    """Decode the messages and secrets of `report`; `describe` turns documents into text."""
    dissection = Dissection(describe)
    messages = tuple(_decoded(sent, dissection) for sent in report.sent)
    transcript = dissection.transcript
    derived = [*_public(transcript)] if transcript else []
    if report.outcome:
        derived += _secret(report.outcome, [each for each in report.sent if each.name == MESSAGE])
    return Trace(report=report, messages=messages, derived=tuple(derived))


def _decoded(sent: Sent, dissection: Dissection) -> DecodedMessage:
    token = sent.token
    return DecodedMessage(
        name=sent.name,
        sender=sent.sender,
        receiver=sent.receiver,
        header=_header(GenericMessage.decode(sent.data)) if token else {},
        pieces=tuple(dissection.pieces(token) if token else protected_pieces(sent.data)),
        sample=sent.data,
    )


def _header(message: GenericMessage) -> dict[str, str]:
    return {
        "message_class": message.class_id,
        "source": message.source.hex(),
        "sequence": str(message.sequence),
        "destination": message.destination_participant.hex(),
        "token_class": message.tokens[0].class_id,
    }


def _public(transcript: Transcript) -> Iterator[Piece]:
    for name, data, words in (
        ("hash_c1", transcript.hash_c1, MEANINGS["hash_c1"]),
        ("hash_c2", transcript.hash_c2, MEANINGS["hash_c2"]),
        ("signed in the reply", transcript.reply_octets(), "what its signature covers"),
        ("signed in the final", transcript.final_octets(), "what its signature covers"),
    ):
        yield Piece(name=name, data=data, words=(words,))


def _secret(done: Done, messages: list[Sent]) -> Iterator[Piece]:
    material = key_exchange_material(done)
    bound = " || SHA256(signed in the reply)" if done.agreement.binds_transcript else ""
    words = "from SharedSecret and both challenges"
    yield _secret_piece("SharedSecret", done.shared_secret, f"SHA256(secret{bound})")
    yield _secret_piece("key exchange salt", material.salt, words)
    yield _secret_piece("key exchange key", material.sender_key, words)
    for sent in messages:
        way = f"{sent.sender} to {sent.receiver}"
        session = next(each.data for each in protected_pieces(sent.data) if "session" in each.name)
        words = f"from salt and key above and session id {session.hex()}"
        yield _secret_piece(f"session key, {way}", material.session_key(session), words)
        with suppress(PqsecError):  # the report says why it cannot be decrypted
            plain = unprotect_submessage(material, sent.data)
            yield _secret_piece(f"plaintext, {way}", plain, "an RTPS submessage")


def _secret_piece(name: str, data: bytes, words: str) -> Piece:
    return Piece(name=name, data=data, words=(words,), secret=True)
