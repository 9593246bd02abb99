"""Keys, certificates and signed documents that an attacker creates.

It has only the certificates and documents that are sent in every handshake.
"""

from base64 import b64decode, encodebytes
from dataclasses import field
from datetime import datetime, timedelta
from email import message_from_bytes
from typing import Self

from pqsec_pki._asn1 import (
    AlgorithmIdentifier,
    ContentInfo,
    SetOf,
    Signed,
    TBSCertificate,
    bits,
    decode,
    encode,
    raw,
)
from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import PrivateKey, pair_private
from pqsec_pki.certificates import (
    Authority,
    Certificate,
    Reason,
    RevocationList,
    RevokedCertificate,
    revocation_list,
)
from pqsec_pki.credentials import Credentials
from pqsec_pki.smime import Signer, sign

YEAR = timedelta(days=365)
_ALTERNATIVE_SIGNATURE = {"2.5.29.73", "2.5.29.74"}
"""OIDs of the extensions with its algorithm and its value (X.509 (10/2019), 9.8)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Keys:
    """A key, and an alternative key if the genuine certificate has one."""

    plain: PrivateKey = field(repr=False)
    alternative: PrivateKey | None = field(repr=False)

    @classmethod
    def like(cls, genuine: Certificate) -> Self:
        """New keys of the same algorithms as in `genuine`."""
        second = genuine.alternative_key
        return cls(
            plain=genuine.public_key.algorithm.generate(),
            alternative=second.algorithm.generate() if second else None,
        )

    @classmethod
    def of(cls, participant: Credentials) -> Self:
        """The participant's own keys."""
        return cls(plain=participant.key, alternative=participant.alternative_key)

    @property
    def both(self) -> PrivateKey:
        """The key that signs handshakes."""
        return pair_private(self.plain, self.alternative) if self.alternative else self.plain


def name_of(genuine: Certificate) -> str:
    """The common name, the only part of the subject name in pqsec's certificates."""
    return genuine.subject_name.removeprefix("CN=")


def self_signed_authority(
    genuine: Certificate, now: datetime, name: str | None = None
) -> Authority:
    """A new CA with keys of the same algorithms, and the same name or `name`."""
    second = genuine.alternative_key
    return Authority.create(
        name or name_of(genuine),
        genuine.public_key.algorithm,
        alternative=second.algorithm if second else None,
        now=now,
        validity=YEAR,
    )


def issued(
    authority: Authority, name: str, keys: Keys, now: datetime, validity: timedelta = YEAR
) -> Certificate:
    """A participant's certificate issued by that CA."""
    second = keys.alternative.public_key if keys.alternative else None
    return authority.issue(
        name, keys.plain.public_key, alternative=second, now=now, validity=validity
    )


def list_of(authority: Authority, revoked: Certificate, now: datetime) -> RevocationList:
    """A revocation list of `authority`, with one certificate on it."""
    entry = RevokedCertificate(revoked.serial_number, now, Reason.KEY_COMPROMISE)
    return revocation_list(authority, [entry], number=1, now=now, validity=YEAR)


def without_alternative_signature(genuine: Certificate, broken: PrivateKey) -> Certificate:
    """The certificate without its alternative signature, signed again with the CA's plain key."""
    tbs = _without_alternative_signature(genuine)
    return _assembled(tbs, tbs.signature, broken.sign(encode(tbs)))


def with_broken_key(genuine: Certificate, key: PrivateKey) -> Certificate:
    """The CA's certificate, as if `key` were its plain key.

    It simulates a CA whose plain private key a quantum computer has computed. Its
    alternative key, which a quantum computer cannot compute, is the genuine one.
    """
    tbs = _without_alternative_signature(genuine)
    tbs.subject_public_key_info = raw(key.public_key.spki)
    tbs.signature = decode(AlgorithmIdentifier, key.algorithm.identifier, "AlgorithmIdentifier")
    return _assembled(tbs, tbs.signature, key.sign(encode(tbs)))


def _without_alternative_signature(genuine: Certificate) -> TBSCertificate:
    tbs = decode(TBSCertificate, genuine.tbs, "certificate")
    tbs.extensions = [
        each
        for each in tbs.extensions or []
        if each.extn_id.dotted_string not in _ALTERNATIVE_SIGNATURE
    ]
    return tbs


def _assembled(
    tbs: TBSCertificate, identifier: AlgorithmIdentifier, signature: bytes
) -> Certificate:
    der = encode(
        Signed(tbs=raw(encode(tbs)), signature_algorithm=identifier, signature=bits(signature))
    )
    return Certificate.from_der(der)


def signed_alike(
    document: bytes, authority: Certificate, counter: Certificate | None, now: datetime
) -> bytes:
    """`document`, signed like the genuine ones, by new CAs of the same names."""
    signer = _signer(authority, now)
    countersigner = _signer(counter, now) if counter else None
    return sign(document, signer, countersigner=countersigner, now=now)


def _signer(genuine: Certificate, now: datetime) -> Signer:
    forged = self_signed_authority(genuine, now)
    return Signer(forged.certificate, forged.key)


def without_countersignature(message: bytes) -> bytes:
    """The signed document without its countersignature, which no other signature covers."""
    *_, part = message_from_bytes(message).walk()
    text = str(part.get_payload()).strip().encode()
    info = decode(ContentInfo, b64decode(text), "signature")
    [signer] = info.content.signer_infos.as_list()
    signer.unsigned_attributes = None
    info.content.signer_infos = SetOf([signer])
    return message.replace(text, encodebytes(encode(info)).strip())
