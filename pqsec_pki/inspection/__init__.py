"""What a file is, in words: certificates, keys, requests, revocation lists, documents.

For an engineer who is handed a file and is no expert in it. Nothing is verified here
that needs another file, and nothing private is ever told.
"""

from pqsec_pki.inspection.description import Description, Fact
from pqsec_pki.inspection.recognise import describe

__all__ = ["Description", "Fact", "describe"]
