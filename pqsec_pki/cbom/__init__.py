"""Cryptographic bills of materials (CBOM) in CycloneDX 1.7.

What cryptography keystores, enclaves and other folders have: algorithms, certificates, keys
without their bits, and protocols. Nothing is verified: `lint` and `credentials` do that.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.cbom.bill import Bill, bill_of
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = ["Bill", "bill_of"]
