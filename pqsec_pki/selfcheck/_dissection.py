"""Decode messages into values, each with its name, its meaning and its parts."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import field, fields
from typing import Any, TypeVar

from pqsec_pki._dataclass import dataclass
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
"""Describes a certificate or a signed document, in lines of text."""

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
"""Parts of a protected submessage (DDS-Security 1.1, 9.5.3.3.4) and their sizes in bytes.

A negative size means all bytes except that many at the end.
"""

MEANINGS = {
    "hash_c1": "SHA-256 of the c. properties of the request",
    "hash_c2": "SHA-256 of the c. properties of the reply",
    "challenge1": "the initiator's challenge",
    "challenge2": "the replier's challenge",
    "future_challenge": "the challenge that its sender will use",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A value: its name, its bytes, their meaning, and their parts."""

    name: str
    data: bytes = field(repr=False)
    words: tuple[str, ...] = ()
    parts: "tuple[Piece, ...]" = ()
    secret: bool = False

    def to_json(self, *, show_secrets: bool) -> dict[str, Any]:
        """The piece for --json; the value of a secret only with `show_secrets`."""
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
    """Decodes tokens in the order they were sent; values of earlier tokens explain later ones."""

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
        """The token's properties. PqsecError if an honest side cannot have sent it."""
        if token.class_id == Request.CLASS_ID:
            self.request = Request.from_holder(token)
        elif token.class_id == Reply.CLASS_ID:
            self.reply = Reply.from_holder(token)
        # The replier signs the Reply, the initiator signs the Final.
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

    def label(each: KeyAgreement) -> str:
        is_key = name == "dh1" or each.family is Family.CLASSICAL
        return f"{each.name} {'public key' if is_key else 'ciphertext'}"

    components = _components(row)
    sizes = [each.public_size if name == "dh1" else each.ciphertext_size for each in components]
    return (label(row),), _split(data, zip(map(label, components), sizes, strict=True))


def _signatures(data: bytes, signer: Introduction) -> tuple[Iterable[str], Iterable[Piece]]:
    name = signer.signature_algorithm_name
    for key in Certificate.from_pem(signer.certificate).handshake_keys:
        if key.algorithm.wire_name == name:
            # In pairs and composites the ML-DSA signature comes first; its size is fixed.
            components = sorted(
                _components(key.algorithm), key=lambda row: row.family is not Family.PQ
            )
            return (name,), _split(data, [(row.name, row.signature_size) for row in components])
    return (name,), ()


def _components(row: Row) -> list[Row]:
    """The algorithms that a composite or hybrid consists of, in its order."""
    values = [getattr(row, each.name) for each in fields(row)]
    return [each for each in values if isinstance(each, (KeyAgreement, SignatureAlgorithm))]  # type: ignore[misc] # a row consists of rows of its own kind


def _split(data: bytes, sizes: Iterable[tuple[str, int]]) -> Iterator[Piece]:
    """Split `data` into pieces; a negative size leaves that many bytes for the pieces after it."""
    for name, size in sizes:
        end = size if size >= 0 else len(data) + size
        yield Piece(name=name, data=data[:end])
        data = data[end:]
