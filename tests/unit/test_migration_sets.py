"""Migration by addition: sets of credentials beside those that run."""

import pytest

from pqsec_pki import domain
from pqsec_pki.algorithms import profile_named
from pqsec_pki.errors import KeystoreError, PassphraseError, UsageError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import add_set
from pqsec_pki.migration import (
    plan_addition,
    plan_migration,
    rehearse,
    rehearse_addition,
    step_files,
)
from pqsec_pki.selfcheck import stack_named
from tests.unit.keystores import DAY, NOW, made
from tests.unit.test_domain_sets import other_form
from tests.unit.test_migration import DOMAIN, digest
from tests.unit.test_sets import ABOUT_THE_LEDGER, files_of, one_meaning_but_numbers

CLASSICAL, HYBRID, PQ = map(profile_named, ("classical", "hybrid", "pq"))
CYCLONE = stack_named("cyclonedds")
THREE = ("/talker", "/listener", "/robot")


@pytest.fixture
def keystore(tmp_path):
    """A classical keystore; the key of /robot is on the robot."""
    keystore = made(tmp_path / "k", "classical", names=THREE)
    (keystore.root / "enclaves/robot/key.pem").unlink()
    return keystore


def test_the_plan_says_what_is_added_for_whom_and_how_to_go_back(keystore):
    before = digest(keystore.root)
    plan = plan_addition(keystore, (CLASSICAL, HYBRID), (CYCLONE,), now=NOW)
    assert digest(keystore.root) == before
    assert (plan.before, plan.target) == ("classical", "classical, hybrid")
    first, plugin = plan.steps
    assert first.commands == ("pqsec ca add-set hybrid",)
    assert first.added == (
        "CAs, governance and lists of set hybrid, in sets/hybrid",
        "certificates of set hybrid for /listener, /talker",
    )
    assert first.removed == ("nothing: no file of classical changes, and no robot restarts",)
    why = "its key is not here: it needs a request with a key of each set"
    assert first.left_out == {"/robot": why}
    assert first.back[0] == "robots keep all their files, so nothing is to be done there"
    assert not first.at_once
    assert first.mixed == "robots with old and with new files accept each other"
    assert [each.needs for each in first.stacks] == ["nothing"]
    assert (first.level, plugin.level) == (0, HYBRID.level)
    assert "only nobody: `stock` is empty" in plugin.mixed
    facts = [kind for kind, _ in first.facts()]
    assert {"adds", "removes", "run", "back", "not"} <= {*facts}


def test_each_set_is_a_step(keystore):
    plan = plan_addition(keystore, (CLASSICAL, HYBRID, PQ), (CYCLONE,), now=NOW)
    assert [each.after for each in plan.steps] == [
        "classical, hybrid",
        *["classical, hybrid, pq"] * 2,
    ]
    assert plan.steps[1].before == "classical, hybrid"


def test_nothing_is_planned_for_what_is_there(keystore):
    hybrid = {"validity": 90 * DAY, "passphrase": None, "now": NOW}
    add_set(keystore, keystore.unlock(None), HYBRID, **hybrid)
    opened = Keystore.open(keystore.root)
    assert plan_addition(opened, (CLASSICAL, HYBRID), (CYCLONE,), now=NOW).steps == ()
    third = plan_addition(opened, (CLASSICAL, HYBRID, PQ), (CYCLONE,), now=NOW)
    assert third.steps[0].before == "classical, hybrid"
    for refused in (plan_migration, lambda *args, now: rehearse(*args[:2], now=now)):
        with pytest.raises(KeystoreError, match="is for one set") as error:
            refused(opened, PQ, (CYCLONE,), now=NOW)
        assert "--to classical,hybrid,PROFILE" in error.value.hint


@pytest.mark.parametrize("profiles", [(HYBRID, CLASSICAL), (PQ, HYBRID)])
def test_what_would_be_removed_or_moved_is_refused(keystore, profiles):
    with pytest.raises(KeystoreError, match="none is removed") as error:
        plan_addition(keystore, profiles, (CYCLONE,), now=NOW)
    assert "--to classical,PROFILE" in error.value.hint


