"""Proofs that what a bundle has is in the ledger of which the CAs signed a head."""

from collections.abc import Iterable, Mapping
from dataclasses import field
from pathlib import Path
from typing import Self, TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki.credentials import LOGGED, logged_hashes
from pqsec_pki.errors import MalformedError, VerificationError
from pqsec_pki.keystore._ledger import Ledger, Row
from pqsec_pki.keystore.heads import read_head
from pqsec_pki.transparency import Checkpoint, LedgerProof, MerkleTree, ProvenLine, leaf_of

_Subject: TypeAlias = tuple[str, str]
"""The kind and the SHA-256 of a line."""


@dataclass(frozen=True, slots=True)
class LedgerProofs:
    """A signed head of a ledger and the tree below it, read once for all proofs."""

    checkpoint: Checkpoint
    tree: MerkleTree = field(repr=False)
    rows: Mapping[_Subject, Row] = field(repr=False)
    """The lines that the head is over."""

    @classmethod
    def of(cls, root: Path, ledger: Ledger) -> Self | None:
        """The proofs for `ledger`, of the keystore at `root`.

        None if there is no signed head, or the ledger no longer has what was signed.
        """
        try:
            checkpoint = read_head(root)
        except (MalformedError, VerificationError):
            return None
        if checkpoint is None:
            return None
        rows = [row for row in ledger.rows() if row[0] <= checkpoint.head.size]
        tree = MerkleTree(leaf_of(*row) for row in rows)
        if (tree.size, tree.root(tree.size)) != (checkpoint.head.size, checkpoint.head.root):
            return None
        return cls(checkpoint, tree, {(row[1], row[3]): row for row in rows if row[1] in LOGGED})

    def proof(self, enclaves: Iterable[Mapping[str, bytes]]) -> LedgerProof | None:
        """The proof for the files of these enclaves; None if a line is not in the signed tree."""
        wanted = dict.fromkeys(each for files in enclaves for each in logged_hashes(files))
        rows = [self.rows[each] for each in wanted if each in self.rows]
        if len(rows) < len(wanted):
            return None
        return LedgerProof(self.checkpoint, tuple(map(self._proven, rows)))

    def _proven(self, row: Row) -> ProvenLine:
        path = self.tree.inclusion(row[0] - 1, self.tree.size)
        return ProvenLine(*row, path=tuple(path))
