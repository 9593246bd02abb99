"""Removing a set of credentials: its files go, a line ends it, and the others stay as they are."""

import json
import shutil

import pytest

from pqsec_pki.errors import ExistsError, KeystoreError, UsageError, VerificationError
from pqsec_pki.keystore import Keystore, audit, change, layout, read_head
from pqsec_pki.keystore.anchoring import write_anchor
from pqsec_pki.lifecycle import (
    issue,
    removable_set,
    remove_set,
    renew,
    renew_list,
    revoke,
)
from pqsec_pki.lifecycle._key_checks import refuse_shared
from tests.unit.keystores import DAY
from tests.unit.killing import copies, fails, survives
from tests.unit.test_sets import (
    ABOUT_THE_LEDGER,
    CLASSICAL,
    HYBRID,
    LATER,
    PQ,
    TWO,
    added,
    create,
    files_of,
    issued,
    one_meaning,
    one_meaning_but_numbers,
    spec,
    states,
)
from tests.unit.test_sets_cas import begin_overlap, overlap, rotated


@pytest.fixture(params=[HYBRID, PQ], ids=["hybrid", "pq"])
def keystore(tmp_path, request):
    """A keystore with a classical set and another one, two participants and lists."""
    made = create(tmp_path / "k", CLASSICAL, request.param)
    issued(made)
    renew_list(made, made.unlock(None), now=LATER)
    return made


def removed(keystore, profile=None, now=LATER):
    profile = profile or keystore.profiles[-1].name
    authorities = keystore.unlock(None, without=(profile,))
    found = remove_set(keystore, authorities, profile, now=now)
    return found, Keystore.open(keystore.root, to_change=True)


def test_a_removed_set_is_gone_and_the_files_of_the_others_stay(keystore):
    before = files_of(keystore.root)
    found, left = removed(keystore)
    assert found.participants == TWO
    assert left.profiles == (CLASSICAL,)
    assert not (keystore.root / "sets").exists()
    after = files_of(keystore.root)
    assert before.keys() == after.keys()
    assert {each for each in before if before[each] != after[each]} <= ABOUT_THE_LEDGER
    one_meaning(left, *TWO, now=LATER)
    assert states(left) == dict.fromkeys(TWO, "valid")


def test_what_is_done_after_a_removal_is_done_in_the_sets_that_are_left(keystore):
    _, left = removed(keystore)
    authorities, now = left.unlock(None), LATER + DAY
    renew(left, authorities, TWO, now=now)
    issue(left, authorities, [spec("/new")], now=now)
    revoke(left, authorities, ["/new"], now=now)
    assert left.revocation_list.number == 2
    audit(left)


def test_the_line_of_the_end_is_in_a_head_that_the_others_signed(keystore):
    gone = keystore.sets[1].permissions_ca
    _, left = removed(keystore)
    head, last = read_head(left.root), left.lines()[-1]
    assert (last.entry.kind, last.entry.set_name) == ("set-end", keystore.profiles[1].name)
    assert head.head.size == last.number
    with pytest.raises(VerificationError):
        head.verify([gone.public_key])


def test_one_of_three_sets_is_removed(tmp_path):
    made = create(tmp_path / "k", CLASSICAL, HYBRID, PQ)
    issued(made)
    before = files_of(made.sets[2].folder)
    _, left = removed(made, "hybrid")
    assert left.profiles == (CLASSICAL, PQ)
    assert files_of(left.sets[1].folder) == before
    one_meaning(left, *TWO)


def test_settings_that_name_a_removed_set_decide_nothing(keystore):
    """Also if its files are there again: an older copy of both came back."""
    settings = keystore.root / layout.SETTINGS
    older, files = settings.read_bytes(), keystore.root.parent / "older"
    shutil.copytree(keystore.root / "sets", files, symlinks=True)
    _, left = removed(keystore)
    settings.write_bytes(older)
    for _ in range(2):
        with pytest.raises(KeystoreError):
            Keystore.open(keystore.root).open_ledger()
        with pytest.raises(KeystoreError), change(keystore.root):
            pass
        shutil.rmtree(keystore.root / "sets", ignore_errors=True)
        shutil.copytree(files, keystore.root / "sets", symlinks=True)
    with pytest.raises(KeystoreError, match="has the set of credentials"):
        Keystore.open(keystore.root).open_ledger()
    assert left.profiles == (CLASSICAL,)


def test_settings_of_before_an_addition_decide_nothing(tmp_path):
    made = create(tmp_path / "k", CLASSICAL)
    issued(made)
    older = (made.root / layout.SETTINGS).read_bytes()
    added(made)
    (made.root / layout.SETTINGS).write_bytes(older)
    with pytest.raises(KeystoreError, match="lacks the set of credentials hybrid"):
        Keystore.open(made.root).open_ledger()


def test_settings_of_before_a_removal_and_an_addition_fit_no_ledger(keystore):
    name = keystore.profiles[1]
    settings = keystore.root / layout.SETTINGS
    with_set = settings.read_bytes()
    _, left = removed(keystore)
    without = settings.read_bytes()
    added(left, name)
    settings.write_bytes(without)
    with pytest.raises(KeystoreError, match="lacks the set of credentials"):
        Keystore.open(keystore.root).open_ledger()
    assert json.loads(with_set)["algorithms"][1]["profile"] == name.name


