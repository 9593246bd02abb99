"""Proofs that what a bundle has is in the ledger of which the CAs signed a head."""

from collections.abc import Iterable, Mapping
from dataclasses import field
from pathlib import Path
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.credentials import logged_hashes
from pqsec_pki.errors import MalformedError, VerificationError
from pqsec_pki.keystore._ledger import Ledger, Row
from pqsec_pki.keystore.heads import read_head
from pqsec_pki.transparency import Checkpoint, LedgerProof, MerkleTree, ProvenLine, leaf_of


@dataclass(frozen=True, slots=True)
class LedgerProofs:
    """A signed head of a ledger and the tree over its lines, for proofs that are made at once."""

    checkpoint: Checkpoint
    tree: MerkleTree = field(repr=False)
    ledger: Ledger = field(repr=False)
    """The open ledger."""
    _found: dict[tuple[str, str], ProvenLine | None] = field(default_factory=dict, repr=False)
    """Lines by kind and SHA-256: bundles share the governance."""

    @classmethod
    def of(cls, root: Path, ledger: Ledger, tree: MerkleTree | None = None) -> Self | None:
        """The proofs for `ledger`, of the keystore at `root`.

        None if there is no signed head, or the ledger no longer has what was signed. A caller that
        makes proofs repeatedly passes the same `tree`, which gets the new lines.
        """
        try:
            checkpoint = read_head(root)
        except (MalformedError, VerificationError):
            return None
        if checkpoint is None:
            return None
        tree, size = tree or MerkleTree(), checkpoint.head.size
        _grow(tree, ledger)
        if tree.size < size or tree.root(size) != checkpoint.head.root:
            tree.clear()
            return None
        return cls(checkpoint, tree, ledger)

    def proof(
        self, enclaves: Iterable[Mapping[str, bytes]], cas: Iterable[tuple[str, str]] = ()
    ) -> LedgerProof | None:
        """The proof for the files of these enclaves; None if a line is not in the signed tree.

        With `cas`, the kinds and SHA-256 of lines about CAs, also for these.
        """
        wanted = dict.fromkeys(each for files in enclaves for each in logged_hashes(files))
        wanted |= dict.fromkeys(cas)
        lines = [line for each in wanted if (line := self._line(*each))]
        if len(lines) < len(wanted):
            return None
        return LedgerProof(self.checkpoint, tuple(lines))

    def _line(self, kind: str, sha256: str) -> ProvenLine | None:
        """The line with its path, if the head is over it."""
        if (kind, sha256) not in self._found:
            row = self._row(kind, sha256)
            self._found[kind, sha256] = self._proven(row) if row else None
        return self._found[kind, sha256]

    def _row(self, kind: str, sha256: str) -> Row | None:
        """The line, if the head is over it."""
        number = self.ledger.line_of((kind,), sha256)
        return self.ledger.row(number) if 0 < number <= self.checkpoint.head.size else None

    def _proven(self, row: Row) -> ProvenLine:
        path = self.tree.inclusion(row[0] - 1, self.checkpoint.head.size)
        return ProvenLine(*row, path=tuple(path))


def _grow(tree: MerkleTree, ledger: Ledger) -> None:
    """Append the lines that are not in the tree; all lines, if its last one was replaced."""
    if tree.size:
        last = ledger.row(tree.size)
        if last is None or leaf_of(*last) != tree.leaf(tree.size - 1):
            tree.clear()
    tree.extend(leaf_of(*row) for row in ledger.rows(after=tree.size))
