"""A head with the proof that it continues an earlier one.

In a file it has the form in which a log asks a witness for its signature
(c2sp.org/tlog-witness, add-checkpoint): the old size, the proof, a blank line, the checkpoint.
"""

import re
from dataclasses import field
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import MalformedError
from pqsec_pki.transparency.checkpoint import Checkpoint, TreeHead, decoded_hash, encoded
from pqsec_pki.transparency.tree import verify_consistency

_BEGIN = re.compile(rb"old (0|[1-9][0-9]{0,18})((?:\n[A-Za-z0-9+/]{43}=){0,63})\n\n")


@dataclass(frozen=True, slots=True)
class HeadExtension:
    """A signed head, and the proof that it continues the head of `old` lines."""

    checkpoint: Checkpoint
    old: int
    proof: tuple[bytes, ...] = field(repr=False)

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """The extension in the file `data`; MalformedError if it is not one."""
        found = _BEGIN.match(data)
        if not found:
            raise MalformedError("not a head with its proof, as `pqsec log --anchor` writes it")
        proof = tuple(decoded_hash(each.decode()) for each in found[2].split())
        return cls(Checkpoint.from_bytes(data[found.end() :]), int(found[1]), proof)

    def to_bytes(self) -> bytes:
        """The extension as a file."""
        lines = [f"old {self.old}", *map(encoded, self.proof), "", ""]
        return "\n".join(lines).encode() + self.checkpoint.to_bytes()

    @property
    def head(self) -> TreeHead:
        """The signed head."""
        return self.checkpoint.head

    def verify(self, before: TreeHead) -> None:
        """Return if the head continues `before`; VerificationError if not."""
        old, new = (before.size, before.root), (self.head.size, self.head.root)
        verify_consistency(old, new, self.proof)
