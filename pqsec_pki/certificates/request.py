"""Certificate requests (PKCS#10, RFC 2986): parse them, and verify the proof of possession.

A request is signed with the private key of the requested certificate: proof of possession.
With an alternative key it has a second proof (see _alternative). One for several sets of
credentials carries the requests of the further ones (see _beside).
"""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import field
from typing import Self

from cryptography import x509
from cryptography.x509.oid import AttributeOID

from pqsec_pki._asn1 import (
    CertificationRequestInfo,
    Signed,
    decode,
    encode,
    plain_words,
    whole_bytes,
)
from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import MAX_FILE
from pqsec_pki.algorithms import PublicKey, first_pem, load_public_key, pem, unpem
from pqsec_pki.certificates import _beside
from pqsec_pki.certificates._alternative import Alternative
from pqsec_pki.certificates._names import lone_common_name, name_text
from pqsec_pki.errors import (
    MalformedError,
    PqsecError,
    TooLargeError,
    VerificationError,
    library_call,
)

MAX_REQUEST = 256 << 10
"""Bytes of PEM or DER, as for a certificate."""
MAX_REQUESTS = 2_000
"""Requests in one file: as many participants as an archive may have."""
_LABELS = {"CERTIFICATE REQUEST", "NEW CERTIFICATE REQUEST"}


