"""The head of a log as a C2SP checkpoint (c2sp.org/tlog-checkpoint), which is a signed note.

A note (c2sp.org/signed-note) has one signature line for each key. A signature is the one that
the key's algorithm makes in certificates. Its key ID is the beginning of the SHA-256 of the
public key (SubjectPublicKeyInfo), as signature type 0x02 (ECDSA) defines it; the other
algorithms have no type of their own (docs/explanation/adr/0026-a-tree-over-the-ledger.md).
"""

import base64
import hashlib
import re
from collections.abc import Collection, Iterable
from dataclasses import field
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import PrivateKey, PublicKey
from pqsec_pki.errors import MalformedError, VerificationError
from pqsec_pki.problems import Code
from pqsec_pki.transparency.tree import MAX_SIZE

MAX_NOTE = 256 << 10
"""Bytes: 16 signatures, which a reader must accept, of any algorithm."""
MAX_SIGNATURES = 16
"""Each may be by a key that we verify with, for each participant of a bundle."""
HASH = 32
"""Bytes of a SHA-256."""
_ID = 4
_NAME = r"[^\s+]+"
_HEAD = re.compile(rf"({_NAME})\n(0|[1-9][0-9]{{0,18}})\n([A-Za-z0-9+/]{{43}}=)\n(?:[^\n]+\n)*")
_SIGNATURE = re.compile(rf"\u2014 ({_NAME}) ([A-Za-z0-9+/]+={{0,2}})\n")


@dataclass(frozen=True, slots=True)
class TreeHead:
    """The size and the root of a log's tree."""

    origin: str
    """Which log it is."""
    size: int
    root: bytes

    @property
    def text(self) -> bytes:
        """The text that is signed."""
        return f"{self.origin}\n{self.size}\n{encoded(self.root)}\n".encode()


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """A head, and the signatures of it; they are not verified here."""

    head: TreeHead
    text: bytes = field(repr=False)
    """The octets that the signatures cover."""
    signatures: tuple[tuple[str, bytes], ...] = field(repr=False)
    """The name of each key; its ID with the signature."""

    @classmethod
    def signed(cls, head: TreeHead, keys: Iterable[PrivateKey]) -> Self:
        """The head, signed with all `keys`."""
        signatures = ((head.origin, key_id(key.public_key) + key.sign(head.text)) for key in keys)
        return cls(head, head.text, tuple(signatures))

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """The checkpoint in `data`; MalformedError if it is not one."""
        try:
            text, parted, lines = data[: MAX_NOTE + 1].decode().rpartition("\n\n")
        except UnicodeDecodeError:
            raise MalformedError("not a checkpoint: not UTF-8") from None
        text += "\n"
        found = _HEAD.fullmatch(text)
        signatures = list(_SIGNATURE.finditer(lines))
        whole = sum(len(each[0]) for each in signatures) == len(lines)
        signed = whole and 0 < len(signatures) <= MAX_SIGNATURES
        if len(data) > MAX_NOTE or not (parted and found and signed):
            raise MalformedError("not a checkpoint (c2sp.org/tlog-checkpoint)")
        head = TreeHead(found[1], int(found[2]), decoded(found[3]))
        if head.size > MAX_SIZE or any(c < " " and c != "\n" for c in text):
            raise MalformedError("not a checkpoint (c2sp.org/tlog-checkpoint)")
        return cls(head, text.encode(), tuple((each[1], decoded(each[2])) for each in signatures))

    def to_bytes(self) -> bytes:
        """The checkpoint as a file."""
        lines = (f"\u2014 {name} {encoded(value)}\n" for name, value in self.signatures)
        return self.text + b"\n" + "".join(lines).encode()

    def verify(self, keys: Collection[PublicKey]) -> TreeHead:
        """The head, if each of `keys` has signed it; VerificationError otherwise."""
        for key in keys:
            mine = [
                value[_ID:]
                for name, value in self.signatures
                if name == self.head.origin and value[:_ID] == key_id(key)
            ]
            if not mine:
                raise VerificationError(
                    f"no signature by the {key.algorithm.name} key {key_id(key).hex()}",
                    code=Code.SIGNATURE_MISSING,
                )
            for signature in mine:
                key.verify(signature, self.text)
        if not keys:
            raise VerificationError("no key to verify the checkpoint with")
        return self.head


def key_id(key: PublicKey) -> bytes:
    """The ID of a key in a signed note."""
    return hashlib.sha256(key.spki).digest()[:_ID]


def encoded(data: bytes) -> str:
    """Base64, as in notes."""
    return base64.b64encode(data).decode()


def decoded(text: str) -> bytes:
    """The inverse of `encoded`; MalformedError for any other spelling."""
    try:
        data = base64.b64decode(text, validate=True)
    except ValueError:
        data = b""
    if encoded(data) != text:
        raise MalformedError("not base64")
    return data


def decoded_hash(text: str) -> bytes:
    """The hash in `text`; MalformedError if it is not one."""
    data = decoded(text)
    if len(data) != HASH:
        raise MalformedError("not a SHA-256 hash")
    return data
