"""Messages taken apart: each value by its name, its meaning, and what it is made of."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, fields
from typing import Any, TypeVar

from pqsec_pki.algorithms import KEY_AGREEMENTS, Family, KeyAgreement, SignatureAlgorithm
from pqsec_pki.certificates import Certificate
from pqsec_pki.handshake import (
    DataHolder,
    Introduction,
    Reply,
    Request,
    Transcript,
    participant_guid,
)

Row = TypeVar("Row", KeyAgreement, SignatureAlgorithm)
Describe = Callable[[bytes], Iterable[str]]
"""What a certificate or a signed document says, in lines."""

_PROTECTED = (
    ("SEC_PREFIX", 4),
    ("transformation kind", 4),
    ("key id", 4),
    ("session id", 4),
    ("initialization vector suffix", 8),
    ("SEC_BODY", 4),
    ("length of the ciphertext", 4),
    ("ciphertext", -24),
    ("SEC_POSTFIX", 4),
    ("tag", 16),
    ("number of receivers", 4),
)
"""A protected submessage (DDS-Security 1.1, 9.5.3.3.4) and sizes; -24: but for so many."""

MEANINGS = {
    "hash_c1": "SHA-256 of the c. properties of the request",
    "hash_c2": "SHA-256 of the c. properties of the reply",
    "challenge1": "the initiator's challenge",
    "challenge2": "the replier's challenge",
    "future_challenge": "the challenge that its sender will use",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A value: its name, its bytes, what they mean, and what they are made of."""

    name: str
    data: bytes = field(repr=False)
    words: tuple[str, ...] = ()
    parts: "tuple[Piece, ...]" = ()
    secret: bool = False

    def to_json(self, *, show_secrets: bool) -> dict[str, Any]:
        """The piece for --json; a secret's value only if told to."""
        value: dict[str, Any] = {"name": self.name, "bytes": len(self.data)}
        value["hex"] = self.data.hex() if show_secrets or not self.secret else None
        value["meaning"] = list(self.words)
        if self.secret:
            value["secret"] = True
        if self.parts:
            value["parts"] = [part.to_json(show_secrets=show_secrets) for part in self.parts]
        return value


@dataclass(slots=True)
class Dissection:
    """Takes tokens in the order they were sent: what the first say, the later are read by."""

    describe: Describe
    request: Request | None = None
    reply: Reply | None = None

    @property
    def transcript(self) -> Transcript | None:
        """What both signatures cover, once there is a Reply."""
        if self.request is None or self.reply is None:
            return None
        return Transcript(
            hash_c1=self.request.introduction.digest(),
            hash_c2=self.reply.introduction.digest(),
            challenge1=self.request.challenge1,
            challenge2=self.reply.challenge2,
            dh1=self.request.dh1,
            dh2=self.reply.dh2,
        )

    def pieces(self, token: DataHolder) -> Iterator[Piece]:
        """Its properties. PqsecError if it is none that an honest side sends."""
        if token.class_id == Request.CLASS_ID:
            self.request = Request.from_holder(token)
        elif token.class_id == Reply.CLASS_ID:
            self.reply = Reply.from_holder(token)
        # The Reply is signed by who sends it, and the Final by who sent the Request.
        signer = self.reply if token.class_id == Reply.CLASS_ID else self.request
        for name, data in token.binary_properties:
            words, parts = self._meaning(name, data, signer.introduction if signer else None)
            yield Piece(name=name, data=data, words=tuple(words), parts=tuple(parts))

    def _meaning(
        self, name: str, data: bytes, signer: Introduction | None
    ) -> tuple[Iterable[str], Iterable[Piece]]:
        if name in {"c.id", "c.perm"}:
            return self.describe(data.rstrip(b"\0")), ()
        if name == "c.pdata":
            return (f"parameter list with participant GUID {participant_guid(data).hex()}",), ()
        if name in {"c.dsign_algo", "c.kagree_algo"}:
            end = "and a NUL" if data.endswith(b"\0") else "without a NUL"
            return (f"{data.rstrip(bytes(1)).decode('ascii', 'backslashreplace')}, {end}",), ()
        if name in {"dh1", "dh2"} and self.request:
            return _shares(name, data, self.request.introduction.key_agreement_name)
        if name == "signature" and signer:
            return _signatures(data, signer)
        return (MEANINGS[name],) if name in MEANINGS else (), ()


def protected_pieces(data: bytes) -> Iterator[Piece]:
    """A submessage under AES-GCM, without tags for single receivers."""
    return _split(data, _PROTECTED)


def _shares(name: str, data: bytes, agreement: str) -> tuple[Iterable[str], Iterable[Piece]]:
    row = KEY_AGREEMENTS.on_wire(agreement)

    def word(each: KeyAgreement) -> str:
        is_key = name == "dh1" or each.family is Family.CLASSICAL
        return f"{each.name} {'public key' if is_key else 'ciphertext'}"

    halves = _halves(row)
    sizes = [each.public_size if name == "dh1" else each.ciphertext_size for each in halves]
    return (word(row),), _split(data, zip(map(word, halves), sizes, strict=True))


def _signatures(data: bytes, signer: Introduction) -> tuple[Iterable[str], Iterable[Piece]]:
    name = signer.signature_algorithm_name
    for key in Certificate.from_pem(signer.certificate).handshake_keys:
        if key.algorithm.wire_name == name:
            # In pairs and composites ML-DSA's signature, of fixed size, comes first.
            halves = sorted(_halves(key.algorithm), key=lambda row: row.family is not Family.PQ)
            return (name,), _split(data, [(row.name, row.signature_size) for row in halves])
    return (name,), ()


def _halves(row: Row) -> list[Row]:
    """The rows that a row is made of, in its order."""
    values = [getattr(row, each.name) for each in fields(row)]
    return [each for each in values if isinstance(each, (KeyAgreement, SignatureAlgorithm))]  # type: ignore[misc] # rows are made of rows of their own kind


def _split(data: bytes, sizes: Iterable[tuple[str, int]]) -> Iterator[Piece]:
    """`data` in pieces; a negative size leaves so many bytes to those that follow."""
    for name, size in sizes:
        end = size if size >= 0 else len(data) + size
        yield Piece(name=name, data=data[:end])
        data = data[end:]
