"""Describes a file in words: certificates, keys, requests, revocation lists, documents.

For an engineer who gets a file and is not an expert in its format. It verifies nothing that
needs another file, and shows nothing of a private key.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.inspection._algorithms import algorithm_name
    from pqsec_pki.inspection.description import Description, Fact
    from pqsec_pki.inspection.recognise import describe
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = ["Description", "Fact", "algorithm_name", "describe"]