def test_a_profile_is_added_once(keystore):
    with pytest.raises(UsageError, match="classical is given twice"):
        plan_addition(keystore, (CLASSICAL, HYBRID, CLASSICAL), (CYCLONE,), now=NOW)


def test_what_is_in_the_way_is_told(keystore):
    other_form(keystore)
    plan = plan_addition(keystore, (CLASSICAL, HYBRID), (CYCLONE,), now=NOW)
    assert "sign-governance" in plan.steps[0].left_out["the keystore"]


def test_the_files_of_the_steps_add_the_set_and_change_no_octet_of_the_first(tmp_path):
    (tmp_path / "names.txt").write_text("/talker\n/listener\n")
    file, root = tmp_path / "domain.yaml", tmp_path / "k"
    file.write_text(DOMAIN)
    domain.apply(domain.read_domain(file), root, passphrase=None, now=NOW)
    keystore = Keystore.open(root)
    plan = plan_addition(keystore, (CLASSICAL, HYBRID), (CYCLONE,), now=NOW)
    files = step_files(plan, keystore, file, tmp_path, now=NOW)
    assert [each.name for each in files] == [
        "1-classical+hybrid.yaml",
        "2-classical+hybrid.yaml",
    ]
    assert b"does the same as `pqsec ca add-set`" in files[0].document
    for each in files:
        (tmp_path / each.name).write_bytes(each.document)
    before = files_of(root)
    wanted = domain.read_domain(tmp_path / files[0].name)
    assert wanted.profiles == ("classical", "hybrid")
    domain.apply(wanted, root, passphrase=None, now=NOW)
    after = files_of(root)
    changed = {each for each in {*before, *after} if before.get(each) != after.get(each)}
    assert changed <= ABOUT_THE_LEDGER
    one_meaning_but_numbers(Keystore.open(root), "/talker", "/listener", now=NOW)
    again = domain.plan(domain.read_domain(tmp_path / files[1].name), Keystore.open(root), now=NOW)
    assert again.in_order


def test_the_files_of_steps_are_made_of_a_keystore_with_sets(keystore, tmp_path):
    hybrid = {"validity": 90 * DAY, "passphrase": None, "now": NOW}
    add_set(keystore, keystore.unlock(None), HYBRID, **hybrid)
    opened = Keystore.open(keystore.root)
    plan = plan_addition(opened, (CLASSICAL, HYBRID, PQ), (CYCLONE,), now=NOW)
    [first, _] = step_files(plan, opened, None, tmp_path, now=NOW)
    found = domain.desired_in(first.document, tmp_path / first.name)
    assert found.profiles == ("classical", "hybrid", "pq")


def test_a_rehearsal_adds_the_sets_to_a_copy_and_everybody_meets(keystore, tmp_path, monkeypatch):
    place = tmp_path / "copies"
    place.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(place))
    before = digest(keystore.root)
    found = rehearse_addition(keystore, (CLASSICAL, HYBRID), passphrase=None, now=NOW)
    assert digest(keystore.root) == before
    assert list(place.iterdir()) == []
    assert found.ok
    [step] = found.steps
    assert step.profile == "classical, hybrid"
    assert (step.reissued, step.succeeded) == (2, 1)
    assert (step.old_with_new, step.old_with_new_refused) == (2, 0)
    assert "/robot" in step.left_out


def test_a_rehearsal_opens_the_keys_of_the_copy(tmp_path):
    file, secret = tmp_path / "domain.yaml", b"some secret words"
    file.write_text(DOMAIN.replace("{list: names.txt, role", "{name: [/talker, /listener], role"))
    root = tmp_path / "k"
    domain.apply(domain.read_domain(file), root, passphrase=secret, now=NOW)
    keystore = Keystore.open(root)
    with pytest.raises(PassphraseError):
        rehearse_addition(keystore, (CLASSICAL, HYBRID), passphrase=None, now=NOW)
    assert rehearse_addition(keystore, (CLASSICAL, HYBRID), passphrase=secret, now=NOW).ok
