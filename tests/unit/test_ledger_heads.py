"""Signed heads of the ledger: when they are made, and what they show."""

import json
import shutil
from dataclasses import replace

import pytest

from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import FileError, KeystoreError, MalformedError, VerificationError
from pqsec_pki.keystore import Keystore, Ledger, SigningCa, audit, checked_head, write_anchor
from pqsec_pki.keystore._chain import START, link
from pqsec_pki.keystore.heads import read_head
from pqsec_pki.lifecycle import (
    Rollover,
    Scope,
    change_passphrase,
    renew,
    revocable,
    revoke,
    sign_head,
)
from pqsec_pki.transparency import Checkpoint, HeadExtension, MerkleTree, leaf_of
from tests.unit.keystores import DAY, NOW, add, enter, made, rotate
from tests.unit.test_ledger import alter, database, entry


@pytest.fixture
def keystore(tmp_path):
    return made(tmp_path / "k", "classical")


@pytest.fixture
def anchors(tmp_path):
    return tmp_path / "anchors"


def size(keystore):
    return read_head(keystore.root).head.size


def problems(keystore, anchors=None):
    with pytest.raises(VerificationError) as caught:
        audit(keystore, anchors=anchors)
    return "\n".join(caught.value.lines)


def rewrite(keystore, first, **changes):
    """What somebody does who can write the ledger, and makes its chain whole again."""
    lines = keystore.lines()
    before = lines[first - 2].chain if first > 1 else START
    with database(keystore) as opened:
        opened.execute("DROP TRIGGER ledger_stays")
        for line in lines[first - 1 :]:
            new = replace(line.entry, **changes) if line.number == first else line.entry
            before = link(before, line.number, new)
            opened.execute(
                "UPDATE ledger SET name = ?, operator = ?, chain = ? WHERE number = ?",
                (new.name, new.operator, before, line.number),
            )


def cut(keystore, last):
    alter(keystore, f"DELETE FROM ledger WHERE number > {last}")  # noqa: S608 -- a number


def forget_heads(keystore):
    for name in ("ledger.checkpoint", "ledger.tree"):
        (keystore.root / "public" / name).unlink()


# When they are made


@pytest.mark.parametrize(
    ("profile", "signatures"), [("classical", 1), ("pq", 1), ("transition", 2)]
)
def test_each_change_with_the_ca_keys_signs_a_head_over_all_lines(tmp_path, profile, signatures):
    keystore = made(tmp_path / "k", profile)
    authorities = keystore.unlock(None)
    steps = [
        lambda: add(keystore, more="0"),
        lambda: renew(keystore, authorities, ["/talker"], now=NOW + DAY),
        lambda: revoke(keystore, authorities, ["/listener"], now=NOW + DAY),
    ]
    for step in (lambda: None, *steps):
        step()
        found = read_head(keystore.root)
        with keystore.open_ledger() as ledger:
            tree = MerkleTree(leaf_of(*row) for row in ledger.rows())
            assert (found.head.size, found.head.root) == (ledger.size, tree.root(tree.size))
            assert found.head.origin == ledger.origin
        assert len(found.signatures) == signatures
        audit(keystore)


def test_a_folder_without_heads_proves_nothing(keystore, anchors):
    anchors.mkdir()
    with pytest.raises(FileError, match="no heads to compare with"):
        audit(keystore, anchors=anchors)
    write_anchor(keystore, anchors)
    audit(keystore, anchors=anchors)


def test_lines_that_are_added_without_the_keys_are_in_the_next_head(keystore):
    before = size(keystore)
    enter(keystore, [entry(1), entry(2)])
    assert size(keystore) == before
    audit(keystore)
    assert sign_head(keystore, keystore.unlock(None)).size == before + 2
    enter(keystore, [entry(3)])
    change_passphrase(keystore, keystore.unlock(None), b"a new passphrase")
    assert size(keystore) == before + 3


def test_lines_of_the_identity_ca_alone_are_in_the_next_head(keystore):
    """With each CA on a machine of its own, revoking opens no key that signs heads."""
    before = read_head(keystore.root)
    identity = keystore.unlock(None, cas=(SigningCa.IDENTITY,))
    revoke(keystore, identity, ["/listener"], now=NOW + DAY)
    assert read_head(keystore.root) == before
    audit(keystore)
    permissions = keystore.unlock(None, cas=(SigningCa.PERMISSIONS,))
    assert sign_head(keystore, permissions).size == len(keystore.lines())


