"""A handshake's primitives as raw calls of `cryptography`: the floor of bench/handshake.py.

Keys are loaded, the objects that name curves and paddings are made, and no call does more
than its primitive: no encoding of keys, no hashing that a primitive does not do itself.
"""

import binascii
import hashlib
import secrets
from collections.abc import Callable
from functools import partial
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, mlkem, padding, rsa, x25519
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    PublicFormat,
    load_der_public_key,
)
from tries import noted

from pqsec_pki.algorithms import PrivateKey
from pqsec_pki.algorithms._diffie_hellman import G, P, Q

Call = Callable[[], object]
_SPKI = Encoding.DER, PublicFormat.SubjectPublicKeyInfo
_PSS = padding.PSS(padding.MGF1(hashes.SHA256()), padding.PSS.MAX_LENGTH)


def signing(key: PrivateKey, data: bytes) -> list[Call]:
    """A signature over `data`; a composite key or a pair makes one with each half."""
    return [partial(noted(half).sign, data, *_scheme(half, _PSS)) for half in _halves(key)]


def verifying(key: PrivateKey, data: bytes) -> list[Call]:
    """The verification of a handshake's signature by `key` over `data`."""
    return [_verifying(half, data, _scheme(half, _PSS)) for half in _halves(key)]


def verifying_certificate(key: PrivateKey, data: bytes) -> list[Call]:
    """The same for a certificate's signature."""
    return [_verifying(half, data, _scheme(half, padding.PKCS1v15())) for half in _halves(key)]


def agreeing(name: str) -> list[Call]:
    """The key agreement of that name: to generate, encapsulate and decapsulate."""
    return [call for half in _AGREEMENTS[name] for call in half()[0]]


def carrying(name: str) -> list[Call]:
    """Its public keys as bytes, and read again: not in the floor, but in every message."""
    return [call for half in _AGREEMENTS[name] for call in half()[1]]


def reading(der: bytes, key: PrivateKey) -> list[Call]:
    """The certificate `der` of `key` out of base64, parsed, and its keys loaded."""
    keys = [half.public_key().public_bytes(*_SPKI) for half in _halves(key)]
    return [
        partial(binascii.a2b_base64, binascii.b2a_base64(der)),
        partial(x509.load_der_x509_certificate, der),
        *(partial(load_der_public_key, each) for each in keys),
    ]


def digesting(data: bytes) -> list[Call]:
    """SHA-256 of `data`."""
    return [lambda: hashlib.sha256(data).digest()]


def _halves(key: PrivateKey) -> tuple[Any, ...]:
    """The library's keys: one, or the two of a composite or a pair."""
    both = key.handle if isinstance(key.handle, tuple) else (key.handle,)
    return tuple(each.handle if isinstance(each, PrivateKey) else each for each in both)


def _scheme(half: Any, rsa_padding: Any) -> tuple[Any, ...]:
    """What follows the data in `sign` and `verify`."""
    if isinstance(half, ec.EllipticCurvePrivateKey):
        return (ec.ECDSA(hashes.SHA384() if half.key_size == 384 else hashes.SHA256()),)
    return (rsa_padding, hashes.SHA256()) if isinstance(half, rsa.RSAPrivateKey) else ()


def _verifying(half: Any, data: bytes, scheme: tuple[Any, ...]) -> Call:
    return partial(half.public_key().verify, half.sign(data, *scheme), data, *scheme)


Calls = tuple[list[Call], list[Call]]
"""The primitives, and those of `carrying`."""


def _ml_kem(kind: Any) -> Calls:
    private = kind.generate()
    public = private.public_key()
    _, ciphertext = public.encapsulate()
    primitives = [kind.generate, public.encapsulate, partial(private.decapsulate, ciphertext)]
    return primitives, _carried(private)


def _ecdh(curve: ec.EllipticCurve) -> Calls:
    generate = partial(ec.generate_private_key, curve)
    private = generate()
    exchange = partial(private.exchange, ec.ECDH(), private.public_key())
    return [generate, exchange] * 2, _carried(private) * 2


def _x25519() -> Calls:
    generate = x25519.X25519PrivateKey.generate
    private = generate()
    exchange = partial(private.exchange, private.public_key())
    return [generate, exchange] * 2, _carried(private) * 2


def _carried(private: Any) -> list[Call]:
    """The public key as bytes, and read again."""
    written = private.public_key().public_bytes(*_SPKI)
    return [
        lambda: private.public_key().public_bytes(*_SPKI),
        partial(load_der_public_key, written),
    ]


def _modp() -> Calls:
    exponent = secrets.randbelow(Q)
    y = pow(G, exponent, P)
    generate, exchange = partial(pow, G, exponent, P), partial(pow, y, exponent, P)
    check = partial(pow, y, Q, P)  # RFC 2631 2.1.5
    return [generate, check, exchange] * 2, []


_ML_KEM_768 = partial(_ml_kem, mlkem.MLKEM768PrivateKey)
_ML_KEM_1024 = partial(_ml_kem, mlkem.MLKEM1024PrivateKey)
_P256, _P384 = partial(_ecdh, ec.SECP256R1()), partial(_ecdh, ec.SECP384R1())
_AGREEMENTS = {
    "ecdh-p256": [_P256],
    "ecdh-p384": [_P384],
    "dh-modp-2048-256": [_modp],
    "mlkem768": [_ML_KEM_768],
    "mlkem1024": [_ML_KEM_1024],
    "x25519mlkem768": [_ML_KEM_768, _x25519],
    "secp256r1mlkem768": [_P256, _ML_KEM_768],
    "secp384r1mlkem1024": [_P384, _ML_KEM_1024],
}
