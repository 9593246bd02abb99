"""The hash tree of RFC 9162 2.1, the same as in RFC 6962, with SHA-256; functions over hashes."""

import hashlib
from collections.abc import Iterable, Sequence
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import VerificationError

EMPTY = hashlib.sha256().digest()
"""The root of the tree without leaves."""
MAX_SIZE = (1 << 63) - 1
"""Leaves. It bounds the depth of recursion."""


def leaf_hash(data: bytes) -> bytes:
    """The hash of a leaf (RFC 9162 2.1.1)."""
    return hashlib.sha256(b"\0" + data).digest()


def node_hash(left: bytes, right: bytes) -> bytes:
    """The hash of a node with these two children."""
    return hashlib.sha256(b"\1" + left + right).digest()


@dataclass(frozen=True, slots=True)
class CompactRange:
    """A tree of which only as much is kept as is needed to append leaves."""

    size: int = 0
    """Leaves."""
    subtrees: tuple[bytes, ...] = ()
    """The roots of the complete subtrees, of 2^k leaves each, the largest first."""

    @property
    def is_sound(self) -> bool:
        """Whether there are as many subtrees as a tree of this size has, each a hash."""
        hashes = all(len(each) == len(EMPTY) for each in self.subtrees)
        return hashes and 0 <= self.size <= MAX_SIZE and len(self.subtrees) == self.size.bit_count()

    def extended(self, leaves: Iterable[bytes]) -> Self:
        """The tree with these hashes of leaves appended."""
        size, subtrees = self.size, list(self.subtrees)
        for leaf in leaves:
            size += 1
            subtrees.append(leaf)
            for _ in range((size & -size).bit_length() - 1):  # each that is now complete
                right = subtrees.pop()
                subtrees[-1] = node_hash(subtrees[-1], right)
        return type(self)(size, tuple(subtrees))

    @property
    def root(self) -> bytes:
        """The hash of the whole tree."""
        if not self.subtrees:
            return EMPTY
        *others, root = self.subtrees
        for left in reversed(others):
            root = node_hash(left, root)
        return root


class MerkleTree:
    """A tree with all its nodes, for proofs in it and in each of its earlier states."""

    def __init__(self, leaves: Iterable[bytes] = ()) -> None:
        """The tree over these hashes of leaves; about 64 bytes for each."""
        self._levels: list[list[bytes]] = [[]]
        self.extend(leaves)

    def extend(self, leaves: Iterable[bytes]) -> None:
        """Append these hashes of leaves."""
        self._levels[0] += leaves
        height = 0
        while len(below := self._levels[height]) > 1:
            height += 1
            if height == len(self._levels):
                self._levels.append([])
            above = self._levels[height]
            lefts = range(2 * len(above), len(below) - 1, 2)
            above += [node_hash(below[each], below[each + 1]) for each in lefts]

    def clear(self) -> None:
        """Remove all leaves."""
        self._levels = [[]]

    def leaf(self, index: int) -> bytes:
        """The hash of leaf number `index`, from 0."""
        return self._levels[0][index]

    @property
    def size(self) -> int:
        """Its number of leaves."""
        return len(self._levels[0])

    def root(self, size: int) -> bytes:
        """The root of its first `size` leaves."""
        return self._root(0, size) if size else EMPTY

    def inclusion(self, index: int, size: int) -> list[bytes]:
        """The proof that leaf `index` is in the tree of the first `size` leaves (2.1.3.1)."""
        return self._path(index, 0, size)

    def consistency(self, old: int, new: int) -> list[bytes]:
        """The proof that the first `new` leaves begin with the first `old` ones (2.1.4.1)."""
        return self._steps(old, 0, new, known=True) if old else []

    def _root(self, begin: int, end: int) -> bytes:
        count = end - begin
        if count.bit_count() == 1:
            level = count.bit_length() - 1
            return self._levels[level][begin >> level]
        middle = begin + _split(count)
        return node_hash(self._root(begin, middle), self._root(middle, end))

    def _path(self, index: int, begin: int, end: int) -> list[bytes]:
        if end - begin == 1:
            return []
        middle = begin + _split(end - begin)
        if index < middle:
            return [*self._path(index, begin, middle), self._root(middle, end)]
        return [*self._path(index, middle, end), self._root(begin, middle)]

    def _steps(self, old: int, begin: int, end: int, *, known: bool) -> list[bytes]:
        """SUBPROOF of 2.1.4.1; `known` if the verifier has the root of this part."""
        if old == end:
            return [] if known else [self._root(begin, end)]
        middle = begin + _split(end - begin)
        if old <= middle:
            return [*self._steps(old, begin, middle, known=known), self._root(middle, end)]
        return [*self._steps(old, middle, end, known=False), self._root(begin, middle)]


def root_by_inclusion(leaf: bytes, index: int, size: int, path: Sequence[bytes]) -> bytes:
    """The root of the tree with `size` leaves in which `leaf`, a hash, is number `index`, from 0.

    VerificationError if `path` is not a path of such a tree.
    """
    if not 0 <= index < size <= MAX_SIZE:
        raise VerificationError(f"the tree has no leaf {index}: its size is {size}")
    if size == 1:
        if path:
            raise VerificationError("the inclusion proof is too long")
        return leaf
    if not path:
        raise VerificationError("the inclusion proof is too short")
    middle, (*below, sibling) = _split(size), path
    if index < middle:
        return node_hash(root_by_inclusion(leaf, index, middle, below), sibling)
    return node_hash(sibling, root_by_inclusion(leaf, index - middle, size - middle, below))


def verify_consistency(
    old: tuple[int, bytes], new: tuple[int, bytes], proof: Sequence[bytes]
) -> None:
    """Return if the tree `new`, a size and a root, begins with all leaves of the tree `old`.

    VerificationError if `proof` does not show it.
    """
    (old_size, old_root), (new_size, new_root) = old, new
    if not 0 <= old_size <= new_size <= MAX_SIZE:
        raise VerificationError(f"a tree of {new_size} leaves cannot extend one of {old_size}")
    steps = list(proof)
    known = (EMPTY, new_root)
    found = _both_roots(old_size, new_size, steps, old_root) if old_size else known
    if steps or found != (old_root, new_root):
        raise VerificationError(f"the tree of {new_size} leaves does not extend that of {old_size}")


def _both_roots(old: int, new: int, steps: list[bytes], known: bytes | None) -> tuple[bytes, bytes]:
    """The roots of a part before and after; `known` is the one before, if the verifier has it."""
    if old == new:
        root = known if known is not None else _next(steps)
        return root, root
    middle, sibling = _split(new), _next(steps)
    if old <= middle:
        before, after = _both_roots(old, middle, steps, known)
        return before, node_hash(after, sibling)
    before, after = _both_roots(old - middle, new - middle, steps, None)
    return node_hash(sibling, before), node_hash(sibling, after)


def _next(steps: list[bytes]) -> bytes:
    if not steps:
        raise VerificationError("the consistency proof is too short")
    return steps.pop()


def _split(size: int) -> int:
    """The largest power of two below `size`, which is at least 2."""
    return 1 << (size - 1).bit_length() - 1
