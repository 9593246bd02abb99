"""A certificate, parsed once and completely, with any signature algorithm.

cryptography parses lazily and does not support composite keys or alternative signatures.
Here everything is parsed at the start, so nothing can fail later.
"""

import hashlib
from dataclasses import field, replace
from datetime import datetime
from functools import cached_property
from typing import Any, Self, TypeVar
from weakref import WeakValueDictionary

from cryptography import x509

from pqsec_pki._asn1 import AlgorithmIdentifier, decode, plain_words
from pqsec_pki._dataclass import dataclass
from pqsec_pki._der import begins, content, elements
from pqsec_pki.algorithms import (
    PublicKey,
    exact_der,
    first_pem,
    load_public_key,
    pair_public,
    pem,
    unpem,
)
from pqsec_pki.certificates._alternative import Alternative
from pqsec_pki.certificates._names import lone_common_name, name_line, name_text
from pqsec_pki.certificates._plain import plain_certificate
from pqsec_pki.certificates._rdns import read_name, same_name
from pqsec_pki.certificates._sequence import sequence_number_in
from pqsec_pki.errors import MalformedError, PqsecError, library_call

Value = TypeVar("Value", bound=x509.ExtensionType)

MAX_CERTIFICATE = 256 << 10
"""Bytes of PEM or DER. The largest that pqsec issues (ML-DSA-87) has 10 kB."""
_VERSION = b"\xa0"
"""The tag of the version, the first value; certificates of version 1 omit it."""