@dataclass(frozen=True, slots=True, eq=False)
class CertificateRequest:
    """A certificate request. The CA decides whether to issue what it asks for."""

    der: bytes = field(repr=False)
    info: bytes = field(repr=False)
    """DER CertificationRequestInfo: what the signature covers."""
    subject: x509.Name
    subject_der: bytes = field(repr=False)
    spki: bytes = field(repr=False)
    extensions: x509.Extensions = field(repr=False)
    """The requested extensions of the certificate."""
    identifier: bytes = field(repr=False)
    """DER AlgorithmIdentifier of the signature."""
    signature: bytes = field(repr=False)
    alternative: Alternative | None = field(repr=False)
    first_key: bytes | None = field(repr=False)
    """For a request that another one carries: the hash of the key of that one."""
    further: "tuple[CertificateRequest, ...]" = field(repr=False)
    """The requests that it carries, for the further sets of credentials."""

    @classmethod
    def from_der(cls, der: bytes) -> Self:
        """MalformedError if `der` is not exactly one well-formed request, with what it carries."""
        return cls._from_der(der, carried=False)

    @classmethod
    def _from_der(cls, der: bytes, *, carried: bool) -> Self:
        if len(der) > MAX_REQUEST:
            raise MalformedError(f"a certificate request larger than {MAX_REQUEST} bytes")
        signed = decode(Signed, der, "certificate request")
        info_der = encode(signed.tbs)
        info = decode(CertificationRequestInfo, info_der, "certificate request")
        subject, extensions = _library_view(der)
        further = _beside.further_in(info)
        if further and carried:  # and no request is read in depth
            raise MalformedError("a request that another one carries carries further ones")
        return cls(
            der=der,
            info=info_der,
            subject=subject,
            subject_der=encode(info.subject),
            spki=encode(info.subject_public_key_info),
            extensions=extensions,
            identifier=encode(signed.signature_algorithm),
            signature=whole_bytes(signed.signature, "the request's signature"),
            alternative=Alternative.of_request(info),
            first_key=_beside.first_key_in(info),
            further=tuple(cls._from_der(each, carried=True) for each in further),
        )

    @classmethod
    def from_pem(cls, data: bytes) -> Self:
        """The first request in PEM `data`; MalformedError if there is none."""
        return cls.from_der(first_pem(data, _LABELS, "certificate request", limit=MAX_REQUEST))

    @classmethod
    def all_from_pem(cls, data: bytes) -> tuple[Self, ...]:
        """All requests in PEM `data`; `from_pem` returns the first.

        MalformedError if there is none, one of them is broken, or there are over MAX_REQUESTS.
        """
        found = [der for label, der in unpem(data, "certificate request") if label in _LABELS]
        if not found:
            raise MalformedError("no certificate request in PEM")
        if len(found) > MAX_REQUESTS:
            raise MalformedError(f"more than {MAX_REQUESTS} certificate requests")
        return tuple(map(cls.from_der, found))

    @classmethod
    def all_to_pem(cls, requests: Sequence[Self]) -> bytes:
        """All in PEM, for one file; TooLargeError for more than `all_from_pem` or a file takes."""
        hint = "write several files, each with fewer requests"
        TooLargeError.check("the file", len(requests), MAX_REQUESTS, hint=hint, unit="requests")
        data = b"".join(each.pem for each in requests)
        TooLargeError.check("the file", len(data), MAX_FILE, hint=hint)
        return data

    @property
    def sets(self) -> "tuple[CertificateRequest, ...]":
        """The request for each set of credentials, that of the first one first."""
        return (self, *self.further)

    @property
    def pem(self) -> bytes:
        """The request in PEM."""
        return pem("CERTIFICATE REQUEST", self.der)

    @property
    def public_key(self) -> PublicKey:
        """The key to be certified; UnknownAlgorithmError if no row is for it."""
        return load_public_key(self.spki)

    @property
    def alternative_spki(self) -> bytes | None:
        """DER SubjectPublicKeyInfo of the alternative key to be certified, if there is one."""
        return self.alternative.spki if self.alternative else None

    @property
    def alternative_key(self) -> PublicKey | None:
        """The alternative key to be certified, if there is one."""
        return None if self.alternative_spki is None else load_public_key(self.alternative_spki)

    @property
    def common_name(self) -> str | None:
        """The subject's CN, if the subject is a single CN."""
        return lone_common_name(self.subject)

    @property
    def challenge_password(self) -> bytes | None:
        """The characters of its challenge password (RFC 2985 5.4.1); None without one.

        MalformedError for several.
        """
        with library_call(
            lambda error: MalformedError(f"the request's attributes: {plain_words(error)}")
        ):
            found = x509.load_der_x509_csr(self.der).attributes
            try:
                return found.get_attribute_for_oid(AttributeOID.CHALLENGE_PASSWORD).value
            except x509.AttributeNotFound:
                return None

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the DER, in hex."""
        return hashlib.sha256(self.der).hexdigest()

    @property
    def subject_name(self) -> str:
        """The subject as in permissions documents: RFC 2253, with OpenSSL's names of attributes."""
        return name_text(self.subject)

    def verify(self) -> None:
        """Return if the request proves possession of its key, and of its alternative key if any.

        And so each one that it carries, which must be made for it, with the same subject.
        VerificationError lists everything that is wrong.
        """
        problems = [*self._problems()]
        if self.first_key is not None:
            problems.append("it belongs beside the request for another key, and came alone")
        for number, each in enumerate(self.further, 2):
            found = [*each._problems(), *self._problems_beside(each)]  # noqa: SLF001 -- its own
            problems += [f"request {number} of it: {problem}" for problem in found]
        if problems:
            raise VerificationError(*problems)

    def _problems_beside(self, other: "CertificateRequest") -> Iterator[str]:
        if other.subject_der != self.subject_der:
            yield f"its subject is {other.subject_name or 'empty'}, not {self.subject_name}"
        if other.first_key != _beside.hash_of(self.spki):
            yield "it was not made beside the first one: it names another key, or none"

    def _problems(self) -> Iterator[str]:
        try:
            self.public_key.verify(self.signature, self.info, self.identifier)
        except PqsecError as error:
            yield f"no proof that the requester has the private key: {error}"
        try:
            self._verify_alternative()
        except PqsecError as error:
            yield f"no proof that the requester has the alternative private key: {error}"

    def _verify_alternative(self) -> None:
        if self.alternative is None:
            return
        key = self.alternative_key
        if key is None:
            raise MalformedError("there is a signature and no alternative key")
        self.alternative.verify(key)


def _library_view(der: bytes) -> tuple[x509.Name, x509.Extensions]:
    words = "not a certificate request"
    with library_call(lambda error: MalformedError(f"{words}: {plain_words(error)}")):
        parsed = x509.load_der_x509_csr(der)
        return parsed.subject, parsed.extensions