def test_the_first_set_is_not_removed(keystore):
    before = files_of(keystore.root)
    with pytest.raises(KeystoreError, match="is the first set of credentials"):
        removable_set(keystore, "classical", now=LATER)
    with pytest.raises(KeystoreError, match="is the first set of credentials"):
        remove_set(keystore, keystore.unlock(None), "classical", now=LATER)
    with pytest.raises(KeystoreError, match="has no set of profile transition"):
        remove_set(keystore, keystore.unlock(None), "transition", now=LATER)
    assert files_of(keystore.root) == before


def test_without_the_keys_of_those_that_stay_no_set_is_removed(keystore):
    kept = keystore.unlock(None, without=("",))
    with pytest.raises(UsageError, match="that stay are needed"):
        remove_set(keystore, kept, keystore.profiles[1].name, now=LATER)


def test_a_set_whose_keys_are_lost_is_removed(keystore):
    for key in (keystore.sets[1].folder / "private").glob("*.key.pem"):
        key.unlink()
    _, left = removed(keystore)
    assert left.profiles == (CLASSICAL,)
    audit(left)


def test_a_set_with_earlier_generations_or_two_identity_cas_is_removed(keystore):
    view = keystore.sets[1]
    rotated(view)
    overlap(begin_overlap, view)
    _, left = removed(keystore)
    assert not view.folder.exists()
    audit(left)


def test_private_keys_of_a_removed_set_are_overwritten(keystore):
    paths = [each for each in keystore.sets[1].folder.rglob("*key.pem") if each.is_file()]
    handles = [path.open("rb") for path in paths]
    assert len(handles) == 4
    removed(keystore)
    for each in handles:
        with each:
            assert each.read().strip(b"\0") == b""


def test_what_somebody_else_put_beside_a_set_stays(keystore):
    notes = keystore.sets[1].folder / "notes.txt"
    notes.write_text("mine")
    _, left = removed(keystore)
    assert [*notes.parent.iterdir()] == [notes]
    with pytest.raises(ExistsError, match="is not a set of this keystore"):
        added(left, keystore.profiles[1])


def test_a_set_that_was_removed_is_added_again_as_a_new_one(keystore):
    profile, old = keystore.profiles[1], keystore.sets[1].identity_ca
    revoke(keystore, keystore.unlock(None), ["/talker"], now=LATER)
    _, left = removed(keystore)
    (left.root / "enclaves/listener/key.pem").rename(left.root / "enclaves/listener/away.txt")
    found = added(left, profile)
    assert found.left == ("/listener",)
    again = Keystore.open(left.root, to_change=True)
    assert again.sets[1].identity_ca != old
    with again.sets[1].open_ledger() as ledger:
        assert len(ledger.of_kind("identity-ca")) == 1
        assert list(ledger.participants()) == []
        assert ledger.of_kind("revocation") == []
    assert states(again) == {"/listener": "incomplete", "/talker": "revoked"}
    renew(again, again.unlock(None), ["/listener"], now=LATER + DAY)
    issue(again, again.unlock(None), [spec("/new")], now=LATER + DAY)
    one_meaning_but_numbers(again, "/new", now=LATER + DAY)


def test_a_key_of_a_removed_set_is_still_not_certified_in_another(keystore):
    """The same key, in an older copy or on a robot, would be in two sets."""
    key = keystore.sets[1].participant("/talker").certificate.public_key
    _, left = removed(keystore)
    with left.open_ledger() as ledger, pytest.raises(VerificationError, match="another set"):
        refuse_shared(ledger, {"/talker": [key]}, LATER)


def test_anchors_of_before_a_removal_are_known(keystore, tmp_path):
    anchors = tmp_path / "anchors"
    write_anchor(keystore, anchors)
    _, left = removed(keystore)
    write_anchor(left, anchors)
    audit(left, anchors=anchors)


def test_authorities_of_before_a_removal_change_nothing_more(keystore):
    before = keystore.unlock(None)
    removed(keystore)
    with pytest.raises(KeystoreError), change(keystore.root, before):
        pass


# All or none, wherever the process dies


@pytest.mark.parametrize("trial", [survives, fails], ids=["killed", "disk refuses"])
def test_a_set_is_removed_or_not(tmp_path, place, trial):
    made = create(tmp_path / "k", CLASSICAL, HYBRID)
    issued(made)
    outcomes = []

    def work(root):
        removed(Keystore.open(root, to_change=True))

    for root, _ in copies(place, made.root, work, trial, every=13):
        Keystore.recover(root)
        opened = Keystore.open(root, to_change=True)
        audit(opened)
        opened.unlock(None)
        one_meaning(opened, *TWO)
        is_there = len(opened.sets) == 2
        assert (root / "sets/hybrid").exists() == is_there
        outcomes.append(is_there)
        renew(opened, opened.unlock(None), ["/talker"], now=LATER)
    assert set(outcomes) == {False, True}
