"""Known trees, and a checkpoint and a note of others."""

import base64

import pytest

from pqsec_pki.errors import MalformedError, VerificationError
from pqsec_pki.transparency import (
    EMPTY,
    Checkpoint,
    CompactRange,
    HeadExtension,
    MerkleTree,
    leaf_hash,
    root_by_inclusion,
    verify_consistency,
)

LEAVES = [
    bytes.fromhex(each)
    for each in (
        *("", "00", "10", "2021", "3031", "40414243", "5051525354555657"),
        "606162636465666768696a6b6c6d6e6f",
    )
]
ROOTS = [
    "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855",
    "6e340b9cffb37a989ca544e6bb780a2c78901d3fb33738768511a30617afa01d",
    "fac54203e7cc696cf0dfcb42c92a1d9dbaf70ad9e621f4bd8d98662f00e3c125",
    "aeb6bcfe274b70a14fb067a5e5578264db0fa9b51af5e0ba159158f329e06e77",
    "d37ee418976dd95753c1c73862b9398fa2a2cf9b4ff0fdfe8b30cd95209614b7",
    "4e3bbb1f7b478dcfe71fb631631519a3bca12c9aefca1612bfce4c13a86264d4",
    "76e67dadbcdf1e10e1b74ddc608abd2f98dfb16fbce75277b5232a127f2087ef",
    "ddb89be403809e325750d3d263cd78929c2942b7942a34b77e122c9594a74c8c",
    "5dc9da79a70659a9ad559cb701ded9a2ab9d823aad2f4960cfe370eff4604328",
]
"""Of the first 0 to 8 of them: the tests of Certificate Transparency's own implementations."""
PATHS = {
    (0, 8): (
        "96a296d224f285c67bee93c30f8a309157f0daa35dc5b87e410b78630a09cfc7",
        "5f083f0a1a33ca076a95279832580db3e0ef4584bdff1f54c8a360f50de3031e",
        "6b47aaf29ee3c2af9af889bc1fb9254dabd31177f16232dd6aab035ca39bf6e4",
    ),
    (5, 8): (
        "bc1a0643b12e4d2d7c77918f44e0f4f79a838b6cf9ec5b5c283e1f4d88599e6b",
        "ca854ea128ed050b41b35ffc1b87b8eb2bde461e9e3b5596ece6b9d5975a0ae0",
        "d37ee418976dd95753c1c73862b9398fa2a2cf9b4ff0fdfe8b30cd95209614b7",
    ),
    (2, 3): ("fac54203e7cc696cf0dfcb42c92a1d9dbaf70ad9e621f4bd8d98662f00e3c125",),
}
"""Inclusion proofs from there, by index and size."""
STEPS = {
    (6, 8): (
        "0ebc5d3437fbe2db158b9f126a1d118e308181031d0a949f8dededebc558ef6a",
        "ca854ea128ed050b41b35ffc1b87b8eb2bde461e9e3b5596ece6b9d5975a0ae0",
        "d37ee418976dd95753c1c73862b9398fa2a2cf9b4ff0fdfe8b30cd95209614b7",
    ),
    (2, 5): (
        "5f083f0a1a33ca076a95279832580db3e0ef4584bdff1f54c8a360f50de3031e",
        "bc1a0643b12e4d2d7c77918f44e0f4f79a838b6cf9ec5b5c283e1f4d88599e6b",
    ),
}
"""Consistency proofs from there, by the two sizes."""
CHECKPOINT = (
    "example.com/behind-the-sofa\n20852163\nCsUYapGGPo4dkMgIAUqom/Xajj7h2fB2MPA3j2jxq2I=\n\n"
    "\u2014 example.com/behind-the-sofa"
    " Az3grlgtzPICa5OS8npVmf1Myq/5IZniMp+ZJurmRDeOoRDe4URYN7u5"
    "/Zhcyv2q1gGzGku9nTo+zyWE+xeMcTOAYQ8=\n"
).encode()
"""The example of c2sp.org/tlog-checkpoint."""
REQUEST = (
    b"old 20852014\n"
    b"PlRNCrwHpqhGrupue0L7gxbjbMiKA9temvuZZDDpkaw=\n"
    b"jrJZDmY8Y7SyJE0MWLpLozkIVMSMZcD5kvuKxPC3swk=\n"
    b"5+pKlUdi2LeF/BcMHBn+Ku6yhPGNCswZZD1X/6QgPd8=\n"
    b"/6WVhPs2CwSsb5rYBH5cjHV/wSmA79abXAwhXw3Kj/0=\n\n"
)
"""The example of c2sp.org/tlog-witness, before its checkpoint."""


