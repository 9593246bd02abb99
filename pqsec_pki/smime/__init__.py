"""S/MIME: a document and its signature in one file, as DDS-Security requires.

Signs governance and permissions, and verifies that the permissions CA signed them.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.smime._mime import is_signed
    from pqsec_pki.smime._reading import AmbiguousError
    from pqsec_pki.smime._signer_info import Signer
    from pqsec_pki.smime.document import (
        FoundSignature,
        Require,
        Verified,
        document_in,
        is_canonical,
        joined,
        parts_of,
        sign,
        verify,
    )
    from pqsec_pki.smime.listing import CmsContent, ListedSigner, signers_in
    from pqsec_pki.smime.signed_file import SignedFile
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "AmbiguousError",
    "CmsContent",
    "FoundSignature",
    "ListedSigner",
    "Require",
    "SignedFile",
    "Signer",
    "Verified",
    "document_in",
    "is_canonical",
    "is_signed",
    "joined",
    "parts_of",
    "sign",
    "signers_in",
    "verify",
]
