"""Revocation lists (RFC 5280 5): parse and verify them.

Only lists of one CA and for all reasons are supported. One for other issuers, for some reasons, or
of changes only is refused, also if the extension that says so is not critical.
"""

from collections.abc import Iterator
from dataclasses import field
from datetime import datetime
from functools import cached_property, lru_cache
from typing import Self

from cryptography import x509

from pqsec_pki._asn1 import Signed, TBSCertList, decode, encode, moment_of, plain_words, whole_bytes
from pqsec_pki._dataclass import dataclass
from pqsec_pki._times import said
from pqsec_pki.algorithms import first_pem, pem
from pqsec_pki.certificates._alternative import Alternative
from pqsec_pki.certificates._issuers import names_another
from pqsec_pki.certificates._names import name_text
from pqsec_pki.certificates._plain import plain_list
from pqsec_pki.certificates._rdns import read_name, same_name
from pqsec_pki.certificates._scope import covers, limits
from pqsec_pki.certificates.certificate import Certificate
from pqsec_pki.errors import MalformedError, PqsecError, VerificationError, library_call
from pqsec_pki.problems import Code, Problem

_REMOVED = x509.ReasonFlags.remove_from_crl.value
_UNDERSTOOD = {x509.IssuingDistributionPoint.oid, x509.AuthorityKeyIdentifier.oid}
MAX_LIST = 8 << 20
"""Bytes of PEM: some 150,000 certificates."""
_LINE, _LINE_OCTETS = 65, 48
MAX_DER = (MAX_LIST - 2 * _LINE) // _LINE * _LINE_OCTETS
"""Bytes of DER: as many as fit into that in lines of base64. So a list is read in both, or in none.
"""


@dataclass(frozen=True, slots=True)
class RevokedCertificate:
    """One revoked certificate."""

    serial_number: int
    revoked_at: datetime
    reason: str | None
    """The reason as in RFC 5280 5.3.1, such as keyCompromise; None if the list has none."""
    critical: tuple[str, ...] = ()
    """Critical extensions of the entry, dotted."""
    of_another_issuer: bool = False
    """Whether it has a certificateIssuer (5.3.3)."""


