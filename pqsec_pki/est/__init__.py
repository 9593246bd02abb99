"""Enrolment over a network: EST (RFC 7030) and pqsec's own requests for whole bundles.

TLS for both sides (`tls.py`, the only user of pyOpenSSL, which is an extra of the package), and
the file with a robot's enrolment token (`token_file.py`). A module that uses TLS is imported in
`needs_libraries`, which says how to get the library.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.est.client import EstClient, ServerAnswer, WasRevokedError
    from pqsec_pki.est.known_server import KnownServer
    from pqsec_pki.est.linking import verify_est_request
    from pqsec_pki.est.messages import certs_only, from_base64, request_attributes, to_base64
    from pqsec_pki.est.obtaining import KeyTerms, WaitingError
    from pqsec_pki.est.paths import (
        BUNDLE,
        BUNDLE_TYPE,
        CSRATTRS,
        EST,
        HEAD,
        PEM_FILE,
        PKCS7,
        PKCS10,
        PKIX_CRL,
        PROBLEM,
        RECEIPT_TYPE,
        RECEIPTS,
        REQUEST_ENDED,
        REQUESTS,
        REVOCATION_LIST,
        TEXT,
        WAS_REVOKED,
    )
    from pqsec_pki.est.robot import Obtained, deliver_receipt, enrol, renew
    from pqsec_pki.est.signing import (
        CERTIFICATE_HEADER,
        SCHEME,
        NotSignedError,
        RequestSigner,
        verify_signed,
    )
    from pqsec_pki.est.tls import (
        GROUP,
        ServerTrust,
        TlsIdentity,
        client_context,
        peer_certificate,
        peer_chain,
        refuse_classical,
        server_context,
        spki_pin,
    )
    from pqsec_pki.est.token_file import (
        MAX_TOKEN_FILE,
        EnrolmentToken,
        checked_url,
        is_secret,
        server_pin,
    )
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "BUNDLE",
    "BUNDLE_TYPE",
    "CERTIFICATE_HEADER",
    "CSRATTRS",
    "EST",
    "GROUP",
    "HEAD",
    "MAX_TOKEN_FILE",
    "PEM_FILE",
    "PKCS7",
    "PKCS10",
    "PKIX_CRL",
    "PROBLEM",
    "RECEIPTS",
    "RECEIPT_TYPE",
    "REQUESTS",
    "REQUEST_ENDED",
    "REVOCATION_LIST",
    "SCHEME",
    "TEXT",
    "WAS_REVOKED",
    "EnrolmentToken",
    "EstClient",
    "KeyTerms",
    "KnownServer",
    "NotSignedError",
    "Obtained",
    "RequestSigner",
    "ServerAnswer",
    "ServerTrust",
    "TlsIdentity",
    "WaitingError",
    "WasRevokedError",
    "certs_only",
    "checked_url",
    "client_context",
    "deliver_receipt",
    "enrol",
    "from_base64",
    "is_secret",
    "peer_certificate",
    "peer_chain",
    "refuse_classical",
    "renew",
    "request_attributes",
    "server_context",
    "server_pin",
    "spki_pin",
    "to_base64",
    "verify_est_request",
    "verify_signed",
]
