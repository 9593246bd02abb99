"""Protection with session keys, of submessages and serialized payloads.

Both become a crypto header, their content and a crypto footer (DDS-Security 1.1, 9.5.3.3).
For a submessage these are submessages too: SEC_PREFIX, SEC_BODY, SEC_POSTFIX. AES-GCM
encrypts the content. With GMAC the submessage stays readable in the place of SEC_BODY, and
the footer's tag covers it. With origin authentication the footer has one more tag for each
receiver, under a key that only this receiver shares with the sender.
"""

import hmac
import os
import struct
from collections.abc import Sequence
from threading import Lock

from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from pqsec_pki.errors import MalformedError, UsageError, VerificationError, library_call
from pqsec_pki.handshake._cdr import ByteOrder, CdrReader, CdrWriter
from pqsec_pki.handshake._secured import (
    ALIGNED,
    HEADER_SIZE,
    MAX_RECEIVERS,
    SESSION_ID_SIZE,
    SUFFIX_SIZE,
    TAG_SIZE,
    CryptoFooter,
    CryptoHeader,
    Frame,
    ReceiverTag,
    Secure,
    framed,
    is_submessage,
    parted,
)
from pqsec_pki.handshake.key_exchange import KeyMaterial, TransformationKind

MAX_SUBMESSAGE = 0xFFF8
"""Bytes: the size field of a submessage has 16 bits, and the content begins with its length."""
MAX_PAYLOAD = 1 << 30
"""Bytes: ciphers accept less than 2**31 in one call."""
BLOCKS_PER_SESSION = 1 << 32
"""Blocks of 16 bytes under one session key; TLS 1.3 allows 2**34.5 (RFC 8446, 5.5)."""
_BLOCK_SIZE = 16
_PAYLOAD_FOOTER_SIZE = TAG_SIZE + 4
_PAYLOAD_OVERHEAD = HEADER_SIZE + 4 + ALIGNED + _PAYLOAD_FOOTER_SIZE


class Sender:
    """One participant, writer or reader that protects what it sends with its key material.

    An initialization vector is a session_id and a suffix. Both start at random values and the
    suffix counts up, so one sender repeats no vector in 2**64 messages. Two senders with one
    key, as in a key exchange, use a vector twice with a probability of 2**-62 after 2**32
    messages each. With random vectors it would be 2**-31, which is the limit of NIST SP
    800-38D, 8.3. So use one sender for a key; threads may share it, processes must not.
    """

    __slots__ = ("_blocks", "_cipher", "_limit", "_lock", "_material", "_session", "_suffix")

    def __init__(
        self, material: KeyMaterial, *, blocks_per_session: int = BLOCKS_PER_SESSION
    ) -> None:
        """A sender with `material`; UsageError if its kind is NONE.

        After `blocks_per_session` blocks of 16 bytes the next session begins, with a new key.
        """
        if material.kind is TransformationKind.NONE:
            raise UsageError("this key material protects nothing")
        self._material = material
        self._limit = blocks_per_session
        self._lock = Lock()
        self._suffix = int.from_bytes(os.urandom(SUFFIX_SIZE))
        self._begin_session(int.from_bytes(os.urandom(SESSION_ID_SIZE)))

    def protect_submessage(
        self, submessage: bytes, *, receivers: Sequence[KeyMaterial] = ()
    ) -> bytes:
        """`submessage`, header and content, between SEC_PREFIX and SEC_POSTFIX (9.5.3.3.4).

        `receivers` are results of `material.for_receiver()` for its receivers. UsageError if the
        submessage or the tags are too large, if a receiver belongs to another sender, or if
        `submessage` is only to be signed and is not exactly one submessage.
        """
        self._check(submessage, receivers)
        header, content, tag = self._sealed(submessage)
        if self._material.kind.encrypts:
            content = framed(Secure.BODY, struct.pack(">I", len(content)) + content)
        tags = (
            ReceiverTag(each.receiver_key_id, _receiver_tag(each, header, tag))
            for each in receivers
        )
        postfix = framed(Secure.POSTFIX, CryptoFooter(tag, tuple(tags)).encode())
        return framed(Secure.PREFIX, header.encode()) + content + postfix

    def protect_payload(self, payload: bytes) -> bytes:
        """`payload` between crypto header and crypto footer (9.5.3.3.4.4).

        UsageError if it is over 1 GiB, or if it is only to be signed and is not padded to 4 bytes:
        then its end is not marked, and stacks differ.
        """
        encrypts = self._material.kind.encrypts
        if len(payload) > MAX_PAYLOAD:
            raise UsageError(f"a payload of {len(payload)} bytes cannot be protected in one")
        if not encrypts and len(payload) % ALIGNED:
            raise UsageError("only a payload in multiples of 4 bytes can be signed")
        header, content, tag = self._sealed(payload)
        writer = CdrWriter()
        writer.raw(header.encode())
        if encrypts:
            writer.u32(len(content))
        writer.raw(content + tag)
        writer.u32(0)  # no receivers: a payload is the same for all
        return writer.done()

    def _check(self, submessage: bytes, receivers: Sequence[KeyMaterial]) -> None:
        own = self._material
        if len(submessage) > MAX_SUBMESSAGE:
            raise UsageError(f"a submessage of {len(submessage)} bytes cannot be protected in one")
        if len(receivers) > MAX_RECEIVERS:
            raise UsageError(f"{len(receivers)} receivers, and {MAX_RECEIVERS} have room")
        if not own.kind.encrypts and not is_submessage(submessage):
            raise UsageError("only one whole submessage, in multiples of 4 bytes, can be signed")
        for each in receivers:
            if not each.receiver_key or each.sender_key != own.sender_key:
                raise UsageError("a receiver's key material is not of this sender")

    def _sealed(self, data: bytes) -> tuple[CryptoHeader, bytes, bytes]:
        """The header, the content and the tag of `data`."""
        iv, cipher = self._next(len(data))
        header = CryptoHeader(self._material.kind, self._material.sender_key_id, iv)
        if not self._material.kind.encrypts:
            return header, data, cipher.encrypt(iv, b"", data)
        sealed = cipher.encrypt(iv, data, None)
        return header, sealed[:-TAG_SIZE], sealed[-TAG_SIZE:]

    def _next(self, size: int) -> tuple[bytes, AESGCM]:
        """A new initialization vector, and the cipher for `size` bytes."""
        blocks = 1 + size // _BLOCK_SIZE
        with self._lock:
            if self._blocks + blocks > self._limit:
                self._begin_session(int.from_bytes(self._session) + 1)
            self._blocks += blocks
            self._suffix = (self._suffix + 1) % (1 << 8 * SUFFIX_SIZE)
            return self._session + self._suffix.to_bytes(SUFFIX_SIZE), self._cipher

    def _begin_session(self, number: int) -> None:
        self._session = (number % (1 << 8 * SESSION_ID_SIZE)).to_bytes(SESSION_ID_SIZE)
        self._cipher = AESGCM(self._material.session_key(self._session))
        self._blocks = 0