@dataclass(frozen=True, eq=False)  # no slots, for cached properties
class RevocationList:
    """A certificate revocation list. It is not verified: see verify."""

    der: bytes = field(repr=False)
    tbs: bytes = field(repr=False)
    """DER TBSCertList: what the signature covers."""
    issuer: x509.Name
    issuer_der: bytes = field(repr=False)
    this_update: datetime
    next_update: datetime | None
    number: int | None
    """The CRL number, if the list has one (5.2.3)."""
    revoked: tuple[RevokedCertificate, ...] = field(repr=False)
    extensions: x509.Extensions = field(repr=False)
    identifier: bytes = field(repr=False)
    """DER AlgorithmIdentifier of the signature, the same inside and outside."""
    signature: bytes = field(repr=False)
    alternative: Alternative | None = field(repr=False)

    @classmethod
    def from_der(cls, der: bytes) -> Self:
        """MalformedError if `der` is not exactly one well-formed revocation list."""
        if len(der) > MAX_DER:
            raise MalformedError(f"a revocation list larger than {MAX_DER} bytes")
        signed = decode(Signed, der, "revocation list")
        tbs_der = encode(signed.tbs)
        plain, plain_tbs = plain_list(der)
        tbs = decode(TBSCertList, plain_tbs, "revocation list")
        if encode(tbs.signature) != encode(signed.signature_algorithm):
            raise MalformedError("the revocation list names two different signature algorithms")
        issuer_der = encode(tbs.issuer)
        extensions, revoked = _library_view(plain)
        return cls(
            der=der,
            tbs=tbs_der,
            issuer=read_name(issuer_der),
            issuer_der=issuer_der,
            this_update=moment_of(tbs.this_update),
            next_update=moment_of(tbs.next_update) if tbs.next_update else None,
            number=_number(extensions),
            revoked=revoked,
            extensions=extensions,
            identifier=encode(tbs.signature),
            signature=whole_bytes(signed.signature, "the revocation list's signature"),
            alternative=Alternative.of_list(tbs),
        )

    @classmethod
    def from_pem(cls, data: bytes) -> Self:
        """The first revocation list in PEM `data`; MalformedError if there is none."""
        return cls.from_der(first_pem(data, {"X509 CRL"}, "revocation list", limit=MAX_LIST))

    @property
    def pem(self) -> bytes:
        """The revocation list in PEM."""
        return pem("X509 CRL", self.der)

    def names_issuer(self, ca: Certificate) -> bool:
        """Whether the issuer's name is that of `ca`."""
        return same_name(self.issuer_der, ca.subject_der)

    def to_json(self) -> dict[str, object]:
        """Its number, the count of its certificates and when the next is due, for JSON."""
        return {
            "number": self.number,
            "certificates": len(self.revoked),
            "next_update": self.next_update,
        }

    def revocation_of(self, certificate: Certificate) -> RevokedCertificate | None:
        """The entry that revokes `certificate`, if this is its issuer's list and has one."""
        if not same_name(certificate.issuer_der, self.issuer_der):
            return None
        return self._by_serial.get(certificate.serial_number)

    def covers(self, certificate: Certificate) -> bool:
        """Whether the list says of `certificate` whether it is revoked, for any reason.

        One with a distribution point is for the certificates that name it (RFC 5280 6.3.3).
        """
        return covers(self.extensions, self.issuer_der, certificate)

    @cached_property
    def _by_serial(self) -> dict[int, RevokedCertificate]:
        # Stacks ignore removeFromCRL, which only changes to a list can have (5.3.1)
        lasting = (each for each in reversed(self.revoked) if each.reason != _REMOVED)
        return {each.serial_number: each for each in lasting}

    def verify(self, ca: Certificate, *, require_alternative: bool = False) -> None:
        """Return if `ca` issued this list and it has no unknown critical extension.

        An alternative signature is verified if the CA has a key for it; with
        `require_alternative` it is required. Whether the list is current and `ca` is valid
        is not checked. VerificationError lists everything that is wrong.
        """
        problems = _lasting_problems(self, ca, required=require_alternative)
        if problems:
            raise VerificationError(*problems)

    def validity_problems(self, now: datetime) -> Iterator[Problem]:
        """RFC 5280 6.3.3 (a): problems if it is not current at `now`."""
        if now < self.this_update:
            yield Problem(
                f"the revocation list is not in force before {said(self.this_update)}",
                Code.LIST_NOT_YET_VALID,
            )
        if self.next_update and now > self.next_update:
            yield Problem(
                f"the revocation list ended on {said(self.next_update)}", Code.LIST_EXPIRED
            )


def verify_not_revoked(
    certificate: Certificate,
    revoked: RevocationList,
    ca: Certificate,
    *,
    now: datetime,
    require_alternative: bool = False,
) -> None:
    """Return if `ca`'s list `revoked` is valid at `now` and does not revoke `certificate`.

    With an invalid list all certificates are refused, as in every measured stack.
    VerificationError lists everything that is wrong.
    """
    problems = [
        *_lasting_problems(revoked, ca, required=require_alternative),
        *revoked.validity_problems(now),
    ]
    if not revoked.covers(certificate):
        who = certificate.subject_name
        words = f"the revocation list is not for the certificate of {who} (distribution point)"
        problems.append(Problem(words, Code.LIST_SCOPE))
    entry = revoked.revocation_of(certificate)
    if entry:
        reason = f" ({entry.reason})" if entry.reason else ""
        when = said(entry.revoked_at)
        who = certificate.subject_name
        problems.append(
            Problem(f"the certificate of {who} was revoked on {when}{reason}", Code.REVOKED)
        )
    if problems:
        raise VerificationError(*problems)


@lru_cache(maxsize=16)
def _lasting_problems(
    crl: RevocationList, ca: Certificate, *, required: bool
) -> tuple[Problem, ...]:
    """Problems that do not depend on time, cached: each handshake needs them for the list."""
    return (
        *_issuer_problems(crl, ca),
        *_alternative_problems(crl, ca, required=required),
        *_scope_problems(crl),
        *_critical_problems(crl),
    )


