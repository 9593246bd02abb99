"""Trees of any size: each proof is accepted for what it proves, and for nothing else."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pqsec_pki.errors import PqsecError, VerificationError
from pqsec_pki.transparency import (
    CompactRange,
    HeadExtension,
    LedgerProof,
    MerkleTree,
    leaf_hash,
    root_by_inclusion,
    verify_consistency,
)
from pqsec_pki.transparency.tree import node_hash

MOST = 300
LEAVES = [leaf_hash(b"%d" % each) for each in range(MOST)]
TREE = MerkleTree(LEAVES)
SIZES = st.integers(1, MOST)


def root(hashes):
    """The root by the definition of RFC 9162 2.1.1."""
    if len(hashes) == 1:
        return hashes[0]
    k = 1
    while k * 2 < len(hashes):
        k *= 2
    return node_hash(root(hashes[:k]), root(hashes[k:]))


@given(SIZES)
def test_the_root_is_as_defined(size):
    assert TREE.root(size) == root(LEAVES[:size])
    assert MerkleTree(LEAVES[:size]).root(size) == TREE.root(size)


@given(SIZES, SIZES)
def test_a_tree_that_grows_has_the_same_root(size, cut):
    cut = min(cut, size)
    grown = CompactRange().extended(LEAVES[:cut]).extended(LEAVES[cut:size])
    assert (grown.size, grown.root) == (size, TREE.root(size))
    assert grown.is_sound
    assert not CompactRange(grown.size, grown.subtrees * 2).is_sound
    tree = MerkleTree(LEAVES[:cut])
    tree.extend(LEAVES[cut:size])
    assert all(tree.root(each) == TREE.root(each) for each in (cut, size))
    assert tree.inclusion(cut - 1, size) == TREE.inclusion(cut - 1, size)


@given(SIZES, SIZES, st.data())
def test_an_inclusion_proof_is_for_its_leaf_and_place_only(index, size, data):
    index = (index - 1) % size
    path = TREE.inclusion(index, size)
    assert root_by_inclusion(LEAVES[index], index, size, path) == TREE.root(size)
    changed = data.draw(
        st.sampled_from(["leaf", "place", "shorter", "longer", "altered", "swapped"])
    )
    leaf, place = LEAVES[index], index
    if changed == "leaf":
        leaf = leaf_hash(b"another")
    elif changed == "place":
        place = data.draw(st.integers(-1, size + 1).filter(lambda each: each != index))
    elif changed == "shorter" and path:
        path = path[:-1]
    elif changed == "altered" and path:
        at = data.draw(st.integers(0, len(path) - 1))
        path = [*path[:at], leaf_hash(b"another"), *path[at + 1 :]]
    elif changed == "swapped" and len(path) > 1:
        path = path[::-1]
    else:
        path = [*path, leaf]
    try:
        found = root_by_inclusion(leaf, place, size, path)
    except VerificationError:
        return
    assert found != TREE.root(size)


@given(SIZES, SIZES, st.data())
def test_a_consistency_proof_is_for_its_two_trees_only(one, other, data):
    old, new = sorted((one, other))
    steps = TREE.consistency(old, new)
    before, after = (old, TREE.root(old)), (new, TREE.root(new))
    verify_consistency(before, after, steps)
    verify_consistency((0, TREE.root(0)), after, [])
    another = leaf_hash(b"another")
    kind = data.draw(st.sampled_from(["before", "after", "longer", "shorter", "sizes", "altered"]))
    if kind == "before":
        before = (old, another)
    elif kind == "after":
        after = (new, another)
    elif kind == "sizes":
        before = (new + 1, before[1])
    elif kind == "shorter" and steps:
        steps = steps[1:]
    elif kind == "altered" and steps:
        at = data.draw(st.integers(0, len(steps) - 1))
        steps = [*steps[:at], another, *steps[at + 1 :]]
    else:
        steps = [another, *steps]
    with pytest.raises(VerificationError):
        verify_consistency(before, after, steps)


@given(st.one_of(st.binary(max_size=300), st.text(max_size=300).map(str.encode)))
def test_other_bytes_are_refused(data):
    for reader in (HeadExtension.from_bytes, LedgerProof.from_bytes):
        with pytest.raises(PqsecError):
            reader(data)
        with pytest.raises(PqsecError):
            reader(b"old 0\n\n" + data)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=9),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["format", "checkpoint", "lines", "number", "kind", "path"]), inner
        )
    ),
)


@given(JSON)
def test_other_values_are_no_proof(value):
    with pytest.raises(PqsecError):
        LedgerProof.of(value)
    with pytest.raises(PqsecError):
        LedgerProof.of({"format": 1, "checkpoint": value, "lines": value})
