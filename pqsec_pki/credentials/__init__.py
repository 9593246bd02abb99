"""Decide whether an enclave's credentials can be trusted; no other room does.

`Credentials` are the bytes of an enclave's files, read; `TrustAnchors` are the CAs among them,
each with its role; `verify_credentials` returns `VerifiedCredentials`: identity, governance and
permissions, verified in the order of DDS-Security 1.1, 9.3.3 and 9.4.3. The room opens no file or
socket and has no clock: the caller supplies the bytes and the time.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.credentials._pem_files import certificates_in, only_certificate, only_list
    from pqsec_pki.credentials._signed_documents import SignedDocument
    from pqsec_pki.credentials.anchors import TrustAnchors
    from pqsec_pki.credentials.enclave import Credentials, alternative_spki
    from pqsec_pki.credentials.logged import (
        PROOF,
        logged_hashes,
        missing_proof,
        verify_logged,
    )
    from pqsec_pki.credentials.names import (
        ALT_KEY,
        CA_FILES,
        CERTIFICATE,
        ENCLAVES,
        FILES,
        GOVERNANCE,
        IDENTITY_CA,
        KEY,
        KEYS,
        NEEDED,
        PERMISSIONS,
        PERMISSIONS_ALT_CA,
        PERMISSIONS_CA,
        REQUEST,
        REVOCATION_LIST,
        SIX,
    )
    from pqsec_pki.credentials.verification import (
        VerifiedCredentials,
        VerifiedDocuments,
        distinct,
        grant_of,
        identity_problems,
        key_problems,
        subject_problems,
        verify_credentials,
        verify_documents,
    )
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "ALT_KEY",
    "CA_FILES",
    "CERTIFICATE",
    "ENCLAVES",
    "FILES",
    "GOVERNANCE",
    "IDENTITY_CA",
    "KEY",
    "KEYS",
    "NEEDED",
    "PERMISSIONS",
    "PERMISSIONS_ALT_CA",
    "PERMISSIONS_CA",
    "PROOF",
    "REQUEST",
    "REVOCATION_LIST",
    "SIX",
    "Credentials",
    "SignedDocument",
    "TrustAnchors",
    "VerifiedCredentials",
    "VerifiedDocuments",
    "alternative_spki",
    "certificates_in",
    "distinct",
    "grant_of",
    "identity_problems",
    "key_problems",
    "logged_hashes",
    "missing_proof",
    "only_certificate",
    "only_list",
    "subject_problems",
    "verify_credentials",
    "verify_documents",
    "verify_logged",
]
