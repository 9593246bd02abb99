"""Describes a certificate."""

from datetime import datetime

from cryptography import x509

from pqsec_pki.certificates import Certificate, name_text
from pqsec_pki.inspection import _algorithms, _extensions, _times
from pqsec_pki.inspection.description import Description, Fact

CA, PARTICIPANT, UNMARKED = "ca", "participant", "unmarked"


def describe_certificate(der: bytes, now: datetime) -> Description:
    """The description of the certificate in `der`; MalformedError if it is not a certificate."""
    certificate = Certificate.from_der(der)
    role, title, words = _role(certificate)
    facts = (
        Fact.of("subject", certificate.subject_name),
        Fact.of("role", role, words),
        _issuer(certificate),
        Fact.of("serial", f"{certificate.serial_number:x}"),
        Fact.of("version", certificate.version, f"X.509 version {certificate.version}"),
        _times.validity(certificate.not_before, certificate.not_after, now),
        _algorithms.key_fact("key", certificate.spki),
        _algorithms.alternative_key_fact(certificate.alternative_spki),
        *_stacks(certificate, role),
        *_signatures(certificate),
        _extensions.extensions_fact("extensions", certificate.extensions),
        _algorithms.spki_digest(certificate.spki),
        Fact.of("SHA-256", certificate.fingerprint, key="sha256"),
    )
    return Description("certificate", f"{title}: {certificate.subject_name}", facts)


def _role(certificate: Certificate) -> tuple[str, str, str]:
    """(role, title, words)."""
    constraints = certificate.extension(x509.BasicConstraints)
    is_ca = constraints is not None and constraints.ca
    if is_ca and _may_sign_certificates(certificate):
        return CA, "CA certificate", "identity CA or permissions CA: may sign certificates"
    if is_ca:
        words = "marked as a CA, but its key usage does not allow signing certificates"
        return UNMARKED, "CA certificate that cannot issue", words
    if certificate.is_self_issued:
        words = "its own issuer, but not marked as a CA: cannot be an identity CA"
        return UNMARKED, "Self-signed certificate", words
    return PARTICIPANT, "Participant certificate", "an identity; may not sign certificates"


def _may_sign_certificates(certificate: Certificate) -> bool:
    usage = certificate.extension(x509.KeyUsage)
    return usage is None or usage.key_cert_sign


def _issuer(certificate: Certificate) -> Fact:
    name = name_text(certificate.issuer)
    return Fact.of("issuer", name, "itself" if certificate.is_self_issued else name)


def _stacks(certificate: Certificate, role: str) -> tuple[Fact, ...]:
    found = _algorithms.identity_stacks(certificate.spki, certificate.identifier)
    words = found or "none"
    if found and certificate.alternative is not None:
        words += "; all but pqsec ignore its alternative key and signature"
    label = "stacks (as identity CA)" if role == CA else "stacks"
    return (Fact("runs_in", found, rows=((label, words),)),)


def _signatures(certificate: Certificate) -> tuple[Fact, ...]:
    plain = _algorithms.algorithm_name(certificate.signature_algorithm)
    facts = [Fact.of("signature", plain, f"{plain} (not verified)")]
    alternative = certificate.alternative
    if alternative is None or alternative.identifier is None:
        return (*facts, Fact.of("alternative signature", None, "none"))
    second = _algorithms.algorithm_name(_algorithms.oid_of(alternative.identifier))
    return (*facts, Fact.of("alternative signature", second, f"{second} (not verified)"))