def unprotect_submessage(material: KeyMaterial, data: bytes) -> bytes:
    """The submessage in `data`, three submessages as a Sender with `material` makes them.

    MalformedError if `data` has another structure; VerificationError if it was protected with
    other keys or another kind, was changed, or if `material` has a receiver key and no tag
    for it is correct.
    """
    header, body, footer = parted(data)
    _check_name(material, header)
    content = _ciphertext(body) if material.kind.encrypts else _plaintext(body)
    plain = _opened(material, header, content, footer.tag)
    _check_origin(material, header, footer)
    return plain


def unprotect_payload(material: KeyMaterial, data: bytes) -> bytes:
    """The serialized payload in `data`, as a Sender with `material` protects it.

    Errors as for `unprotect_submessage`. A payload has no tags for receivers, so any holder
    of the key may have created it.
    """
    if not HEADER_SIZE + _PAYLOAD_FOOTER_SIZE <= len(data) <= MAX_PAYLOAD + _PAYLOAD_OVERHEAD:
        raise MalformedError(f"{len(data)} bytes cannot be a protected payload")
    # As CDR: the footer's count is aligned, so Fast DDS and OpenDDS pad before it.
    reader = CdrReader(data, ByteOrder.BIG)
    header = CryptoHeader.decode(reader.raw(HEADER_SIZE))
    _check_name(material, header)
    encrypts = material.kind.encrypts
    content = reader.octets() if encrypts else reader.raw(reader.left - _PAYLOAD_FOOTER_SIZE)
    tag = reader.raw(TAG_SIZE)
    if reader.u32() or reader.left:
        raise MalformedError("something stands after the payload's tag")
    return _opened(material, header, content, tag)


def _check_name(material: KeyMaterial, header: CryptoHeader) -> None:
    if material.kind is TransformationKind.NONE:
        raise VerificationError("this key material protects nothing")
    if (header.kind, header.key_id) != (material.kind, material.sender_key_id):
        raise VerificationError("protected in another way, or with a key of another name")


def _ciphertext(body: Frame) -> bytes:
    """CryptoContent (9.5.2.4): a length and that many bytes, then at most 3 of padding."""
    if body.kind != Secure.BODY:
        raise MalformedError("not encrypted")
    reader = CdrReader(body.content, ByteOrder.BIG)
    content = reader.octets()
    if reader.left >= ALIGNED:
        raise MalformedError(f"{reader.left} bytes after the encrypted content")
    return content


def _plaintext(body: Frame) -> bytes:
    if body.kind == Secure.BODY:
        raise MalformedError("encrypted, where it should only be signed")
    return body.whole


def _opened(material: KeyMaterial, header: CryptoHeader, content: bytes, tag: bytes) -> bytes:
    cipher = AESGCM(material.session_key(header.session_id))
    words = "the two sides have different keys, or the data changed"
    with library_call(lambda _: VerificationError(words)):
        if material.kind.encrypts:
            return cipher.decrypt(header.iv, content + tag, None)
        cipher.decrypt(header.iv, tag, content)
    return content


def _check_origin(material: KeyMaterial, header: CryptoHeader, footer: CryptoFooter) -> None:
    """Check the tag for this receiver: so the sender made it, not another receiver (9.5.3.3.4)."""
    if not material.receiver_key:
        if footer.receiver_tags:
            raise VerificationError("receiver-specific tags where there is no receiver's key")
        return
    due = ReceiverTag(material.receiver_key_id, _receiver_tag(material, header, footer.tag))
    ours = (each.tag for each in footer.receiver_tags if each.key_id == due.key_id)
    if not any(hmac.compare_digest(due.tag, tag) for tag in ours):
        raise VerificationError("no tag for this receiver, or not a right one")


def _receiver_tag(material: KeyMaterial, header: CryptoHeader, tag: bytes) -> bytes:
    """GMAC of the common tag, with the receiver's session key and the same vector."""
    cipher = AESGCM(material.session_receiver_key(header.session_id))
    return cipher.encrypt(header.iv, b"", tag)
