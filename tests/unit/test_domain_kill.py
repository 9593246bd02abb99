"""An apply that is killed at any instant leaves a keystore that holds, and the next one ends it."""

import random
import re
import shutil
import signal
import subprocess
import sys
import time
from datetime import UTC, datetime
from importlib import import_module

import pytest

from pqsec_pki.domain import StepAction, create_keystore, read_domain
from pqsec_pki.keystore import audit, registrations
from pqsec_pki.lifecycle import revoke
from tests.longer import LONG
from tests.unit.domains import DAY, FILE, NOW, Scene
from tests.unit.killing import (
    at_once,
    check_no_halves,
    check_whole,
    copies,
    drafts,
)
from tests.unit.test_domain_orders import BOTH, OrderedLine

BEFORE = NOW - 60 * DAY
NOT_MET = {
    *(StepAction.CREATE_CAS, StepAction.RENEW_CRL),
    StepAction.CHANGE_PROFILE,  # a rollover: test_rotate_kill
    StepAction.STORE_APPROVALS,  # the plan would need approvals: test_approvals_kill
    StepAction.ENROL,  # the keystore would need a grant: the test after it
    *(StepAction.ADD_SET, StepAction.STORE_STOCK),  # test_domain_sets
}
"""Of the actions, at the start below."""
EVERY = 13
"""Of how many calls one is killed: what they belong to has its own sweeps."""
APPLY = "pqsec_pki.domain.applying"
"""The module, not the function of the room."""
SMALL_BATCHES = f"""
from importlib import import_module
from pqsec_pki.cli import main
import_module({APPLY!r}).BATCH = 4
main()
"""


def start(scene):
    """A keystore that is away from its file in each way there is."""
    scene.write(FILE)
    scene.change("1..3", "1..4")
    scene.apply(BEFORE)
    keystore = scene.keystore
    revoke(keystore, keystore.unlock(None), ["/r4"], now=BEFORE)
    (scene.file_of("/r1", "cert.pem")).unlink()
    shutil.copyfile(scene.file_of("/r2", "cert.pem"), scene.file_of("/r3", "cert.pem"))
    scene.change(
        "name: Lab", "name: Lab\ngovernance: authenticated\nprune: true\ngroups: {both: [/r2, /r3]}"
    )
    scene.change("rt/cmd", "rt/order")
    scene.change("1..4", "2..3")
    scene.change("name: /monitor", "name: /new")


def check_holds(scene):
    """Whatever was begun is whole."""
    check_no_halves(scene.root)
    for name in {"/r2", "/new"} & set(scene.keystore.names()):
        check_whole(scene.keystore, name)


def layout(folder):
    """The names of what is there; of a draft, which is swept whole, only that it is."""
    names = {str(path.relative_to(folder)) for path in folder.rglob("*")}
    return frozenset(re.sub(r"(/\.draft-).*", r"\1", name) for name in names)


def check_ended(scene):
    """Another apply does what is left."""
    left = scene.steps()
    scene.apply()
    assert scene.plan().in_order
    assert drafts(scene.root) == [] or not left
    audit(scene.keystore)


@pytest.mark.slow
def test_it_is_ended_by_the_next_whenever_the_kill_comes(place, monkeypatch):
    monkeypatch.setattr(import_module(APPLY), "BATCH", 1)
    (place / "original").mkdir()
    original = Scene(place / "original")
    start(original)
    every = len(original.steps())
    assert {step.action for step in original.plan().steps} == set(StepAction) - NOT_MET
    lefts, ended = [], set()
    for folder, _ in copies(
        place, original.file.parent, lambda at: Scene.at(at).apply(), every=EVERY
    ):
        scene, what = Scene.at(folder), layout(folder)
        check_holds(scene)
        lefts.append(len(scene.steps()))
        if what not in ended:
            ended.add(what)
            check_ended(scene)
    assert len(lefts) > 200 / EVERY
    assert len(ended) > every
    # One after the other is done, both revocations at once, and none is undone.
    assert list(dict.fromkeys(lefts)) == [*range(every, 1, -1), 0]


def test_an_order_is_performed_whole_or_not_at_all_whenever_the_kill_comes(place):
    """And counts for its grant once, however often it is begun."""
    original = OrderedLine(place / "original")
    original.bring(original.order(original.add(), *BOTH))
    outcomes = []
    for folder, _ in copies(place, original.folder, lambda at: Scene.at(at).apply(), every=EVERY):
        scene = Scene.at(folder)
        [grant] = registrations(scene.keystore)
        enrolled = {*BOTH} & set(scene.keystore.names())
        assert (len(enrolled), grant.used) in {(0, 0), (2, 2)}
        outcomes.append(bool(enrolled))
        check_ended(scene)
        assert [each.used for each in registrations(scene.keystore)] == [2]
    # How often the ledger's file is opened depends on when it was changed, so they are not sorted.
    assert set(outcomes) == {False, True}


@pytest.mark.slow
def test_a_process_that_is_killed_is_ended_by_the_next(place):
    chance = random.Random("apply")  # noqa: S311 -- the same each time
    text = FILE.replace("1..3", "1..40")
    killed = 0
    for number in range(4 if LONG else 2):
        (place / str(number)).mkdir()
        scene = Scene(place / str(number), text)
        command = [sys.executable, "-c", SMALL_BATCHES, "-k", str(scene.root), "apply"]
        command += [str(scene.file), "--yes", "--no-passphrase"]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        while process.poll() is None and not scene.root.exists():
            time.sleep(0.002)
        time.sleep(chance.uniform(0, 0.4))
        process.send_signal(signal.SIGKILL)
        said = process.communicate(timeout=300)[1]
        assert b"Traceback" not in said
        killed += process.returncode == -signal.SIGKILL
        names = scene.keystore.names() if (scene.root / "pqsec.json").exists() else []
        assert len(names) in {*range(0, 41, 4), 41}
        done = subprocess.run(command, check=True, capture_output=True, timeout=300)
        assert b"Traceback" not in done.stderr
        assert scene.plan(datetime.now(UTC)).in_order
        audit(scene.keystore)
    assert killed


@pytest.mark.parametrize("count", [2, 4])
def test_several_at_once_lose_nothing(place, count):
    scene = Scene(place, FILE.replace("1..3", "1..8"))
    create_keystore(read_domain(scene.file), scene.root, passphrase=None, now=NOW)
    found = scene.plan()
    assert at_once(*[lambda: scene.take(found)] * count) == [0] * count
    assert scene.plan().in_order
    entries = [each for each in scene.keystore.ledger() if each.kind == "participant"]
    assert len(entries) == len({each.serial for each in entries}) == len(scene.keystore.names())
    audit(scene.keystore)
