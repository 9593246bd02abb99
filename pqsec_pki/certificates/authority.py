"""CAs: a self-signed certificate, and the certificates that the CA issues.

The certificate profile is the one that every measured stack accepts: version 3, self-signed
CAs without intermediates, participants with digitalSignature only.
"""

import hashlib
from dataclasses import field
from datetime import datetime, timedelta
from functools import lru_cache
from ipaddress import ip_address
from typing import Self

from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from pqsec_pki._asn1 import (
    AlgorithmIdentifier,
    Extension,
    Oid,
    Signed,
    SubjectPublicKeyInfo,
    TBSCertificate,
    Validity,
    bits,
    decode,
    encode,
    raw,
    time_of,
)
from pqsec_pki._dataclass import dataclass
from pqsec_pki._times import said
from pqsec_pki.algorithms import PrivateKey, PublicKey, SignatureAlgorithm
from pqsec_pki.certificates import _alternative
from pqsec_pki.certificates._sequence import sequence_extension
from pqsec_pki.certificates.certificate import Certificate
from pqsec_pki.errors import PqsecError, UsageError

BACKDATE = timedelta(days=1)
"""Certificates begin a day early: robots' clocks differ, and Fast DDS reads times as local."""
LAST_YEAR = 2261
"""For later years Cyclone DDS reports an expired certificate, and Fast DDS (master) crashes."""
_NAMES = 1 << 14
"""Remembered: a fleet of 10,000 has fewer."""
MAX_COMMON_NAME = 64
"""Characters; ub-common-name of RFC 5280, appendix A.1."""


@dataclass(frozen=True, slots=True, eq=False)
class Authority:
    """A certificate authority: its certificate and its private keys."""

    certificate: Certificate
    key: PrivateKey = field(repr=False)
    alternative_key: PrivateKey | None = field(default=None, repr=False)

    @classmethod
    def create(
        cls,
        name: str,
        algorithm: SignatureAlgorithm,
        *,
        alternative: SignatureAlgorithm | None = None,
        now: datetime,
        validity: timedelta,
    ) -> Self:
        """A new self-signed CA with the name CN=`name`, valid from a day before `now`.

        With `alternative`, it has a second key of that algorithm, and everything it issues
        is signed with both. UsageError if the name or the validity is invalid.
        """
        second = alternative.generate() if alternative else None
        return cls.self_signed(name, algorithm.generate(), second, now=now, validity=validity)

    @classmethod
    def self_signed(  # noqa: PLR0913 -- the rarer ones by name
        cls,
        name: str,
        key: PrivateKey,
        alternative: PrivateKey | None = None,
        *,
        host: str = "",
        now: datetime,
        validity: timedelta,
    ) -> Self:
        """A new self-signed CA as of `create`, with keys that exist already.

        With `host` it is the certificate of a TLS server of that name, which is not a CA.

        UsageError for a host that is neither a DNS name nor an address.
        """
        subject = common_name(name)
        tbs = _tbs(
            subject=subject,
            issuer=subject,
            key=key.public_key,
            window=(now - BACKDATE, end_of(now, validity)),
            extensions=[
                *(_host_extensions(host) if host else (_CA, _CA_USAGE)),
                _extension(x509.SubjectKeyIdentifier(key_identifier(key.public_key))),
            ],
        )
        if alternative:
            _alternative.add_key(tbs, alternative.public_key)
        return cls(_sign(tbs, key, alternative), key, alternative)

    def issue(  # noqa: PLR0913 -- the rarer ones by name
        self,
        name: str,
        key: PublicKey,
        *,
        alternative: PublicKey | None = None,
        number: int | None = None,
        now: datetime,
        validity: timedelta,
    ) -> Certificate:
        """A participant's certificate for CN=`name` and `key`, and its alternative key.

        `number` is its sequence number, by which robots know an older certificate.
        It never expires after this CA: a longer `validity` is shortened. UsageError if the name
        is invalid, PqsecError if this CA is expired or not yet valid.
        """
        end = cut(end_of(now, validity), self.certificate, now)
        tbs = _tbs(
            subject=common_name(name),
            issuer=self.certificate.subject_der,
            key=key,
            window=(max(now - BACKDATE, self.certificate.not_before), end),
            extensions=[
                *_participant_extensions(key, self.certificate),
                *([sequence_extension(number)] if number is not None else []),
            ],
        )
        if alternative:
            _alternative.add_key(tbs, alternative)
        return _sign(tbs, self.key, self.alternative_key)


def cut(end: datetime, authority: Certificate, now: datetime) -> datetime:
    """`end`, or the end of `authority` if earlier; PqsecError if that is not valid at `now`."""
    if end <= authority.not_before:
        raise PqsecError(
            f"the identity CA begins on {said(authority.not_before)}: it is not yet valid",
            hint="set the clock to the correct time",
        )
    if authority.not_after <= now:
        raise PqsecError(
            f"the identity CA expired on {said(authority.not_after)}",
            hint="create new CAs with `pqsec ca rotate`, or set the clock to the correct time",
        )
    return min(end, authority.not_after)


