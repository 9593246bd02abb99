"""What a revocation list is for (RFC 5280 5.2.4, 5.2.5, 6.3.3), critical or not."""

from collections.abc import Iterator

from cryptography import x509

from pqsec_pki.certificates._rdns import same_name
from pqsec_pki.certificates.certificate import Certificate

_Point = x509.DistributionPoint | x509.IssuingDistributionPoint


def limits(extensions: x509.Extensions) -> Iterator[str]:
    """Why the list with these extensions says nothing about participants, or not everything."""
    point = _issuing(extensions)
    if any(isinstance(each.value, x509.DeltaCRLIndicator) for each in extensions):
        yield "it has only changes (deltaCRLIndicator)"
    if point is None:
        return
    others = {
        "onlyContainsCACerts": point.only_contains_ca_certs,
        "onlyContainsAttributeCerts": point.only_contains_attribute_certs,
        "indirectCRL": point.indirect_crl,
    }
    for name in (name for name, is_set in others.items() if is_set):
        yield f"it is for other certificates ({name})"
    if point.only_some_reasons is not None:
        yield "it is for some reasons (onlySomeReasons)"
    if point.relative_name is not None:
        yield "its distribution point has a relative name"


def covers(extensions: x509.Extensions, issuer: bytes, certificate: Certificate) -> bool:
    """Whether the list of `issuer` (DER Name) with these extensions is for `certificate`.

    The first distribution point of the certificate that the list is for decides, as in OpenSSL.
    """
    point = _issuing(extensions)
    for each in certificate.extension(x509.CRLDistributionPoints) or ():
        if _is_issued_by(each, issuer) and (point is None or _is_same(each, point)):
            return each.reasons is None or len(each.reasons) == _ALL_REASONS
    return point is None or point.full_name is None


_ALL_REASONS = 8
"""Of the ten of x509.ReasonFlags: not unspecified and removeFromCRL (4.2.1.13)."""


def _issuing(extensions: x509.Extensions) -> x509.IssuingDistributionPoint | None:
    try:
        return extensions.get_extension_for_class(x509.IssuingDistributionPoint).value
    except x509.ExtensionNotFound:
        return None


def _is_issued_by(point: x509.DistributionPoint, issuer: bytes) -> bool:
    return point.crl_issuer is None or any(
        isinstance(each, x509.DirectoryName) and same_name(each.value.public_bytes(), issuer)
        for each in point.crl_issuer
    )


def _is_same(one: _Point, other: _Point) -> bool:
    """6.3.3 (b)(2)(i); a missing name is any."""
    if one.relative_name is not None:
        return False
    if one.full_name is None or other.full_name is None:
        return True
    return any(_is_equal(a, b) for a in one.full_name for b in other.full_name)


def _is_equal(one: x509.GeneralName, other: x509.GeneralName) -> bool:
    if isinstance(one, x509.DirectoryName) and isinstance(other, x509.DirectoryName):
        return same_name(one.value.public_bytes(), other.value.public_bytes())
    return one == other
