"""X.509: CAs, the certificates that they issue, and the verification of those.

For issuing certificates, the handshake, and reports.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.certificates._alternative import alternative_attributes
    from pqsec_pki.certificates._beside import FURTHER_REQUESTS
    from pqsec_pki.certificates._names import name_text
    from pqsec_pki.certificates._rdns import canonical_name, read_name, same_name
    from pqsec_pki.certificates._sequence import SEQUENCE_NUMBER, read_sequence_number
    from pqsec_pki.certificates.authority import (
        BACKDATE,
        LAST_YEAR,
        MAX_COMMON_NAME,
        Authority,
        common_name,
        end_of,
    )
    from pqsec_pki.certificates.certificate import Certificate
    from pqsec_pki.certificates.chain import verify_authority, verify_chain
    from pqsec_pki.certificates.request import CertificateRequest
    from pqsec_pki.certificates.requesting import certificate_request
    from pqsec_pki.certificates.revocation import (
        RevocationList,
        RevokedCertificate,
        verify_not_revoked,
    )
    from pqsec_pki.certificates.revoking import Reason, revocation_list
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "BACKDATE",
    "FURTHER_REQUESTS",
    "LAST_YEAR",
    "MAX_COMMON_NAME",
    "SEQUENCE_NUMBER",
    "Authority",
    "Certificate",
    "CertificateRequest",
    "Reason",
    "RevocationList",
    "RevokedCertificate",
    "alternative_attributes",
    "canonical_name",
    "certificate_request",
    "common_name",
    "end_of",
    "name_text",
    "read_name",
    "read_sequence_number",
    "revocation_list",
    "same_name",
    "verify_authority",
    "verify_chain",
    "verify_not_revoked",
]
