"""X.509: authorities, the certificates they issue, and checking that they did.

For everyone who has to know who a participant is: issuing, the handshake, reports.
"""

from pqsec_pki.certificates.authority import Authority, common_name, end_of
from pqsec_pki.certificates.certificate import Certificate
from pqsec_pki.certificates.chain import verify_authority, verify_chain, verify_validity

__all__ = [
    "Authority",
    "Certificate",
    "common_name",
    "end_of",
    "verify_authority",
    "verify_chain",
    "verify_validity",
]
