"""Encode and decode keys: SubjectPublicKeyInfo, PKCS#8, PEM, with or without a passphrase."""

import re
from collections.abc import Callable, Iterable
from shlex import quote
from typing import Any

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.serialization import (
    load_der_private_key,
    load_der_public_key,
    load_pem_private_key,
)

from pqsec_pki._asn1 import Oid, OneAsymmetricKey, SubjectPublicKeyInfo, decode, encode
from pqsec_pki._der import elements
from pqsec_pki.algorithms import _pbes2
from pqsec_pki.algorithms._composite import Composite
from pqsec_pki.algorithms._ml_dsa import MLDSA
from pqsec_pki.algorithms._pem import blocks, pem, unpem
from pqsec_pki.algorithms._row import PrivateKey, PublicKey, SignatureAlgorithm
from pqsec_pki.algorithms.signature import SIGNATURES
from pqsec_pki.errors import (
    MalformedError,
    PassphraseError,
    PqsecError,
    UnknownAlgorithmError,
    library_call,
    words_of,
)

_ROWS_BY_OID = {row.key_oid: row for row in SIGNATURES if isinstance(row, Composite | MLDSA)}
"""Rows found by the key's OID alone; the others need the key's curve or size."""
_ROWS_WITH = {
    oid: [row for row in SIGNATURES if row.key_oid == oid]
    for oid in (row.key_oid for row in SIGNATURES)
}
_KNOWN_OIDS = {encode(Oid(row.key_oid)): row.key_oid for row in SIGNATURES}


def load_public_key(spki: bytes) -> PublicKey:
    """The key in DER SubjectPublicKeyInfo `spki`.

    MalformedError if it is not a key, UnknownAlgorithmError if SIGNATURES has no row for it.
    """
    # Before the library reads it: for a Diffie-Hellman key it tests the primes, which takes
    # half a minute for hostile 8192 bits.
    oid = _known_oid(spki)
    row = _row_by_oid(oid)
    if row and not isinstance(row, MLDSA):
        return PublicKey(row, spki, row.load_spki(_info(spki)))
    with library_call(lambda error: MalformedError(f"not a public key: {words_of(error)}")):
        try:
            handle = load_der_public_key(spki)
        except UnsupportedAlgorithm as error:
            raise UnknownAlgorithmError(f"this key of algorithm {oid} is not known here") from error
    return PublicKey(row or _row_of(handle, _ROWS_WITH.get(oid, ())), spki, handle)


def public_key_from_pem(data: bytes, file: str = "FILE") -> PublicKey:
    """The key in PEM `data`, which has nothing else; errors as of `load_public_key`.

    `file` is its name, for the hint if there is a private key instead.
    """
    match unpem(data, "public key"):
        case [("PUBLIC KEY", spki)]:
            return load_public_key(spki)
    if b"PRIVATE KEY-----" in data:
        raise MalformedError(
            "a private key, where the public one belongs",
            hint=f"`openssl pkey -in {quote(file)} -pubout` prints the public key",
        )
    raise MalformedError("it must be one PEM block, PUBLIC KEY")


def _known_oid(spki: bytes) -> str:
    """The dotted OID of the key in `spki`; UnknownAlgorithmError if no row has it."""
    (identifier,) = elements(spki, 1, "SubjectPublicKeyInfo")
    (der,) = elements(identifier, 1, "SubjectPublicKeyInfo")
    if oid := _KNOWN_OIDS.get(der):
        return oid
    other = _info(spki).algorithm.algorithm.dotted_string
    if _row_by_oid(other):
        return other
    raise UnknownAlgorithmError(f"keys of algorithm {other} are not known here")


def _row_by_oid(oid: str) -> SignatureAlgorithm | None:
    """The row whose keys have `oid`. A key loads no other package: a peer may have sent it."""
    if found := _ROWS_BY_OID.get(oid):
        return found
    added = tuple(SIGNATURES.added.values())  # a thread may add one meanwhile
    return next((row for row, _ in added if row.key_oid == oid), None)


def _info(spki: bytes) -> SubjectPublicKeyInfo:
    return decode(SubjectPublicKeyInfo, spki, "SubjectPublicKeyInfo")


_DEK_INFO = (
    rb"(?im)^DEK-Info: (?:AES-(?:128|192|256)-CBC,[0-9A-F]{32}|DES-EDE3-CBC,[0-9A-F]{16})\r?$"
)
"""The encryption of a traditional PEM (RFC 1421, 4.6.1.3)."""


