"""Go's implementation of logs and signed notes checks our heads and proofs, and we check its.

It is that of Go's checksum database, golang.org/x/mod/sumdb, from which C2SP's note comes. OpenSSL
checks the signatures that Go has no algorithm for.
"""

import base64
import json
import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from pqsec_pki.algorithms import pem
from pqsec_pki.enrolment import Bundle
from pqsec_pki.errors import VerificationError
from pqsec_pki.keystore import write_anchor
from pqsec_pki.keystore.heads import read_head
from pqsec_pki.transparency import (
    HeadExtension,
    MerkleTree,
    leaf_hash,
    root_by_inclusion,
    verify_consistency,
)
from tests.interop.kept import contents, kept
from tests.unit.keystores import NOW, add, made

SOURCES = Path("/usr/share/gocode")
"""Where Debian has the sources of Go's libraries."""
SIZE = 40


@pytest.fixture(scope="module")
def go(requires):
    """Ask Go's implementation."""
    there = shutil.which("go") and (SOURCES / "src/golang.org/x/mod/sumdb/tlog").is_dir()
    remedy = "apt-get install --no-install-recommends golang-go golang-golang-x-mod-dev"
    requires(there or None, "Go with its library for logs", remedy)
    environment = os.environ | {
        "GO111MODULE": "off",
        "GOPATH": str(SOURCES),
        "GOFLAGS": "-p=1",
        "CGO_ENABLED": "0",
    }
    source = Path(__file__).with_name("transparency.go")

    def run(*words, **more):
        done = subprocess.run(words, capture_output=True, text=True, check=False, **more)
        assert done.returncode == 0, done.stderr
        return done.stdout

    def make(folder):
        with TemporaryDirectory() as cache:
            there = folder / "transparency"
            run("go", "build", "-o", there, source, env=environment | {"GOCACHE": cache})

    libraries = (SOURCES / "src/golang.org/x/mod/sumdb").rglob("*.go")
    inputs = run("go", "version"), contents(source, *libraries)
    program = kept("go", inputs, make) / "transparency"

    def ask(**question):
        text = json.dumps(question, default=lambda data: base64.b64encode(data).decode())
        return json.loads(run(program, input=text, timeout=60))

    return ask


@pytest.fixture(scope="module")
def leaves():
    return [b"leaf %d" % each for each in range(SIZE)]


@pytest.fixture(scope="module")
def tree(leaves):
    return MerkleTree(map(leaf_hash, leaves))


def plain(values):
    return [base64.b64decode(each) for each in values or ()]


def places():
    """Each leaf in each tree, and each pair of trees."""
    for new in range(1, SIZE + 1):
        yield from ((True, old, new) for old in range(new))
        yield from ((False, old, new) for old in range(1, new + 1))


def test_we_compute_and_accept_what_go_computes(go, leaves, tree):
    asked = [{"Record": record, "Old": old, "New": new} for record, old, new in places()]
    answer = go(Leaves=leaves, Prove=asked)
    roots = plain(answer["Roots"])
    assert roots[1:] == [tree.root(size) for size in range(1, SIZE + 1)]
    for (record, old, new), proof in zip(places(), answer["Proofs"], strict=True):
        hashes = plain(proof["Hashes"])
        if record:
            assert hashes == tree.inclusion(old, new)
            assert root_by_inclusion(leaf_hash(leaves[old]), old, new, hashes) == roots[new]
        else:
            assert hashes == tree.consistency(old, new)
            verify_consistency((old, roots[old]), (new, roots[new]), hashes)


def test_go_accepts_what_we_compute_and_nothing_else(go, leaves, tree):
    good = []
    for record, old, new in places():
        hashes = tree.inclusion(old, new) if record else tree.consistency(old, new)
        good.append({"Record": record, "Old": old, "New": new, "Hashes": hashes})
    bad = [
        {**each, "Hashes": [leaf_hash(b"another"), *each["Hashes"][1:]]}
        for each in good
        if each["Hashes"]
    ]
    roots = [tree.root(size) for size in range(SIZE + 1)]
    answer = go(Leaves=leaves, Roots=roots, Check=[*good, *bad])
    assert answer["Holds"] == [True] * len(good) + [False] * len(bad)
    for each in bad:  # and we agree
        record, old, new, hashes = each.values()
        if record:
            leaf = leaf_hash(leaves[old])
            assert root_by_inclusion(leaf, old, new, hashes) != roots[new]
        else:
            with pytest.raises(VerificationError):
                verify_consistency((old, roots[old]), (new, roots[new]), hashes)


@pytest.mark.parametrize("profile", ["classical", "transition"])
def test_go_opens_our_heads_and_finds_our_lines_below_them(go, tmp_path, profile):
    keystore = made(tmp_path / "k", profile)
    first = write_anchor(keystore, tmp_path / "anchors").head
    add(keystore, more="0", fourth="0")
    head = read_head(keystore.root)
    key = keystore.permissions_ca.public_key
    asked = {"Name": head.head.origin, "Spki": key.spki}
    answer = go(Note=head.to_bytes(), **asked)
    assert answer["Text"].encode() == head.head.text
    altered = head.to_bytes().replace(b"\n%d\n" % head.head.size, b"\n9999\n", 1)
    assert go(Note=altered, **asked)["Error"]

    with keystore.open_ledger() as ledger:
        lines = [
            f"{n}\n{kind}\n{sha}\n{chain}\n{name}" for n, kind, name, sha, chain in ledger.rows()
        ]
    leaves = [each.encode() for each in lines]
    answer = go(Leaves=leaves)
    roots = plain(answer["Roots"])
    assert roots[head.head.size] == head.head.root
    proof = Bundle.of(keystore, ["/more", "/talker"], now=NOW).proof
    extension = HeadExtension.from_bytes(
        write_anchor(keystore, tmp_path / "anchors").path.read_bytes()
    )
    checks = [
        {"Record": True, "Old": each.number - 1, "New": head.head.size, "Hashes": each.path}
        for each in proof.lines
    ]
    checks.append(
        {"Record": False, "Old": first.size, "New": head.head.size, "Hashes": extension.proof}
    )
    assert len(checks) == 6
    assert go(Leaves=leaves, Roots=roots, Check=checks)["Holds"] == [True] * 6


@pytest.mark.parametrize("profile", ["pq", "transition"])
def test_openssl_verifies_the_post_quantum_signature_of_a_head(openssl35, tmp_path, profile):
    keystore = made(tmp_path / "k", profile)
    head = read_head(keystore.root)
    signer = keystore.countersigner or keystore.permissions_ca
    *_, (_, signature) = head.signatures
    (tmp_path / "key").write_bytes(pem("PUBLIC KEY", signer.public_key.spki))
    (tmp_path / "signature").write_bytes(signature[4:])
    (tmp_path / "text").write_bytes(head.head.text)
    (tmp_path / "altered").write_bytes(replace(head.head, size=1).text)
    check = ("pkeyutl", "-verify", "-rawin", "-pubin", "-inkey", tmp_path / "key")
    check += ("-sigfile", tmp_path / "signature", "-in")
    openssl35(*check, tmp_path / "text")
    openssl35.refuses(*check, tmp_path / "altered")