def test_a_keystore_without_heads_gets_one_at_the_next_change(keystore):
    forget_heads(keystore)
    audit(keystore)
    with pytest.raises(VerificationError, match="have not signed a head"):
        checked_head(keystore)
    add(keystore, more="0")
    assert checked_head(keystore).head.size == len(keystore.lines())


def test_older_lines_are_not_read_again(keystore, monkeypatch):
    asked = []
    rows = Ledger.rows

    def watched(self, *, after=0):
        asked.append(after)
        return rows(self, after=after)

    monkeypatch.setattr(Ledger, "rows", watched)
    before = size(keystore)
    add(keystore, more="0")
    complete = before & -before  # the last subtree of the head is compared
    assert asked == [before - complete, before]


@pytest.mark.parametrize("text", [None, "", "{}", "[]", '{"size": 9, "subtrees": ["00", "11"]}'])
def test_a_lost_or_damaged_tree_is_computed_again(keystore, text):
    tree = keystore.root / "public/ledger.tree"
    tree.unlink() if text is None else tree.write_text(text)
    add(keystore, more="0")
    assert checked_head(keystore).head.size == len(keystore.lines())
    assert json.loads(tree.read_text())["size"] == len(keystore.lines())


def test_a_tree_that_does_not_fit_the_head_is_not_extended(keystore):
    tree = keystore.root / "public/ledger.tree"
    value = json.loads(tree.read_text())
    value["subtrees"][0] = "00" * 32
    tree.write_text(json.dumps(value))
    add(keystore, more="0")
    assert checked_head(keystore).head.size == len(keystore.lines())


# What they show


def test_subtrees_of_other_lengths_with_the_same_root_are_not_extended(keystore):
    """Their bytes together are the same, and so is the root: the next head would be of no lines."""
    path = keystore.root / "public/ledger.tree"
    value = json.loads(path.read_text())
    assert len(value["subtrees"]) > 1
    *others, left, right = value["subtrees"]
    path.write_text(json.dumps(value | {"subtrees": [*others, left[:-2], left[-2:] + right]}))
    add(keystore, more="0")
    assert size(keystore) == len(keystore.lines())
    audit(keystore)


def test_a_rewritten_line_with_a_whole_chain_is_found(keystore):
    rewrite(keystore, 5, name="/evil")
    assert f"lines 1 to {size(keystore)} are not those of which" in problems(keystore)


def test_a_ledger_that_begins_with_another_line_is_another_one(keystore):
    before = read_head(keystore.root)
    rewrite(keystore, 1, operator="somebody else")
    assert "the head of another ledger: pqsec-ledger/" in problems(keystore)
    with pytest.raises(KeystoreError, match="the CAs signed the head of another ledger"):
        add(keystore, more="0")  # with the subtrees as they are, no older line is read
    assert read_head(keystore.root) == before


def test_another_operator_in_a_line_is_found(keystore):
    rewrite(keystore, 5, operator="somebody else")
    assert "are not those of which this head was signed" in problems(keystore)


def test_a_cut_end_is_found(keystore):
    last = size(keystore)
    add(keystore, more="0")
    shutil.rmtree(keystore.root / "enclaves/more")
    cut(keystore, last)
    assert f"this head is over {last + 2} lines, the ledger has {last}" in problems(keystore)


def test_no_other_history_is_signed(keystore):
    rewrite(keystore, 5, name="/evil")
    (keystore.root / "public/ledger.tree").unlink()  # so that the lines are read
    before = read_head(keystore.root)
    with pytest.raises(KeystoreError, match="the ledger lacks one of the"):
        add(keystore, more="0")
    assert read_head(keystore.root) == before
    with pytest.raises(VerificationError, match="are not those of which"):
        sign_head(keystore, keystore.unlock(None))


def test_lines_that_were_rewritten_are_not_in_the_next_head_either(keystore):
    rewrite(keystore, 5, name="/evil")
    with pytest.raises(KeystoreError, match="the ledger lacks one of the"):
        add(keystore, more="0")
    assert "are not those of which" in problems(keystore)


