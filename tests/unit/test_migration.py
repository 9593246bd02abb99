"""Plans of migrations, and their rehearsal on a copy."""

import hashlib
import os
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import pytest

from pqsec_pki import domain
from pqsec_pki.algorithms import PROFILES, profile_named
from pqsec_pki.errors import FileError, InvalidDocumentError, KeystoreError, UsageError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.migration import DEADLINES, plan_migration, rehearse, step_files
from pqsec_pki.migration._remover import remove
from pqsec_pki.migration.meetings import Side, failure
from pqsec_pki.migration.rehearsal import SAMPLE
from pqsec_pki.selfcheck import PQSEC, stack_named
from tests.unit.keystores import DAY, NOW, made

NOBODY = 65534
PQ = profile_named("pq")
CYCLONE, LIMITED = stack_named("cyclonedds"), stack_named("fastdds-3.1")


@pytest.fixture(scope="module")
def keystores(tmp_path_factory):
    """A keystore of each profile, by its name."""
    root = tmp_path_factory.mktemp("keystores")
    return {each.name: made(root / each.name, each.name) for each in PROFILES}


def digest(root):
    """Of all names, modes and contents below `root`."""
    found = hashlib.sha256()
    for path in sorted(root.rglob("*")):
        found.update(os.fsencode(path) + str(path.lstat().st_mode).encode())
        if path.is_symlink():
            found.update(os.fsencode(path.readlink()))
        elif path.is_file():
            found.update(path.read_bytes())
    return found.hexdigest()


def test_the_way_from_classical_keys(keystores):
    plan = plan_migration(keystores["classical"], PQ, (CYCLONE,), now=NOW)
    first, plugin, last = plan.steps
    assert [first.commands, plugin.commands[0], last.commands[0]] == [
        ("pqsec ca rotate --profile transition --apply",),
        "pqsec plugin install",
        "pqsec ca rotate --profile pq --apply",
    ]
    # New CAs: old and new files do not authenticate each other, so the domain stops.
    assert [each.at_once for each in plan.steps] == [True, False, True]
    assert "was issued by" in first.mixed
    assert [each.needs for each in first.stacks] == ["nothing"]
    # Plugin and stock stack meet in profile transition; without the plugin pq does not run.
    assert plugin.mixed == "Cyclone DDS with and without the plugin accept each other"
    assert "accepts no ml-dsa-65 key" in plugin.if_skipped[0]
    assert [each.needs for each in plugin.stacks] == ["libpqsec_dds.so; version 0.10 and later"]
    # While the plugin accepts stock peers, traffic has the stock key agreement.
    assert 'peers = "stock"' in plugin.commands[1]
    assert 'peers = "stock"' in last.commands[1]
    assert [each.level for each in plan.steps] == [0, 0, 3]
    assert "traffic keeps NIST level 0 instead of 3" in last.if_skipped
    assert "certificates and documents keep ecdsa-p256 keys" in last.if_skipped
    assert [first.reissued, last.reissued] == [2, 2]


@pytest.mark.slow
def test_a_version_that_cannot_send_large_messages(keystores):
    plan = plan_migration(keystores["classical"], PQ, (CYCLONE, LIMITED), now=NOW)
    needs = {each.stack: each.needs for each in plan.steps[0].stacks}
    assert needs["Cyclone DDS"] == "nothing"
    assert "over 8192 bytes" in needs["Fast DDS 3.1"]
    assert "use another version" in needs["Fast DDS 3.1"]


@pytest.mark.slow
def test_the_way_depends_on_where_it_begins(keystores):
    for before, target, titles in (
        ("transition", "pq", ["install", "change"]),
        ("transition", "cnsa2", ["install", "change"]),
        ("classical", "transition", ["change"]),
        ("hybrid", "pq", ["change"]),
        ("pq", "pq", []),
    ):
        plan = plan_migration(keystores[before], profile_named(target), (CYCLONE,), now=NOW)
        assert [each.title.split()[0] for each in plan.steps] == titles, (before, target)
        if plan.steps:
            level = profile_named(target).level
            assert plan.steps[-1].level == (0 if target == "transition" else level)


@pytest.mark.slow
def test_a_participant_whose_key_is_on_its_robot_needs_a_request(tmp_path):
    keystore = made(tmp_path / "k", "classical", names=("/talker", "/listener", "/robot"))
    (keystore.root / "enclaves/robot/key.pem").unlink()
    plan = plan_migration(keystore, PQ, (CYCLONE,), now=NOW)
    for step in (plan.steps[0], plan.steps[-1]):
        assert step.reissued == 2
        assert "it needs a new request" in step.left_out["/robot"]
    found = rehearse(keystore, PQ, now=NOW)
    assert found.participants == 2
    assert "/robot" in found.steps[0].left_out


