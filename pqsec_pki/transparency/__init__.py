"""Merkle trees over a log, signed heads of the log, and proofs; no files or clock.

`tree` has the hash tree of RFC 9162 with inclusion and consistency proofs, `checkpoint` a head of
the log as a C2SP checkpoint, which is a signed note, `extension` a head with the proof that it
continues an earlier one, and `proof` the proof that lines are in the log.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.transparency.checkpoint import HASH, Checkpoint, TreeHead, key_id
    from pqsec_pki.transparency.extension import HeadExtension
    from pqsec_pki.transparency.proof import LedgerProof, ProvenLine, leaf_of
    from pqsec_pki.transparency.tree import (
        EMPTY,
        CompactRange,
        MerkleTree,
        leaf_hash,
        root_by_inclusion,
        verify_consistency,
    )
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "EMPTY",
    "HASH",
    "Checkpoint",
    "CompactRange",
    "HeadExtension",
    "LedgerProof",
    "MerkleTree",
    "ProvenLine",
    "TreeHead",
    "key_id",
    "leaf_hash",
    "leaf_of",
    "root_by_inclusion",
    "verify_consistency",
]