def test_a_history_that_is_cut_and_grows_again_is_not_signed(keystore):
    last = size(keystore)
    add(keystore, more="0")
    cut(keystore, last)
    shutil.rmtree(keystore.root / "enclaves/more")
    before = read_head(keystore.root)
    with pytest.raises(KeystoreError, match="the ledger lacks lines"):
        add(keystore, other="0", third="0")
    assert read_head(keystore.root) == before
    with pytest.raises(VerificationError, match="the end was cut off"):
        sign_head(keystore, keystore.unlock(None))


@pytest.mark.parametrize("kind", ["other CA", "altered", "nonsense"])
def test_a_planted_head_is_found_and_not_continued(keystore, tmp_path, kind):
    path = keystore.root / "public/ledger.checkpoint"
    other = made(tmp_path / "other", "classical").root / "public/ledger.checkpoint"
    altered = path.read_bytes().replace(b"\n7\n", b"\n6\n", 1)
    planted = {"other CA": other.read_bytes(), "altered": altered, "nonsense": b"x"}[kind]
    assert planted != path.read_bytes()
    path.write_bytes(planted)
    assert "ledger.checkpoint" in problems(keystore)
    with pytest.raises(KeystoreError, match="the ledger cannot be compared with its signed head"):
        add(keystore, more="0")
    assert path.read_bytes() == planted
    with pytest.raises(VerificationError):
        sign_head(keystore, keystore.unlock(None))


def test_a_head_that_was_verified_is_verified_again_for_other_cas(keystore, tmp_path):
    assert read_head(keystore.root)
    other = made(tmp_path / "other", "classical")
    shutil.copy(other.permissions_ca_path, keystore.permissions_ca_path)
    with pytest.raises(VerificationError, match="no signature by"):
        read_head(keystore.root)


def test_a_head_with_one_of_two_signatures_is_refused(tmp_path):
    keystore = made(tmp_path / "k", "transition")
    path = keystore.root / "public/ledger.checkpoint"
    good = Checkpoint.from_bytes(path.read_bytes())
    for kept in good.signatures:
        path.write_bytes(replace(good, signatures=(kept,)).to_bytes())
        with pytest.raises(VerificationError, match="no signature by the"):
            read_head(keystore.root)


# In another place


def test_heads_are_kept_once_each_with_a_proof_for_the_one_before(keystore, anchors):
    first = write_anchor(keystore, anchors)
    assert (first.already, first.unsigned) == (False, 0)
    assert write_anchor(keystore, anchors).already
    add(keystore, more="0")
    enter(keystore, [entry(1)])
    second = write_anchor(keystore, anchors)
    assert (second.already, second.unsigned, second.head.size) == (False, 1, first.head.size + 2)
    found = HeadExtension.from_bytes(second.path.read_bytes())
    assert found.old == first.head.size
    found.verify(first.head)
    audit(keystore, anchors=anchors)


def test_a_ledger_without_a_head_gives_no_anchor(keystore, anchors):
    forget_heads(keystore)
    with pytest.raises(VerificationError, match="have not signed a head"):
        write_anchor(keystore, anchors)
    assert not anchors.exists()


def test_anchors_tell_from_which_line_on_the_ledger_was_rewritten(keystore, anchors):
    whole = write_anchor(keystore, anchors).head.size
    for name in ("a", "b"):
        add(keystore, **{name: "0"})
        write_anchor(keystore, anchors)
    rewrite(keystore, whole + 1, name="/evil")
    forget_heads(keystore)
    told = problems(keystore, anchors)
    assert f"lines {whole + 1} to {whole + 2} are not those of which this head was signed" in told
    assert "fork" not in told
    with pytest.raises(VerificationError, match="are not those of which"):
        write_anchor(keystore, anchors)


def test_anchors_tell_that_the_end_was_cut_off(keystore, anchors):
    whole = write_anchor(keystore, anchors).head.size
    add(keystore, more="0")
    write_anchor(keystore, anchors)
    cut(keystore, whole)
    forget_heads(keystore)
    told = problems(keystore, anchors)
    assert (
        f"the end was cut off: this head is over {whole + 2} lines, the ledger has {whole}, and"
        f" those up to {whole} are as signed"
    ) in told


def test_anchors_tell_of_a_fork(keystore, anchors, tmp_path):
    whole = write_anchor(keystore, anchors).head.size
    copy = tmp_path / "copy"
    shutil.copytree(keystore.root, copy, symlinks=True)
    add(keystore, a="0")
    write_anchor(keystore, anchors)
    other = Keystore.open(copy, to_change=True)
    add(other, b="0")
    audit(other)
    told = problems(other, anchors)
    assert f"fork: the CAs signed this head, and later one over other lines {whole + 1} to" in told
    with pytest.raises(VerificationError, match="fork"):
        write_anchor(other, anchors)


