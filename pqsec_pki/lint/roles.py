"""The role of a certificate.

The file name gives the role, as SROS2 and every stack's examples name files.
"""

from enum import StrEnum

from cryptography import x509

from pqsec_pki.certificates import Certificate


class CertificateRole(StrEnum):
    """The role of a certificate, as messages write it."""

    PARTICIPANT = "participant"
    IDENTITY_CA = "identity CA"
    PERMISSIONS_CA = "permissions CA"
    COUNTERSIGNER = "countersigner"
    CA = "CA"
    """A CA for both purposes, as SROS2 has it, or another self-issued certificate."""

    @property
    def identifies(self) -> bool:
        """Whether authentication uses it."""
        return self in {
            CertificateRole.PARTICIPANT,
            CertificateRole.IDENTITY_CA,
            CertificateRole.CA,
        }

    @property
    def issues(self) -> bool:
        """Whether it signs participants' certificates."""
        return self in {CertificateRole.IDENTITY_CA, CertificateRole.CA}

    @property
    def signs_documents(self) -> bool:
        """Whether stacks check documents against it."""
        return self in {CertificateRole.PERMISSIONS_CA, CertificateRole.CA}


_NAMES = {
    "identity_ca": CertificateRole.IDENTITY_CA,
    "permissions_ca.alt": CertificateRole.COUNTERSIGNER,
    "permissions_ca": CertificateRole.PERMISSIONS_CA,
    "ca.": CertificateRole.CA,
    "cert.": CertificateRole.PARTICIPANT,
}


def role_of(name: str, certificate: Certificate | None) -> CertificateRole:
    """The role by the file's name; for other names, by whether it is marked as a CA."""
    for start, role in _NAMES.items():
        if name.startswith(start):
            return role
    return (
        CertificateRole.CA
        if certificate and _looks_like_ca(certificate)
        else CertificateRole.PARTICIPANT
    )


def _looks_like_ca(certificate: Certificate) -> bool:
    constraints = certificate.extension(x509.BasicConstraints)
    return constraints.ca if constraints else certificate.is_self_issued