@pytest.fixture(scope="module")
def tree():
    return MerkleTree(map(leaf_hash, LEAVES))


@pytest.mark.parametrize("size", range(9))
def test_roots(tree, size):
    assert tree.root(size).hex() == ROOTS[size]
    assert CompactRange().extended(map(leaf_hash, LEAVES[:size])).root.hex() == ROOTS[size]


def test_an_empty_tree():
    assert EMPTY.hex() == ROOTS[0]


@pytest.mark.parametrize(("index", "size"), PATHS)
def test_inclusion(tree, index, size):
    path = [bytes.fromhex(each) for each in PATHS[index, size]]
    assert tree.inclusion(index, size) == path
    assert root_by_inclusion(leaf_hash(LEAVES[index]), index, size, path).hex() == ROOTS[size]


@pytest.mark.parametrize(("index", "size"), [*PATHS, (0, 1)])
def test_an_inclusion_proof_with_one_hash_more_is_refused(tree, index, size):
    leaf, path = leaf_hash(LEAVES[index]), tree.inclusion(index, size)
    assert root_by_inclusion(leaf, index, size, path) == tree.root(size)
    with pytest.raises(VerificationError, match="too long"):
        root_by_inclusion(leaf, index, size, [leaf, *path])


@pytest.mark.parametrize(("old", "new"), STEPS)
def test_consistency(tree, old, new):
    steps = [bytes.fromhex(each) for each in STEPS[old, new]]
    assert tree.consistency(old, new) == steps
    verify_consistency((old, tree.root(old)), (new, tree.root(new)), steps)


def test_the_checkpoint_of_the_specification():
    found = Checkpoint.from_bytes(CHECKPOINT)
    assert (found.head.origin, found.head.size) == ("example.com/behind-the-sofa", 20852163)
    assert base64.b64encode(found.head.root) == b"CsUYapGGPo4dkMgIAUqom/Xajj7h2fB2MPA3j2jxq2I="
    assert found.to_bytes() == CHECKPOINT


def test_a_checkpoint_that_nobody_must_have_signed_is_refused():
    with pytest.raises(VerificationError, match="no key to verify"):
        Checkpoint.from_bytes(CHECKPOINT).verify([])


def test_the_request_of_the_specification():
    found = HeadExtension.from_bytes(REQUEST + CHECKPOINT)
    assert (found.old, len(found.proof)) == (20852014, 4)
    assert found.to_bytes() == REQUEST + CHECKPOINT


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"20852163\n", b"020852163\n"),
        (b"20852163\n", b"-1\n"),
        (b"20852163\n", b"9999999999999999999\n"),
        (b"2I=\n\n", b"2J=\n\n"),  # another spelling of the same bytes
        (b"2I=\n\n", b"\n\n"),
        (b"2I=\n\n", b"2I=\n\nx\n"),
        (b"sofa\n", b"so fa\n"),
        (b"sofa\n", b"so+fa\n"),
        (b"sofa\n", b"so\rfa\n"),
        (b"\n\n", b"\n"),
        (b"\n\n", b"\n\n\n"),
        (b"YQ8=\n", b"YQ8="),
        (b"YQ8=\n", b"YQ8=\nmore\n"),
        ("\u2014".encode(), b"-"),
        (b"Az3g", b"Az3\xff"),
    ],
)
def test_a_checkpoint_with_one_thing_wrong_is_refused(old, new):
    assert old in CHECKPOINT
    with pytest.raises(MalformedError):
        Checkpoint.from_bytes(CHECKPOINT.replace(old, new, 1))