@dataclass(frozen=True, eq=False)  # no slots, for cached properties
class Certificate:
    """An X.509 certificate (RFC 5280 4.1). It is not verified: see verify_chain."""

    der: bytes = field(repr=False)
    tbs: bytes = field(repr=False)
    """DER TBSCertificate: what the signature covers."""
    subject: x509.Name
    issuer: x509.Name
    subject_der: bytes = field(repr=False)
    issuer_der: bytes = field(repr=False)
    serial_number: int
    version: int
    not_before: datetime
    not_after: datetime
    spki: bytes = field(repr=False)
    extensions: x509.Extensions = field(repr=False)
    identifier: bytes = field(repr=False)
    """DER AlgorithmIdentifier of the signature, the same inside and outside."""
    signature: bytes = field(repr=False)
    alternative: Alternative | None = field(repr=False)
    _signers: set[bytes] = field(init=False, repr=False, default_factory=set)
    """DER of the keys that were found to have made its signature."""
    _alternative_signers: set[bytes] = field(init=False, repr=False, default_factory=set)
    """DER of the keys that were found to have made its alternative signature."""

    @classmethod
    def from_der(cls, der: bytes) -> Self:
        """MalformedError if `der` is not exactly one well-formed certificate."""
        if len(der) > MAX_CERTIFICATE:
            raise MalformedError(f"a certificate larger than {MAX_CERTIFICATE} bytes")
        # Split here; the library parses all of it below, and accepts only DER.
        tbs, identifier, signature = elements(der, 3, "certificate")
        first = begins(tbs, _VERSION)
        serial, inner, issuer, _, subject, spki = elements(tbs, first + 6, "certificate")[first:]
        if inner != identifier:
            raise MalformedError("the certificate names two different signature algorithms")
        parsed = _parsed(der, subject, issuer)
        if content(signature)[0]:
            raise MalformedError("the certificate's signature is not a whole number of bytes")
        if subject == issuer:
            _AUTHORITIES.setdefault(subject, parsed["subject"])
        return cls(
            der=der,
            tbs=tbs,
            subject_der=subject,
            issuer_der=issuer,
            serial_number=decode(int, serial, "serial number"),  # 4.1.2.2: any, also 0
            spki=spki,
            identifier=identifier,
            alternative=Alternative.of(tbs, parsed["extensions"]),
            **parsed,
        )

    @classmethod
    def shared(cls, der: bytes) -> "Certificate":
        """Like `from_der`, but the same value for the same DER while that value is in use.

        For files, which several questions about a keystore read: each certificate is parsed once,
        and its signature verified once. What a peer sends is parsed each time, with `from_der`.
        """
        found = _IN_USE.get(der)
        if found is None:
            found = _IN_USE[der] = cls.from_der(der)
        return found

    @classmethod
    def from_pem(cls, data: bytes) -> Self:
        """The first certificate in PEM `data`; MalformedError if there is none."""
        return cls.from_der(first_pem(data, {"CERTIFICATE"}, "certificate", limit=MAX_CERTIFICATE))

    @classmethod
    def from_exact_pem(cls, data: bytes) -> Self | None:
        """Like `from_pem`, if `data` is exactly the `pem` of its certificate; otherwise None."""
        der = exact_der("CERTIFICATE", data) if len(data) <= MAX_CERTIFICATE else None
        return None if der is None else cls.from_der(der)

    @classmethod
    def all_from_pem(cls, data: bytes) -> tuple["Certificate", ...]:
        """All certificates in PEM `data`, a file, `shared`; `from_pem` returns the first.

        MalformedError if there is none, or one of them is broken.
        """
        first = first_pem(data, {"CERTIFICATE"}, "certificate", limit=MAX_CERTIFICATE)
        found = [der for label, der in unpem(data, "certificate") if label == "CERTIFICATE"]
        return tuple(map(cls.shared, (first, *found[1:])))

    @cached_property
    def pem(self) -> bytes:
        """The certificate in PEM."""
        return pem("CERTIFICATE", self.der)

    @cached_property
    def public_key(self) -> PublicKey:
        """The subject's key; UnknownAlgorithmError if no row is for it."""
        return load_public_key(self.spki)

    @property
    def alternative_spki(self) -> bytes | None:
        """DER SubjectPublicKeyInfo of the subject's alternative key, if it has one."""
        return self.alternative.spki if self.alternative else None

    @cached_property
    def alternative_key(self) -> PublicKey | None:
        """The subject's alternative key (extension 2.5.29.72), if it has one."""
        return None if self.alternative_spki is None else load_public_key(self.alternative_spki)

    @property
    def with_alternative_key(self) -> "Certificate | None":
        """The certificate as one of its alternative key, to verify what that key signed.

        None if it has none. `spki` and `public_key` differ; the rest is the same.
        """
        return None if self.alternative_spki is None else replace(self, spki=self.alternative_spki)

    @property
    def own_keys(self) -> tuple[PublicKey, ...]:
        """The subject's key, and its alternative key if it has one."""
        return tuple(filter(None, (self.public_key, self.alternative_key)))

    @property
    def handshake_keys(self) -> tuple[PublicKey, ...]:
        """The keys its holder may sign a handshake with, the stronger first."""
        if self.alternative_key is None:
            return (self.public_key,)
        return (pair_public(self.public_key, self.alternative_key), self.public_key)

    @property
    def subject_key_identifier(self) -> bytes | None:
        """The subjectKeyIdentifier extension's value, if there is one."""
        found = self.extension(x509.SubjectKeyIdentifier)
        return found.digest if found else None

    @cached_property
    def number(self) -> int | None:
        """The sequence number: a keystore issues later certificates with larger ones.

        None if it has none, as one of another tool.
        """
        return sequence_number_in(self.extensions)

    def extension(self, kind: type[Value]) -> Value | None:
        """The value of that extension; None if the certificate has none."""
        try:
            return self.extensions.get_extension_for_class(kind).value
        except x509.ExtensionNotFound:
            return None

    @property
    def signature_algorithm(self) -> str:
        """Dotted OID of the algorithm that signed it."""
        identifier = decode(AlgorithmIdentifier, self.identifier, "AlgorithmIdentifier")
        return identifier.algorithm.dotted_string

    @cached_property
    def subject_name(self) -> str:
        """The subject as in permissions documents: RFC 2253, with OpenSSL's names of attributes."""
        return name_text(self.subject)

    @property
    def common_name(self) -> str | None:
        """The subject's CN, if the subject is a single CN."""
        return lone_common_name(self.subject)

    @cached_property
    def issuer_name(self) -> str:
        """The issuer, likewise."""
        return name_text(self.issuer)

    @property
    def subject_text(self) -> str:
        """The subject as in identity tokens: /O=x/CN=y, in DER order."""
        return name_line(self.subject)

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the DER, in hex."""
        return hashlib.sha256(self.der).hexdigest()

    def to_json(self) -> dict[str, object]:
        """Its name, algorithms, end and fingerprint, for JSON."""
        second = self.alternative_key
        return {
            "subject": self.subject_name,
            "algorithm": self.public_key.algorithm.name,
            "alternative": second.algorithm.name if second else None,
            "not_after": self.not_after,
            "sha256": self.fingerprint,
        }

    def signed(self, other: "Certificate") -> bool:
        """Whether the subject's key made the signature on `other` (RFC 5280 6.1.3 (a)(1))."""
        try:
            other.verify_signature(self.public_key)
        except PqsecError:
            return False
        return True

    def verify_signature(self, issuer: PublicKey) -> None:
        """VerificationError unless `issuer` made its signature.

        Success is remembered while the certificate is in use: key and signature do not change.
        """
        if issuer.spki not in self._signers:
            issuer.verify(self.signature, self.tbs, self.identifier)
            self._signers.add(issuer.spki)

    def verify_alternative(self, issuer: PublicKey) -> None:
        """VerificationError unless `issuer` made its alternative signature; also remembered."""
        if issuer.spki not in self._alternative_signers:
            if self.alternative is None:
                raise MalformedError("there is no alternative signature")
            self.alternative.verify(issuer)
            self._alternative_signers.add(issuer.spki)

    @property
    def is_self_issued(self) -> bool:
        """Whether subject and issuer are the same name (RFC 5280 3.2)."""
        return same_name(self.subject_der, self.issuer_der)

    def names_issuer(self, ca: "Certificate") -> bool:
        """Whether the issuer's name is that of `ca` (RFC 5280 6.1.3 (a)(4))."""
        return same_name(self.issuer_der, ca.subject_der)


_IN_USE: WeakValueDictionary[bytes, Certificate] = WeakValueDictionary()
"""DER -> the certificate, of those that `shared` made."""
_AUTHORITIES: WeakValueDictionary[bytes, x509.Name] = WeakValueDictionary()
"""DER -> the name, of CAs in use: what they issued shares it, so it is parsed once."""


def _parsed(der: bytes, subject: bytes, issuer: bytes) -> dict[str, Any]:
    """The names, and what cryptography parses, some of it only when it is asked for, as here."""
    names = {
        "subject": read_name(subject),
        "issuer": _AUTHORITIES.get(issuer) or read_name(issuer),
    }
    with library_call(lambda error: MalformedError(f"not a certificate: {plain_words(error)}")):
        found = x509.load_der_x509_certificate(plain_certificate(der))
        return names | {
            "version": found.version.value + 1,
            "not_before": found.not_valid_before_utc,
            "not_after": found.not_valid_after_utc,
            "extensions": found.extensions,
            "signature": found.signature,
        }