def load_private_key(data: bytes, passphrase: bytes | None = None) -> PrivateKey:
    """The key in `data`: PKCS#8 in PEM or DER, plain or encrypted, or a traditional PEM.

    ML-DSA keys may be seed, both, or bare seed. MalformedError if it is not a key,
    PassphraseError if the passphrase is missing or wrong, UnknownAlgorithmError if
    SIGNATURES has no row for it. No message contains any part of the key.
    """
    if data.startswith(b"\x30"):
        return _load_encrypted(data, passphrase) if _pbes2.is_one(data) else _load_pkcs8(data)
    for block in blocks(data, "private key"):
        label = block["label"].decode()
        if label == "EC PARAMETERS":  # OpenSSL reads nothing after broken ones
            [(_, der)] = unpem(block[0], "private key")
            decode(Oid, der, "name of a curve")
        if not label.endswith("PRIVATE KEY"):
            continue
        if label not in {"PRIVATE KEY", "ENCRYPTED PRIVATE KEY"}:
            return _load_traditional(block[0], passphrase)
        [(_, der)] = unpem(block[0], "private key")
        return _load_pkcs8(der) if label == "PRIVATE KEY" else _load_encrypted(der, passphrase)
    raise MalformedError("not a private key in PEM or DER")


def is_encrypted(data: bytes) -> bool:
    """Whether private key `data` needs a passphrase."""
    return (
        b"BEGIN ENCRYPTED PRIVATE KEY-----" in data
        or b"Proc-Type: 4,ENCRYPTED" in data
        or _pbes2.is_one(data)
    )


def private_key_pem(key: PrivateKey, passphrase: bytes | None = None) -> bytes:
    """PKCS#8 PEM of `key`, encrypted (PBES2, 600,000 iterations) if a passphrase is given."""
    if passphrase is None:
        return pem("PRIVATE KEY", key.pkcs8)
    return pem("ENCRYPTED PRIVATE KEY", _pbes2.encrypt(key.pkcs8, passphrase))


def _load_encrypted(der: bytes, passphrase: bytes | None) -> PrivateKey:
    if passphrase is None:
        raise PassphraseError("the private key is encrypted and no passphrase was given")
    return _load_pkcs8(_pbes2.decrypt(der, passphrase))


def _load_pkcs8(der: bytes) -> PrivateKey:
    try:
        info = decode(OneAsymmetricKey, der, "PKCS#8 private key")
    except MalformedError:
        # The decoder's own message could quote bytes of the key.
        raise MalformedError("not a PKCS#8 private key") from None
    row = _row_by_oid(info.algorithm.algorithm.dotted_string)
    if row is None:
        return _load_by_library(der, info.algorithm.algorithm.dotted_string)
    if info.algorithm.parameters is not None:
        raise MalformedError(f"{row.name} keys have no parameters")
    if isinstance(row, MLDSA):
        return row.load_pkcs8_octets(info.private_key)
    return row.private_key(_native(lambda: row.load_raw_private(info.private_key)))


def _load_by_library(der: bytes, oid: str) -> PrivateKey:
    try:
        handle = _native(lambda: load_der_private_key(der, None))
    except PqsecError:
        if oid in _KNOWN_OIDS.values():
            raise
        raise UnknownAlgorithmError(
            f"private keys of algorithm {oid} are not known here",
            hint="`pqsec algorithms` lists those that are",
        ) from None
    return _wrap(handle)


def _load_traditional(data: bytes, passphrase: bytes | None) -> PrivateKey:
    if is_encrypted(data) and passphrase is None:
        raise PassphraseError("the private key is encrypted and no passphrase was given")
    if not is_encrypted(data):
        return _wrap(_native(lambda: load_pem_private_key(data, None)))
    # Before the library reads it: an initial value of another length makes it panic.
    if data.count(b"DEK-Info") != 1 or not re.search(_DEK_INFO, data):
        raise MalformedError("not an encrypted private key: its DEK-Info line is damaged")
    try:
        return _wrap(_native(lambda: load_pem_private_key(data, passphrase)))
    except MalformedError:
        raise PassphraseError("wrong passphrase for the private key") from None


def _native(load: Callable[[], Any]) -> Any:
    """The result of `load`; errors have new messages, since the library's may quote the key."""
    try:
        with library_call(lambda _: MalformedError("not a private key")):
            return load()
    except PqsecError as error:
        problem = error
        if isinstance(error.__cause__, UnsupportedAlgorithm):
            problem = UnknownAlgorithmError("private keys of this algorithm are not known here")
    problem.__cause__ = problem.__context__ = None
    raise problem  # here, so that the library's error is not its context


def _wrap(handle: Any) -> PrivateKey:
    return _row_of(handle.public_key()).private_key(handle)


def _row_of(handle: Any, rows: Iterable[SignatureAlgorithm] = SIGNATURES) -> SignatureAlgorithm:
    for row in rows:
        if row.matches(handle):
            return row
    raise UnknownAlgorithmError(
        f"no signature algorithm here is for a {_describe(handle)}",
        hint="`pqsec algorithms` lists those that are",
    )


def _describe(handle: Any) -> str:
    curve = getattr(handle, "curve", None)
    size = getattr(handle, "key_size", None)
    kind = type(handle).__name__.removeprefix("_").removesuffix("PublicKey")
    detail = curve.name if curve is not None else f"{size} bits" if size is not None else ""
    return f"{kind} key {detail}".strip()
