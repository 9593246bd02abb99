"""The kinds of keys in tokens: how each is generated, read and used.

Signatures come out as in certificates and CMS, whatever the token's own form is.
"""

import hashlib
from abc import ABC, abstractmethod
from typing import Any, ClassVar

import pkcs11
from pkcs11 import Attribute, Mechanism, MechanismFlag
from pkcs11.mechanisms import MLDSAParameterSet
from pkcs11.util.ec import (
    encode_ec_public_key,
    encode_ecdsa_signature,
    encode_named_curve_parameters,
)
from pkcs11.util.rsa import encode_rsa_public_key

from pqsec_pki._asn1 import SubjectPublicKeyInfo, algorithm, bits, encode
from pqsec_pki.algorithms import SIGNATURES, SignatureAlgorithm
from pqsec_pki.errors import PqsecError

_RSA_OID = "1.2.840.113549.1.1.1"
Pair = tuple[Any, Any]
"""A public and a private key object."""


class KeyType(ABC):
    """One kind of key."""

    pkcs11_type: ClassVar[pkcs11.KeyType]

    @abstractmethod
    def generate(self, session: Any, row: SignatureAlgorithm, template: dict[str, Any]) -> Pair:
        """A new key, with what `template` says of it."""

    @abstractmethod
    def spki(self, public: Any) -> bytes:
        """DER SubjectPublicKeyInfo of a public key object."""

    @abstractmethod
    def sign(self, private: Any, row: SignatureAlgorithm, data: bytes) -> bytes:
        """A signature over `data` by a private key object."""


def template(label: str, identifier: bytes) -> dict[str, Any]:
    """The attributes of a new key: stored in the token, for signatures, never readable."""
    return {
        "id": identifier,
        "label": label,
        "store": True,
        "capabilities": MechanismFlag.SIGN | MechanismFlag.VERIFY,
        # Some tokens make keys that can be read, unless asked for others.
        "private_template": {
            Attribute.SENSITIVE: True,
            Attribute.EXTRACTABLE: False,
            Attribute.PRIVATE: True,
        },
    }


class _Ec(KeyType):
    pkcs11_type = pkcs11.KeyType.EC

    def generate(self, session: Any, row: SignatureAlgorithm, template: dict[str, Any]) -> Pair:
        curve = encode_named_curve_parameters(row.curve_oid)  # type: ignore[attr-defined]
        parameters = session.create_domain_parameters(
            self.pkcs11_type, {Attribute.EC_PARAMS: curve}, local=True
        )
        pair: Pair = parameters.generate_keypair(**template)
        return pair

    def spki(self, public: Any) -> bytes:
        return encode_ec_public_key(public)

    def sign(self, private: Any, row: SignatureAlgorithm, data: bytes) -> bytes:
        digest = hashlib.new(row.digest.name, data).digest()
        return encode_ecdsa_signature(private.sign(digest, mechanism=Mechanism.ECDSA))


class _Rsa(KeyType):
    pkcs11_type = pkcs11.KeyType.RSA

    def generate(self, session: Any, row: SignatureAlgorithm, template: dict[str, Any]) -> Pair:
        size: int = row.bits  # type: ignore[attr-defined]
        pair: Pair = session.generate_keypair(self.pkcs11_type, size, **template)
        return pair

    def spki(self, public: Any) -> bytes:
        inside = bits(encode_rsa_public_key(public))
        kind = algorithm(_RSA_OID, null=True)
        return encode(SubjectPublicKeyInfo(algorithm=kind, subject_public_key=inside))

    def sign(self, private: Any, row: SignatureAlgorithm, data: bytes) -> bytes:
        mechanism = Mechanism[f"{row.digest.name.upper()}_RSA_PKCS"]
        signature: bytes = private.sign(data, mechanism=mechanism)
        return signature


class _MlDsa(KeyType):
    pkcs11_type = pkcs11.KeyType.ML_DSA

    def generate(self, session: Any, row: SignatureAlgorithm, template: dict[str, Any]) -> Pair:
        kind = MLDSAParameterSet[row.name.upper().replace("-", "_")]
        pair: Pair = session.generate_keypair(
            self.pkcs11_type, public_template={Attribute.PARAMETER_SET: kind}, **template
        )
        return pair

    def spki(self, public: Any) -> bytes:
        """CKA_VALUE is the raw key (PKCS#11 3.2), or in some tokens its SubjectPublicKeyInfo."""
        value: bytes = public[Attribute.VALUE]
        for row in SIGNATURES:
            if KEY_TYPES.get(row.key_oid) is self and row.public_key_size == len(value):
                kind, inside = algorithm(row.key_oid), bits(value)
                return encode(SubjectPublicKeyInfo(algorithm=kind, subject_public_key=inside))
        return value

    def sign(self, private: Any, row: SignatureAlgorithm, data: bytes) -> bytes:
        del row
        signature: bytes = private.sign(data, mechanism=Mechanism.ML_DSA)
        return signature


_EC, _RSA, _ML_DSA = _Ec(), _Rsa(), _MlDsa()
KEY_TYPES: dict[str, KeyType] = {
    "1.2.840.10045.2.1": _EC,
    _RSA_OID: _RSA,
    **{f"2.16.840.1.101.3.4.3.{arc}": _ML_DSA for arc in (17, 18, 19)},
}
"""Key types by the OID of the key."""


def key_type_of(public: Any) -> KeyType:
    """The kind of a public key object; PqsecError if no algorithm here has such keys."""
    for each in (_EC, _RSA, _ML_DSA):
        if public.key_type == each.pkcs11_type:
            return each
    raise PqsecError(f"the key is of a kind that pqsec does not use: {public.key_type!r}")
