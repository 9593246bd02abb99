"""A proof that lines are in the ledger of which a head was signed: the file ledger.proof.

It has the number, kind, name and SHA-256 of a line, and the chain value, which commits to the rest.
The operator and the time stay in the ledger.
"""

import json
from collections.abc import Collection, Iterator, Mapping
from dataclasses import field
from typing import Any, Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import PublicKey
from pqsec_pki.errors import MalformedError, VerificationError
from pqsec_pki.transparency.checkpoint import Checkpoint, TreeHead, decoded_hash, encoded
from pqsec_pki.transparency.tree import leaf_hash, root_by_inclusion

FORMAT = 1
_NOT_JSON = (ValueError, KeyError, TypeError, AttributeError, RecursionError)


def leaf_of(number: int, kind: str, name: str, sha256: str, chain: str) -> bytes:
    """The hash of a ledger line as a leaf: of these values, one in a line, the name last."""
    return leaf_hash(f"{number}\n{kind}\n{sha256}\n{chain}\n{name}".encode())


@dataclass(frozen=True, slots=True)
class ProvenLine:
    """A ledger line, and its inclusion proof."""

    number: int
    """The line number, from 1; the line is leaf `number - 1`."""
    kind: str
    name: str
    sha256: str
    chain: str
    path: tuple[bytes, ...] = field(repr=False)

    @property
    def leaf(self) -> bytes:
        """Its hash in the tree."""
        return leaf_of(self.number, self.kind, self.name, self.sha256, self.chain)

    def to_json(self) -> dict[str, object]:
        """The line in a proof."""
        return {
            "number": self.number,
            "kind": self.kind,
            "name": self.name,
            "sha256": self.sha256,
            "chain": self.chain,
            "path": [encoded(each) for each in self.path],
        }

    @classmethod
    def of(cls, value: Mapping[str, Any]) -> Self:
        """The inverse of `to_json`; one of _NOT_JSON, or MalformedError."""
        number, kind, name = value["number"], value["kind"], value["name"]
        sha256, chain, path = value["sha256"], value["chain"], value["path"]
        texts = (kind, name, sha256, chain)
        if type(number) is not int or not all(isinstance(each, str) for each in texts):
            raise TypeError("not a number and four texts")
        "".join(texts).encode()  # JSON can have texts that UTF-8 cannot
        return cls(number, kind, name, sha256, chain, tuple(map(decoded_hash, path)))


@dataclass(frozen=True, slots=True)
class LedgerProof:
    """A signed head of a ledger, and lines of it with their inclusion proofs."""

    checkpoint: Checkpoint
    lines: tuple[ProvenLine, ...]

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """The proof in the file `data`; MalformedError if it is not one."""
        try:
            return cls.of(json.loads(data))
        except (ValueError, RecursionError):
            raise MalformedError("not a proof of a ledger") from None

    @classmethod
    def of(cls, value: Any) -> Self:
        """The inverse of `to_json`; MalformedError for anything else."""
        try:
            if value["format"] != FORMAT:
                raise MalformedError("the proof was made by another version of pqsec")
            lines = tuple(map(ProvenLine.of, value["lines"]))
            return cls(Checkpoint.from_bytes(value["checkpoint"].encode()), lines)
        except _NOT_JSON:
            raise MalformedError("not a proof of a ledger") from None

    def to_json(self) -> dict[str, object]:
        """The proof in a manifest."""
        return {
            "format": FORMAT,
            "checkpoint": self.checkpoint.to_bytes().decode(),
            "lines": [each.to_json() for each in self.lines],
        }

    def to_bytes(self) -> bytes:
        """The proof as a file."""
        return json.dumps(self.to_json(), indent=1, ensure_ascii=False).encode() + b"\n"

    def about(self, wanted: Collection[tuple[str, str]]) -> Self:
        """This proof with only the lines of these kinds and SHA-256."""
        lines = (each for each in self.lines if (each.kind, each.sha256) in wanted)
        return type(self)(self.checkpoint, tuple(lines))

    def verify(self, keys: Collection[PublicKey], wanted: Collection[tuple[str, str]]) -> TreeHead:
        """The head, if all `keys` signed it and all `wanted`, kinds and SHA-256, are lines of it.

        VerificationError lists everything that is wrong.
        """
        head = self.checkpoint.verify(keys)
        problems = [*self._problems(head)]
        proven = {(each.kind, each.sha256) for each in self.lines}
        problems += [
            f"no proof for the {kind} {sha256[:16]}"
            for kind, sha256 in wanted
            if (kind, sha256) not in proven
        ]
        if problems:
            raise VerificationError(*problems)
        return head

    def _problems(self, head: TreeHead) -> Iterator[str]:
        for each in self.lines:
            try:
                root = root_by_inclusion(each.leaf, each.number - 1, head.size, each.path)
            except VerificationError as error:
                yield f"line {each.number}: {error}"
                continue
            if root != head.root:
                yield f"line {each.number} is not in the tree of {head.size} lines"