@lru_cache(maxsize=_NAMES)  # several checks of one participant need it
def common_name(name: str) -> bytes:
    """DER Name of CN=`name`; UsageError if it is empty, too long or not plain ASCII.

    A single CN is the only form that every stack writes in the same way.
    """
    if not name or len(name) > MAX_COMMON_NAME:
        raise UsageError(
            f"a common name has 1 to {MAX_COMMON_NAME} characters,"
            f" {name!r} has {len(name)} (RFC 5280, ub-common-name)"
        )
    if not (name.isascii() and all(char.isalnum() or char in "_./ -" for char in name)):
        raise UsageError(
            f"{name!r} has characters that DDS stacks read differently",
            hint="use letters, digits, and _ . / - or spaces",
        )
    if name != " ".join(name.split()):
        raise UsageError(f"{name!r} has spaces where DDS stacks read them differently")
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)]).public_bytes()


def end_of(now: datetime, validity: timedelta) -> datetime:
    """`now` + `validity`, in whole seconds; UsageError after the year 2261 or before `now`."""
    try:
        end = (now + validity).replace(microsecond=0)
    except OverflowError:
        end = None
    if end is None or end.year > LAST_YEAR:
        raise UsageError(
            f"the validity reaches beyond {LAST_YEAR}, which DDS stacks cannot represent",
            hint="choose a shorter --validity",
        )
    if validity <= timedelta():
        raise UsageError("the validity must be positive")
    return end


def _tbs(
    *,
    subject: bytes,
    issuer: bytes,
    key: PublicKey,
    window: tuple[datetime, datetime],
    extensions: list[Extension],
) -> TBSCertificate:
    not_before, not_after = window
    return TBSCertificate(
        version=2,
        serial_number=x509.random_serial_number(),
        signature=AlgorithmIdentifier(algorithm=Oid("1.1"), parameters=None),  # set by _sign
        issuer=raw(issuer),
        validity=raw(
            encode(Validity(not_before=time_of(not_before), not_after=time_of(not_after)))
        ),
        subject=raw(subject),
        subject_public_key_info=raw(key.spki),
        issuer_unique_id=None,
        subject_unique_id=None,
        extensions=extensions,
    )


def _sign(tbs: TBSCertificate, key: PrivateKey, alternative_key: PrivateKey | None) -> Certificate:
    identifier = decode(AlgorithmIdentifier, key.algorithm.identifier, "AlgorithmIdentifier")
    tbs.signature = identifier
    if alternative_key:
        _alternative.add_signature(tbs, alternative_key)
    content = encode(tbs)
    signature = bits(key.sign(content))
    der = encode(Signed(tbs=raw(content), signature_algorithm=identifier, signature=signature))
    return Certificate.from_der(der)


def _host_extensions(host: str) -> list[Extension]:
    """The extensions of a TLS server, which clients know by its name (RFC 9525)."""
    name: x509.GeneralName
    try:
        name = x509.IPAddress(ip_address(host))
    except ValueError:
        try:
            name = x509.DNSName(host)
        except ValueError:
            raise UsageError(f"{host!r} is not a host's name or address") from None
    server = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH])
    names = x509.SubjectAlternativeName([name])
    return [_NOT_CA, _PARTICIPANT_USAGE, _extension(server), _extension(names)]


def _participant_extensions(key: PublicKey, issuer: Certificate) -> list[Extension]:
    # RFC 5280 4.2.1.1: as in the issuer's certificate, which other software may have created
    known = issuer.subject_key_identifier or key_identifier(issuer.public_key)
    authority_key = x509.AuthorityKeyIdentifier(known, None, None)
    return [
        _NOT_CA,
        _PARTICIPANT_USAGE,
        _extension(x509.SubjectKeyIdentifier(key_identifier(key))),
        _extension(authority_key),
    ]


def key_identifier(key: PublicKey) -> bytes:
    """The first 160 bits of SHA-256 of the public key (RFC 7093 2, method 1)."""
    info = decode(SubjectPublicKeyInfo, key.spki, "SubjectPublicKeyInfo")
    return hashlib.sha256(info.subject_public_key.as_bytes()).digest()[:20]


def _extension(value: x509.ExtensionType, *, critical: bool = False) -> Extension:
    oid = Oid(value.oid.dotted_string)
    return Extension(extn_id=oid, critical=critical, extn_value=value.public_bytes())


def _usage(*, authority: bool) -> Extension:
    # digitalSignature for the authority too: Cyclone DDS 0.10 and Fast DDS 2.9 check the
    # S/MIME purpose of the permissions CA.
    usage = x509.KeyUsage(
        digital_signature=True,
        key_cert_sign=authority,
        crl_sign=authority,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )
    return _extension(usage, critical=True)


_CA = _extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
_NOT_CA = _extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
_CA_USAGE, _PARTICIPANT_USAGE = _usage(authority=True), _usage(authority=False)
