"""Diffie-Hellman as a KEM: over elliptic curves, X25519, and RFC 5114."""

import secrets
from dataclasses import field
from typing import Any

from cryptography.hazmat.primitives.asymmetric import ec, x25519
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms._agreement import KeyAgreement


@dataclass(frozen=True, slots=True, kw_only=True)
class DiffieHellman(KeyAgreement):
    """Encapsulation generates an own key pair and runs the exchange."""

    def _encapsulate(self, public: bytes) -> tuple[bytes, bytes]:
        own = self._generate()
        return self._public(own), self._decapsulate(own, public)


@dataclass(frozen=True, slots=True, kw_only=True)
class ECDH(DiffieHellman):
    """ECDH on one curve; points are uncompressed (X9.62), the secret is the x coordinate."""

    curve: ec.EllipticCurve = field(repr=False)

    def _generate(self) -> ec.EllipticCurvePrivateKey:
        return ec.generate_private_key(self.curve)

    def _public(self, handle: Any) -> bytes:
        point: bytes = handle.public_key().public_bytes(
            Encoding.X962, PublicFormat.UncompressedPoint
        )
        return point

    def _decapsulate(self, handle: Any, ciphertext: bytes) -> bytes:
        # Cyclone DDS accepts compressed points and even infinity; here the size check refuses
        # both. from_encoded_point checks that the point is on the curve.
        peer = ec.EllipticCurvePublicKey.from_encoded_point(self.curve, ciphertext)
        secret: bytes = handle.exchange(ec.ECDH(), peer)
        return secret


@dataclass(frozen=True, slots=True, kw_only=True)
class X25519(DiffieHellman):
    """X25519 (RFC 7748); an all-zero secret is refused, as RFC 10024 requires."""

    def _generate(self) -> x25519.X25519PrivateKey:
        return x25519.X25519PrivateKey.generate()

    def _public(self, handle: Any) -> bytes:
        data: bytes = handle.public_key().public_bytes_raw()
        return data

    def _decapsulate(self, handle: Any, ciphertext: bytes) -> bytes:
        secret: bytes = handle.exchange(x25519.X25519PublicKey.from_public_bytes(ciphertext))
        return secret


# RFC 5114 2.3: 2048-bit MODP group with 256-bit prime order subgroup.
P = int(
    "87A8E61DB4B6663CFFBBD19C651959998CEEF608660DD0F25D2CEED4435E3B00"
    "E00DF8F1D61957D4FAF7DF4561B2AA3016C3D91134096FAA3BF4296D830E9A7C"
    "209E0C6497517ABD5A8A9D306BCF67ED91F9E6725B4758C022E0B1EF4275BF7B"
    "6C5BFC11D45F9088B941F54EB1E59BB8BC39A0BF12307F5C4FDB70C581B23F76"
    "B63ACAE1CAA6B7902D52526735488A0EF13C6D9A51BFA4AB3AD8347796524D8E"
    "F6A167B5A41825D967E144E5140564251CCACB83E6B486F6B3CA3F7971506026"
    "C0B857F689962856DED4010ABD0BE621C3A3960A54E710C375F26375D7014103"
    "A4B54330C198AF126116D2276E11715F693877FAD7EF09CADB094AE91E1A1597",
    16,
)
G = int(
    "3FB32C9B73134D0B2E77506660EDBD484CA7B18F21EF205407F4793A1A0BA125"
    "10DBC15077BE463FFF4FED4AAC0BB555BE3A6C1B0C6B47B1BC3773BF7E8C6F62"
    "901228F8C28CBB18A55AE31341000A650196F931C77A57F2DDF463E5E9EC144B"
    "777DE62AAAB8A8628AC376D282D6ED3864E67982428EBC831D14348F6F2F9193"
    "B5045AF2767164E1DFC967C1FB3F2E55A4BD1BFFE83B9C80D052B985D182EA0A"
    "DB2A3B7313D3FE14C8484B1E052588B9B7D2BBD2DF016199ECD06E1557CD0915"
    "B3353BBB64E0EC377FD028370DF92B52C7891428CDC67EB6184B523D1DB246C3"
    "2F63078490F00EF8D647D148D47954515E2327CFEF98C582664B4C0F6CC41659",
    16,
)
Q = int("8CF83642A709A097B447997640129DA299B1A47D1EB3750BA308B0FE64F5FBD3", 16)
_SIZE = 256
"""Bytes of P."""
_INTEGER = 0x02


@dataclass(frozen=True, slots=True)
class ModpKey:
    """An exponent, and the encoding of its public value."""

    exponent: int = field(repr=False)
    der: bool = True
    """Encode as a DER INTEGER (Cyclone DDS), or as plain big-endian (Fast DDS, OpenDDS)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MODP(DiffieHellman):
    """Diffie-Hellman in the group of RFC 5114 2.3.

    The stacks encode public values differently: the encoding is recognised by its size, and the
    answer has the encoding of the peer, unless `der` allows only one. The code uses Python
    ints, because cryptography drops finite-field DH; timing reveals nothing useful about an
    exponent, since each is used once.
    """

    der: bool | None = field(default=None, repr=False)
    """Whether this side supports only DER INTEGERs, only plain numbers, or both (None)."""

    def _fits(self, data: bytes, size: int) -> bool:
        return 0 < len(data) <= size and self.der in (None, len(data) > _SIZE)

    def _generate(self) -> ModpKey:
        return ModpKey(1 + secrets.randbelow(Q - 1), der=self.der is not False)

    def _public(self, handle: Any) -> bytes:
        y = pow(G, handle.exponent, P)
        # OpenDDS and Fast DDS write no leading zeros.
        return _to_der(y) if handle.der else _octets(y)

    def _encapsulate(self, public: bytes) -> tuple[bytes, bytes]:
        own = ModpKey(self._generate().exponent, der=len(public) > _SIZE)
        return self._public(own), self._decapsulate(own, public)

    def _decapsulate(self, handle: Any, ciphertext: bytes) -> bytes:
        y = _from_der(ciphertext) if len(ciphertext) > _SIZE else int.from_bytes(ciphertext)
        # RFC 2631 2.1.5: in range, and in the subgroup of order Q.
        if not 2 <= y <= P - 2 or pow(y, Q, P) != 1:  # noqa: PLR2004 -- 1 has order 1
            raise ValueError("not in the group")
        # Cyclone DDS hashes it without leading zeros (measured with secrets of 255 bytes).
        return _octets(pow(y, handle.exponent, P))


def _octets(number: int) -> bytes:
    return number.to_bytes((number.bit_length() + 7) // 8)


def _to_der(number: int) -> bytes:
    """DER INTEGER of a number of 128 to 65535 bytes; smaller: probability 2**-1000."""
    body = number.to_bytes(number.bit_length() // 8 + 1)
    size = len(body).to_bytes((len(body).bit_length() + 7) // 8)
    return bytes([_INTEGER, 0x80 | len(size)]) + size + body


def _from_der(data: bytes) -> int:
    """The number in such an INTEGER; ValueError for anything else."""
    start = 2 + (data[1] & 0x7F)
    number = int.from_bytes(data[start:])
    if _to_der(number) != data:
        raise ValueError("not a DER INTEGER")
    return number