def test_the_head_of_another_ledger_of_the_same_cas_is_found(keystore, anchors):
    anchor = write_anchor(keystore, anchors)
    keys = [each.key for each in keystore.unlock(None).signers]
    other = Checkpoint.signed(replace(anchor.head, origin="pqsec-ledger/other"), keys)
    anchor.path.write_bytes(HeadExtension(other, 0, ()).to_bytes())
    assert "the head of another ledger: pqsec-ledger/other instead of" in problems(
        keystore, anchors
    )


def test_a_missing_or_planted_anchor_is_found(keystore, anchors, tmp_path):
    paths = [write_anchor(keystore, anchors).path]
    for name in ("a", "b"):
        add(keystore, **{name: "0"})
        paths.append(write_anchor(keystore, anchors).path)
    data = paths[1].read_bytes()
    paths[1].unlink()
    assert "which it continues, is missing" in problems(keystore, anchors)
    paths[1].write_bytes(data.replace(b"\n\npqsec", b"\nAAAA" + b"A" * 39 + b"=\n\npqsec", 1))
    assert f"{paths[1]}: " in problems(keystore, anchors)
    other = made(tmp_path / "other", "classical")
    paths[1].write_bytes(b"old 0\n\n" + (other.root / "public/ledger.checkpoint").read_bytes())
    assert "not signed by a CA of this keystore" in problems(keystore, anchors)
    paths[1].write_bytes(b"x")
    with pytest.raises(MalformedError, match=r"\.checkpoint: not a head"):
        audit(keystore, anchors=anchors)
    with pytest.raises(FileError, match="is not a folder"):
        audit(keystore, anchors=tmp_path / "nowhere")


@pytest.mark.parametrize("scope", [Scope.PERMISSIONS, Scope.IDENTITY, Scope.BOTH])
def test_anchors_of_cas_that_were_replaced_stay_valid(keystore, anchors, scope):
    write_anchor(keystore, anchors)
    terms = Rollover(profile=keystore.profile, scope=scope)
    kept = keystore.unlock(None) if terms.needs_old_cas else None
    rotate(keystore, terms, kept=kept, now=NOW + DAY)
    now = Keystore.open(keystore.root, to_change=True)
    assert size(now) == len(now.lines())
    write_anchor(now, anchors)
    audit(now, anchors=anchors)


def forked(keystore, tmp_path):
    """Two copies were in use: the certificate that the other one issued, and is not in this one."""
    copy = tmp_path / "copy"
    shutil.copytree(keystore.root, copy, symlinks=True)
    add(Keystore.open(copy, to_change=True), **{"/lost": "0"})
    return Certificate.from_pem((copy / "enclaves/lost/cert.pem").read_bytes())


def test_a_certificate_that_the_ledger_lost_is_revoked_by_its_file(keystore, tmp_path):
    lost, cas = forked(keystore, tmp_path), keystore.unlock(None)
    assert [each.name for each in revocable(keystore, [], [lost], now=NOW)] == ["/lost"]
    [done], made_list = revoke(keystore, cas, [], certificates=[lost], now=NOW)
    assert (done.name, done.listed, done.before) == ("/lost", True, False)
    assert [each.serial_number for each in made_list.revoked] == [lost.serial_number]
    [done], _ = revoke(keystore, cas, [], certificates=[lost], now=NOW)
    assert done.before
    _, again = revoke(keystore, cas, ["/talker"], now=NOW)
    assert len(again.revoked) == 2
    sign_head(keystore, cas)
    audit(keystore)


def test_a_certificate_of_another_ca_is_not_revoked(keystore, tmp_path):
    other = made(tmp_path / "other", "classical")
    foreign = Certificate.from_pem((other.root / "enclaves/talker/cert.pem").read_bytes())
    for each in (foreign, keystore.identity_ca, keystore.permissions_ca):
        with pytest.raises(KeystoreError, match="is not a certificate of"):
            revoke(keystore, keystore.unlock(None), [], certificates=[each], now=NOW)
    lost = forked(keystore, tmp_path)
    with pytest.raises(KeystoreError, match="expired on"):
        revoke(keystore, keystore.unlock(None), [], certificates=[lost], now=lost.not_after + DAY)
