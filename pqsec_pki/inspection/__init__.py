"""Describes a file in words: certificates, keys, requests, revocation lists, documents.

For an engineer who gets a file and is not an expert in its format. It verifies nothing that
needs another file, and shows nothing of a private key.
"""

from pqsec_pki.inspection.description import Description, Fact
from pqsec_pki.inspection.recognise import describe

__all__ = ["Description", "Fact", "describe"]