def _issuer_problems(crl: RevocationList, ca: Certificate) -> Iterator[Problem]:
    # RFC 5280 6.3.3 (b): the issuer's name
    if not crl.names_issuer(ca):
        issuer = name_text(crl.issuer)
        yield Problem(
            f"the revocation list was issued by {issuer}, not by {ca.subject_name}",
            Code.LIST_WRONG_ISSUER,
        )
        return
    # (c): the issuer's key, if the list names it
    if names_another(crl.extensions, ca):
        yield Problem(
            "the revocation list names another key or certificate of the CA"
            " (authorityKeyIdentifier)",
            Code.LIST_WRONG_ISSUER,
        )
    # (f): cRLSign, if keyUsage is present
    usage = ca.extension(x509.KeyUsage)
    if usage is not None and not usage.crl_sign:
        yield Problem(
            "the CA certificate may not sign revocation lists (keyUsage lacks cRLSign)",
            Code.KEY_USAGE,
        )
    # (g): the signature
    try:
        ca.public_key.verify(crl.signature, crl.tbs, crl.identifier)
    except PqsecError:
        yield Problem(
            "the revocation list is not signed by this CA (same name, another key, or altered)",
            Code.LIST_BAD_SIGNATURE,
        )


def _alternative_problems(
    crl: RevocationList, ca: Certificate, *, required: bool
) -> Iterator[Problem]:
    try:
        key = ca.alternative_key
        signed = crl.alternative is not None and crl.alternative.signature is not None
        if required and key is None:
            yield Problem("the CA certificate has no alternative key", Code.ALTERNATIVE_MISSING)
        if required and not signed:
            yield Problem(
                "the revocation list has no alternative signature", Code.ALTERNATIVE_MISSING
            )
        if key is not None and signed and crl.alternative is not None:
            crl.alternative.verify(key)
    except PqsecError as error:
        yield Problem(
            f"the alternative signature of the revocation list: {error}", Code.ALTERNATIVE_BAD
        )


def _scope_problems(crl: RevocationList) -> Iterator[Problem]:
    # RFC 5280 5.2.4, 5.2.5: also if the extension is wrongly not critical
    for words in limits(crl.extensions):
        yield Problem(f"the revocation list is not complete: {words}", Code.LIST_SCOPE)
    if any(each.of_another_issuer for each in crl.revoked):
        words = "the revocation list has entries of other CAs (certificateIssuer)"
        yield Problem(words, Code.LIST_SCOPE)


def _critical_problems(crl: RevocationList) -> Iterator[Problem]:
    # RFC 5280 5.2, 5.3: a list with unknown critical extensions must not be used
    for extension in crl.extensions:
        if extension.critical and extension.oid not in _UNDERSTOOD:
            oid = extension.oid.dotted_string
            yield Problem(
                f"the revocation list has an unknown critical extension {oid}",
                Code.CRITICAL_EXTENSION,
            )
    for oid in sorted({oid for each in crl.revoked for oid in each.critical}):
        yield Problem(
            f"the revocation list has entries with an unknown critical extension {oid}",
            Code.CRITICAL_EXTENSION,
        )


_View = tuple[x509.Extensions, tuple[RevokedCertificate, ...]]


def _library_view(der: bytes) -> _View:
    with library_call(lambda error: MalformedError(f"not a revocation list: {plain_words(error)}")):
        parsed = x509.load_der_x509_crl(der)
        return parsed.extensions, tuple(map(_revoked, parsed))


def _revoked(entry: x509.RevokedCertificate) -> RevokedCertificate:
    reason, foreign, critical = None, False, []
    for extension in entry.extensions:
        if isinstance(extension.value, x509.CRLReason):
            reason = extension.value.reason.value
        foreign |= isinstance(extension.value, x509.CertificateIssuer)
        if extension.critical:  # also a reason: stacks refuse the list
            critical.append(extension.oid.dotted_string)
    when = entry.revocation_date_utc
    return RevokedCertificate(entry.serial_number, when, reason, tuple(critical), foreign)


def _number(extensions: x509.Extensions) -> int | None:
    try:
        return extensions.get_extension_for_class(x509.CRLNumber).value.crl_number
    except x509.ExtensionNotFound:
        return None
