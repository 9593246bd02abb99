"""What the process that faces the network asks the signer, and the answers, as octets.

Each connection of the signer's socket has one call and one answer. Both are a header in JSON and a
body, after their lengths.
"""

import base64
import json
import struct
from collections.abc import Callable
from dataclasses import field
from enum import StrEnum
from typing import Any

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import MalformedError

MAX_HEADER = 512 << 10
"""Octets; a client's certificate has at most 256 kB in DER."""
MAX_BODY = 64 << 20
"""Octets; an answer is a bundle of one participant."""
_LENGTHS = struct.Struct(">II")


class CallKind(StrEnum):
    """What is asked. Nothing else can be asked: no other name, key or document is signed."""

    READY = "ready"
    CA_CERTIFICATES = "cacerts"
    REQUEST_ATTRIBUTES = "csrattrs"
    ENROL = "simpleenroll"
    REENROL = "simplereenroll"
    REQUEST = "request"
    BUNDLE = "bundle"
    REVOCATION_LIST = "revocation-list"
    HEAD = "head"
    RECEIPT = "receipt"

    @property
    def issues(self) -> bool:
        """Whether the answer may be a new certificate."""
        return self in {CallKind.ENROL, CallKind.REENROL, CallKind.REQUEST}


@dataclass(frozen=True, slots=True, kw_only=True)
class SignerCall:
    """What a client asks, and what it showed: a token, or a certificate whose key it has."""

    kind: CallKind
    label: str = ""
    address: str = ""
    """The client's address, for records."""
    token: str = ""
    secret: str = field(default="", repr=False)
    certificate: bytes = field(default=b"", repr=False)
    """DER; empty without one."""
    chain: tuple[bytes, ...] = field(default=(), repr=False)
    """The CAs that the client sent with it, in DER; they are not verified."""
    body: bytes = field(default=b"", repr=False)
    """DER of a request, or a receipt."""

    def to_bytes(self) -> bytes:
        """The call as octets."""
        header = {
            "kind": self.kind,
            "label": self.label,
            "address": self.address,
            "token": self.token,
            "secret": self.secret,
            "certificate": base64.b64encode(self.certificate).decode(),
            "chain": [base64.b64encode(each).decode() for each in self.chain],
        }
        return packed(header, self.body)

    @classmethod
    def of(cls, header: dict[str, Any], body: bytes) -> "SignerCall":
        """The call; MalformedError if it is not one."""
        try:
            texts = {key: _ascii(header[key]) for key in ("label", "address", "token", "secret")}
            certificate = base64.b64decode(header["certificate"], validate=True)
            chain = tuple(base64.b64decode(each, validate=True) for each in header["chain"])
            kind = CallKind(header["kind"])
        except (KeyError, TypeError, ValueError):
            raise MalformedError("not a call of pqsec serve") from None
        return cls(kind=kind, certificate=certificate, chain=chain, body=body, **texts)


@dataclass(frozen=True, slots=True, kw_only=True)
class SignerAnswer:
    """An answer as HTTP has it."""

    status: int
    body: bytes = field(default=b"", repr=False)
    media_type: str = ""
    etag: str = ""
    retry_after: int = 0
    """Seconds; 0 for none."""
    detail: str = ""
    """What is wrong, for the client, if the answer is an error."""
    problem: str = ""
    """The type of that error, a URI reference; empty for none."""
    note: str = ""
    """For the log: who got what, and by what."""
    trouble: str = ""
    """Why the signer's changed files are not in force; for the pages about its health."""

    def to_bytes(self) -> bytes:
        """The answer as octets."""
        header = {
            "status": self.status,
            "media_type": self.media_type,
            "etag": self.etag,
            "retry_after": self.retry_after,
            "detail": self.detail,
            "problem": self.problem,
            "note": self.note,
            "trouble": self.trouble,
        }
        return packed(header, self.body)

    @classmethod
    def of(cls, header: dict[str, Any], body: bytes) -> "SignerAnswer":
        """The answer; MalformedError if it is not one."""
        try:
            return cls(body=body, **header)
        except TypeError:
            raise MalformedError("not an answer of pqsec's signer") from None


def _ascii(value: object) -> str:
    """A text as the front sends it: clients send nothing else that it passes on as text."""
    if not (isinstance(value, str) and value.isascii()):
        raise ValueError("not a text of ASCII")
    return value


def packed(header: dict[str, Any], body: bytes) -> bytes:
    """Header and body after their lengths."""
    text = json.dumps(header).encode()
    return _LENGTHS.pack(len(text), len(body)) + text + body


def unpacked(take: Callable[[int], bytes]) -> tuple[dict[str, Any], bytes]:
    """Header and body; `take` gives exactly as many octets as asked. MalformedError."""
    size, rest = _LENGTHS.unpack(take(_LENGTHS.size))
    if size > MAX_HEADER or rest > MAX_BODY:
        raise MalformedError("a message between the server's processes is too large")
    try:
        header = json.loads(take(size))
    except (ValueError, RecursionError):
        raise MalformedError("a message between the server's processes is not JSON") from None
    if not isinstance(header, dict):
        raise MalformedError("a message between the server's processes has no header")
    return header, take(rest)


def length_of(start: bytes) -> int | None:
    """How long the whole message is that begins so; None as long as that is not known."""
    if len(start) < _LENGTHS.size:
        return None
    header, body = _LENGTHS.unpack(start[: _LENGTHS.size])
    return int(_LENGTHS.size + header + body)
