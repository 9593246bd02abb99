"""Verify that a CA issued a certificate, and that both are valid now (RFC 5280 6.1).

DDS-Security uses self-signed CAs that issue participants' certificates directly, so a chain
is two certificates. cryptography's verifier cannot be used: it refuses composite and
Ed25519 authorities and does not know alternative signatures (docs/explanation/adr/0002).
"""

from collections.abc import Iterator
from datetime import datetime
from functools import lru_cache

from cryptography import x509

from pqsec_pki._dataclass import dataclass
from pqsec_pki._times import exact
from pqsec_pki.algorithms import broken_digest
from pqsec_pki.certificates._constraints import violations
from pqsec_pki.certificates._issuers import names_another
from pqsec_pki.certificates._rdns import same_name
from pqsec_pki.certificates.certificate import Certificate
from pqsec_pki.errors import PqsecError, VerificationError
from pqsec_pki.problems import Code, Problem

_CA = "the CA certificate"
_UNDERSTOOD = {
    "2.5.29.15",  # keyUsage
    "2.5.29.17",  # subjectAltName
    "2.5.29.19",  # basicConstraints
    "2.5.29.30",  # nameConstraints
    "2.5.29.31",  # cRLDistributionPoints
    "2.5.29.32",  # certificatePolicies
    "2.5.29.33",  # policyMappings
    "2.5.29.36",  # policyConstraints
    "2.5.29.37",  # extKeyUsage
    "2.5.29.54",  # inhibitAnyPolicy
    "2.16.840.1.113730.1.1",  # Netscape's certificate type
    "1.3.6.1.5.5.7.48.1.5",  # no check by OCSP
    "1.3.6.1.5.5.7.1.7",  # addresses (RFC 3779), of a CA
    "1.3.6.1.5.5.7.1.8",  # numbers of autonomous systems (RFC 3779), of a CA
}
"""Critical extensions that are accepted: by every measured stack, too.

No purpose is defined for DDS participants, so any extKeyUsage and certificate type is accepted. No
policy is required, so that any set of policies is (6.1.1, with an empty user-initial-policy-set).
"""
_PROXY = x509.ObjectIdentifier("1.3.6.1.5.5.7.1.14")
_RESOURCES = {x509.ObjectIdentifier(f"1.3.6.1.5.5.7.1.{number}") for number in (7, 8)}
"""RFC 3779. OpenSSL accepts those of a participant only if its CA has them too."""


def verify_chain(
    leaf: Certificate,
    authority: Certificate,
    *,
    now: datetime,
    require_alternative: bool = False,
) -> None:
    """Return if `authority` issued `leaf` and both are valid at `now`.

    An alternative signature is verified if the CA has a key for it; with
    `require_alternative` it is required. Revocation is not checked here. VerificationError
    lists everything that is wrong.
    """
    problems = [
        *_authority_problems(authority, now),
        *_leaf_problems(leaf, authority, now),
        *_alternative_problems(leaf, authority, required=require_alternative),
    ]
    if problems:
        raise VerificationError(*problems)


def verify_authority(authority: Certificate, *, now: datetime) -> None:
    """Return if `authority` is a valid CA at `now`; VerificationError lists what is wrong."""
    problems = list(_authority_problems(authority, now))
    if problems:
        raise VerificationError(*problems)


@dataclass(frozen=True, slots=True)
class _Holder:
    """The words for a certificate in messages, made only if there is a problem."""

    certificate: Certificate

    def __str__(self) -> str:
        return f"the certificate of {self.certificate.subject_name}"


def _authority_problems(authority: Certificate, now: datetime) -> Iterator[Problem]:
    yield from _lasting_problems(authority)
    yield from _validity_problems(authority, _CA, now)


@lru_cache(maxsize=16)
def _lasting_problems(authority: Certificate) -> tuple[Problem, ...]:
    """Problems that do not depend on time, cached: each handshake needs them for the CA."""
    return tuple(_find_lasting_problems(authority, _CA))


def _find_lasting_problems(authority: Certificate, who: str) -> Iterator[Problem]:
    # 6.1.4 (k): basicConstraints present, cA true. A certificate of version 1 has none; it is a
    # CA because the user configured it as a trust anchor: a name and a key (6.1.1 (d))
    constraints = authority.extension(x509.BasicConstraints)
    if authority.version > 1 and (constraints is None or not constraints.ca):
        yield Problem(f"{who} is not marked as a CA (basicConstraints)", Code.NOT_CA)
    # 6.1.4 (n): keyCertSign, if keyUsage is present
    usage = authority.extension(x509.KeyUsage)
    if usage is not None and not usage.key_cert_sign:
        yield Problem(
            f"{who} may not sign certificates (keyUsage lacks keyCertSign)", Code.KEY_USAGE
        )
    # 6.1.4 (o): unknown critical extensions
    yield from _critical_problems(authority, who)
    # DDS stacks accept only self-signed CAs; the signature must be by its own key
    if not authority.is_self_issued or names_another(authority.extensions, authority):
        yield Problem(f"{who} is not self-signed", Code.NOT_SELF_SIGNED)
    elif not authority.signed(authority):
        yield _signature_problem(
            authority, who, f"the signature of {who} was not made with its own key"
        )