def test_a_rehearsal_runs_old_with_new_and_changes_nothing(keystores, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    keystore = keystores["classical"]
    before = digest(keystore.root)
    found = rehearse(keystore, PQ, now=NOW)
    plan_migration(keystore, PQ, (CYCLONE,), now=NOW)
    assert digest(keystore.root) == before
    assert list(tmp_path.iterdir()) == []  # the copy is gone
    assert [each.profile for each in found.steps] == ["transition", "pq"]
    assert found.ok
    for step in found.steps:
        assert (step.reissued, step.succeeded, step.failures) == (2, 1, ())
        assert (step.old_with_new, step.old_with_new_refused) == (0, 2)
        assert "was issued by" in step.reason


@pytest.mark.slow
def test_a_rehearsal_that_is_killed_leaves_no_key(keystores, tmp_path):
    """The kill comes when there is a copy of a key of the keystore."""
    root = keystores["hybrid"].root
    name = min(path.parent.name for path in root.glob("enclaves/*/key.pem"))
    words = ["-k", root, "migrate", "plan", "--rehearse"]
    rehearsing = subprocess.Popen(
        [sys.executable, "-m", "pqsec_pki", *map(str, words)],
        env={**os.environ, "TMPDIR": str(tmp_path)},
        stdout=subprocess.DEVNULL,
    )
    while not list(tmp_path.glob(f"*/generation1/enclaves/{name}/key.pem")):
        assert rehearsing.poll() is None
        time.sleep(0.002)
    rehearsing.kill()
    rehearsing.wait()
    while [name for _, _, names in os.walk(tmp_path) for name in names if name.endswith(".pem")]:
        time.sleep(0.01)  # os.walk skips folders that are removed meanwhile


def test_a_copy_of_a_keystore_that_nobody_may_change_is_removed():
    """As a user that is not root: file modes do not restrict root."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place, "copy")
        private = folder / "generation1/private"
        private.mkdir(parents=True)
        (private / "identity_ca.key.pem").touch()
        (folder / "link").symlink_to("/")
        for each in (private, private.parent, folder):
            each.chmod(0o500)
        if os.geteuid() == 0:
            for each in (Path(place), folder, *folder.rglob("*")):
                os.lchown(each, NOBODY, NOBODY)
        child = os.fork()
        if not child:
            with suppress(BaseException):
                if os.geteuid() == 0:
                    os.setuid(NOBODY)
                remove(folder)
            os._exit(0)
        os.waitpid(child, 0)
        assert not folder.exists()


def test_a_keystore_that_nobody_may_change_is_rehearsed(tmp_path):
    keystore = made(tmp_path / "k", "classical")
    for each in (keystore.root, *keystore.root.rglob("*")):
        if each.is_dir() and not each.is_symlink():
            each.chmod(0o555)
    assert rehearse(keystore, PQ, now=NOW).ok


@pytest.mark.slow
def test_a_large_fleet_is_sampled(tmp_path):
    names = [f"/robot{number}" for number in range(SAMPLE + 2)]
    keystore = made(tmp_path / "k", "transition", names=names)
    found = rehearse(keystore, PQ, now=NOW)
    assert found.participants == len(names)
    assert 2 <= len(found.sample) <= SAMPLE
    assert found.steps[0].reissued == len(names)
    pairs = len(found.sample) * (len(found.sample) - 1) // 2
    assert found.steps[0].succeeded == pairs


def test_a_rehearsal_needs_a_pair(tmp_path):
    keystore = made(tmp_path / "k", "classical", names=("/alone",))
    with pytest.raises(KeystoreError, match="two participants"):
        rehearse(keystore, PQ, now=NOW)


def test_a_rehearsal_in_which_no_pair_may_meet_has_proved_nothing(tmp_path):
    apart = {"/one": "0", "/two": "1"}
    keystore = made(tmp_path / "k", "hybrid", domains="0-1", names=apart)
    found = rehearse(keystore, PQ, now=NOW)
    assert [each.reissued for each in found.steps] == [2]
    assert not any(each.succeeded or each.failures for each in found.steps)
    assert not found.ok


def test_dates_are_in_order_and_have_sources():
    days = [each.day for each in DEADLINES]
    assert days == sorted(days)
    assert all(each.source for each in DEADLINES)


def with_large_permissions(root):
    """Two participants, and one whose permissions fill a message with classical keys."""
    keystore = made(root, "classical")
    # 259 kB: it fits into a token with ECDSA, and not with ML-DSA beside it.
    topics = [f"rt/some/very/long/topic/name/number{number:06d}" for number in range(4500)]
    spec = ParticipantSpec(
        name="/large", domains=keystore.domains, publish=topics, validity=90 * DAY
    )
    issue(keystore, keystore.unlock(None), [spec], now=NOW)
    return keystore


@pytest.mark.slow
def test_a_rehearsal_finds_a_pair_that_cannot_meet_any_more(tmp_path):
    keystore = with_large_permissions(tmp_path / "k")
    pair = [Side(keystore, name, PQSEC) for name in ("/large", "/talker")]
    assert failure(*pair, 0, NOW) is None  # before, they can
    found = rehearse(keystore, PQ, now=NOW)
    assert not found.ok
    assert [(each.profile, each.succeeded) for each in found.steps] == [
        ("transition", 1),
        ("pq", 1),
    ]
    for step in found.steps:
        assert [each.split(": ")[0] for each in step.failures] == [
            "/large, /listener",
            "/large, /talker",
        ]
        assert all("a sample larger than 266240 bytes" in each for each in step.failures)


DOMAIN = """\
# robots of the lab
name: Test
profile: classical   # for now
validity: 90d
stacks: [cyclonedds, fastdds-3.1]
roles:
  any: {publish: [x]}
participants:
  - {list: names.txt, role: any}
"""


@pytest.mark.slow
def test_each_step_has_a_file_with_which_apply_makes_it(tmp_path):
    (tmp_path / "names.txt").write_text("/talker\n/listener\n")
    file = tmp_path / "domain.yaml"
    file.write_text(DOMAIN)
    root = tmp_path / "k"
    domain.apply(domain.read_domain(file), root, passphrase=None, now=NOW)
    keystore = Keystore.open(root)
    plan = plan_migration(keystore, PQ, (CYCLONE,), now=NOW)
    files = step_files(plan, keystore, file, tmp_path, now=NOW)
    assert [each.name for each in files] == ["1-transition.yaml", "2-transition.yaml", "3-pq.yaml"]
    for each in files:
        (tmp_path / each.name).write_bytes(each.document)
    first = files[0].document.decode()
    assert first.startswith("# 1. change the keystore from profile classical to transition (stop")
    assert (
        "\n# robots of the lab\nprofile: transition\nmigrate_from: classical\nname: Test\n" in first
    )

    def apply(each):
        desired = domain.read_domain(tmp_path / each.name)
        done = domain.apply(desired, root, passphrase=None, now=NOW)
        again = domain.plan(desired, Keystore.open(root), now=NOW)
        assert again.in_order
        return [(step.action, step.name) for step in done.steps]

    with pytest.raises(KeystoreError, match=r"has profile pq, but .* has profile classical"):
        apply(files[2])
    # The plugin is work on robots: its file finds nothing to do in the keystore.
    assert [apply(each) for each in files] == [
        [("change-profile", "")],
        [],
        [("change-profile", "")],
    ]
    assert Keystore.open(root).profile == PQ
    assert rehearse(Keystore.open(root), profile_named("cnsa2"), now=NOW).ok


@pytest.mark.slow
def test_without_a_domain_file_the_steps_are_made_of_the_keystore(keystores, tmp_path):
    keystore = keystores["transition"]
    plan = plan_migration(keystore, PQ, (CYCLONE,), now=NOW)
    files = step_files(plan, keystore, None, tmp_path, now=NOW)
    assert [each.name for each in files] == ["1-transition.yaml", "2-pq.yaml"]
    for each in files:
        desired = domain.desired_in(each.document, tmp_path / each.name)
        assert set(desired.members) == {"/talker", "/listener"}
        found = domain.plan(desired, keystore, now=NOW)
        assert [step.action for step in found.steps] == ["change-profile"] * (
            desired.profile == "pq"
        )


def test_a_file_that_cannot_be_changed_is_refused(tmp_path, keystores):
    keystore = keystores["classical"]
    plan = plan_migration(keystore, PQ, (CYCLONE,), now=NOW)
    file = tmp_path / "domain.yaml"
    for text in (
        "{profile: classical, participants: []}",
        'participants: []\n"profile": classical',
    ):
        file.write_text(text)
        with pytest.raises(UsageError, match=r"domain\.yaml"):
            step_files(plan, keystore, file, tmp_path, now=NOW)
    (tmp_path / "names.txt").write_text("/talker\n")
    file.write_text("participants: [{list: names.txt, publish: [x]}]")
    with pytest.raises(FileError, match=r"names\.txt"):
        step_files(plan, keystore, file, tmp_path / "elsewhere", now=NOW)


def test_a_participant_that_is_not_reissued_stays_blocked(tmp_path):
    keystore = made(tmp_path / "k", "classical", names=("/talker", "/robot"))
    (keystore.root / "enclaves/robot/key.pem").unlink()
    data = b"profile: transition\nmigrate_from: classical\nparticipants: []\n"
    desired = domain.desired_in(data, tmp_path / "domain.yaml")
    found = domain.plan(desired, keystore, now=NOW)
    assert [each.name for each in found.blocked] == ["/robot"]
    assert "it needs a new request" in found.blocked[0].why


def test_the_profile_to_change_from_is_another_one(tmp_path):
    for text in ("migrate_from: pq", "{migrate_from: pq, profile: pq}"):
        with pytest.raises(InvalidDocumentError, match="needs a `profile`"):
            domain.desired_in(text.encode(), tmp_path / "domain.yaml")
    with pytest.raises(InvalidDocumentError, match="'vortex' is not a stack; known: cyclonedds"):
        domain.desired_in(b"stacks: [cyclonedds, vortex]", tmp_path / "domain.yaml")


def test_a_keystore_that_cannot_be_copied_is_not_rehearsed(tmp_path):
    keystore = made(tmp_path / "k", "classical")
    os.mkfifo(keystore.root / "private" / "pipe")
    with pytest.raises(FileError, match="cannot be copied for a rehearsal"):
        rehearse(keystore, PQ, now=NOW)