def _signature_problem(certificate: Certificate, who: object, otherwise: str) -> Problem:
    if digest := broken_digest(certificate.identifier):
        otherwise = f"the signature of {who} is made with {digest}, which is no longer safe"
    return Problem(otherwise, Code.BAD_SIGNATURE)


def _leaf_problems(leaf: Certificate, authority: Certificate, now: datetime) -> Iterator[Problem]:
    who = _Holder(leaf)
    # 6.1.3 (a)(4): the issuer's name
    if not leaf.names_issuer(authority):
        issuer, expected = leaf.issuer_name, authority.subject_name
        yield Problem(f"{who} was issued by {issuer}, not by {expected}", Code.WRONG_ISSUER)
    # 6.1.3 (a)(1): the signature
    elif not authority.signed(leaf):
        unsigned = f"{who} is not signed by this CA (same name, another key, or altered)"
        yield _signature_problem(leaf, who, unsigned)
    # 4.2.1.1: the issuer's key, serial number and issuer, if it names them
    elif names_another(leaf.extensions, authority):
        words = "was issued by another key or certificate of the CA (authorityKeyIdentifier)"
        yield Problem(f"{who} {words}", Code.WRONG_ISSUER)
    # OpenSSL takes it for a CA, signed with its own key
    if same_name(leaf.subject_der, authority.subject_der):
        yield Problem(f"{who} has the name of the CA", Code.NOT_PARTICIPANT)
    # 6.1.3 (a)(2): validity
    yield from _validity_problems(leaf, who, now)
    # 6.1.3 (b), (c): names
    for words in violations(leaf, authority):
        yield Problem(f"{who} violates the CA's nameConstraints: {words}", Code.NAME_CONSTRAINTS)
    # 6.1.5 (f): unknown critical extensions
    yield from _critical_problems(leaf, who)
    if not _RESOURCES.isdisjoint(each.oid for each in leaf.extensions):
        yield Problem(f"{who} has addresses or numbers (RFC 3779)", Code.CRITICAL_EXTENSION)
    # 4.2.1.9: a participant is not a CA
    constraints = leaf.extension(x509.BasicConstraints)
    if constraints is not None and constraints.ca:
        yield Problem(f"{who} is a CA's, not a participant's", Code.NOT_PARTICIPANT)
    # 4.2.1.3: it signs handshakes
    usage = leaf.extension(x509.KeyUsage)
    if usage is not None and not usage.digital_signature:
        yield Problem(f"{who} may not sign (keyUsage lacks digitalSignature)", Code.KEY_USAGE)


def _alternative_problems(
    leaf: Certificate, authority: Certificate, *, required: bool
) -> Iterator[Problem]:
    who = _Holder(leaf)
    try:
        key, own = authority.alternative_key, leaf.alternative_key
    except PqsecError as error:
        yield Problem(f"an alternative key cannot be read: {error}", Code.ALTERNATIVE_BAD)
        return
    signed = leaf.alternative is not None and leaf.alternative.signature is not None
    if required and key is None:
        yield Problem("the CA certificate has no alternative key", Code.ALTERNATIVE_MISSING)
    if required and not signed:
        yield Problem(f"{who} has no alternative signature", Code.ALTERNATIVE_MISSING)
    if required and own is None:
        yield Problem(f"{who} has no alternative key", Code.ALTERNATIVE_MISSING)
    if key is None or not signed:
        return
    try:
        leaf.verify_alternative(key)
    except PqsecError as error:
        yield Problem(f"the alternative signature of {who}: {error}", Code.ALTERNATIVE_BAD)


def _critical_problems(certificate: Certificate, who: object) -> Iterator[Problem]:
    for extension in certificate.extensions:
        if extension.oid == _PROXY:
            yield Problem(f"{who} is a proxy certificate (RFC 3820)", Code.CRITICAL_EXTENSION)
            continue
        if extension.critical and extension.oid.dotted_string not in _UNDERSTOOD:
            yield Problem(
                f"{who} has an unknown critical extension {extension.oid.dotted_string}",
                Code.CRITICAL_EXTENSION,
            )


def _validity_problems(certificate: Certificate, who: object, now: datetime) -> Iterator[Problem]:
    if now < certificate.not_before:
        yield Problem(
            f"{who} is not valid before {exact(certificate.not_before)}",
            Code.NOT_YET_VALID,
        )
    if now > certificate.not_after:
        yield Problem(f"{who} expired on {exact(certificate.not_after)}", Code.EXPIRED)
