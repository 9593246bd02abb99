"""An approved plan that is killed goes on with the same approvals, and makes each step once."""

import subprocess
import sys

import pytest

from pqsec_pki.approvals import proposal_file
from pqsec_pki.domain import StepAction, apply_plan, approved
from pqsec_pki.keystore import audit
from pqsec_pki.lifecycle import sign_permissions
from tests.longer import LONG
from tests.unit.approving import GROWS, WEEK, Council, refused
from tests.unit.domains import DAY, NOW

EVERY = 1 if LONG else 139
"""Of how many calls one is killed."""
MADE = [*("plan", "approval", "approval"), *("permissions", "permissions", "revocation", "crl")]


@pytest.fixture(scope="module")
def first_council(tmp_path_factory):
    """Made once, to be copied."""
    return Council(tmp_path_factory.mktemp("council"))


@pytest.fixture
def council(first_council, tmp_path):
    return first_council.copied(tmp_path)


KILLED = """
import os, sys
from importlib import import_module
from tests.unit.approving import PEOPLE, Council
from tests.unit.domains import NOW
from pqsec_pki.algorithms import load_private_key
from pqsec_pki.domain import apply_plan, approved_plan, read_domain
from pqsec_pki.approvals import approval_in, proposal_in
from pqsec_pki.keystore import Keystore
from pathlib import Path
from tests.unit.killing import Countdown, CALLS

folder, calls = Path(sys.argv[1]), int(sys.argv[2])
import_module("pqsec_pki.domain.applying").BATCH = 1
countdown = Countdown(calls)
proposal, first = proposal_in((folder / "plan.json").read_bytes())
second = approval_in((folder / "bob.approval").read_bytes())
desired = read_domain(folder / "domain.yaml")
keystore = Keystore.open(folder / "k", to_change=True)
for name in CALLS:
    countdown.watch(name)
begun = approved_plan(proposal, [first, second], desired, keystore, now=NOW).begin(NOW)
cas = begun.keystore.unlock(None)
for batch in apply_plan(desired, begun.keystore, cas, begun.plan, now=NOW):
    pass
"""


@pytest.mark.slow
def test_a_plan_that_was_killed_goes_on_and_makes_each_step_once(tmp_path):
    """At any of the calls: each step has one line in the ledger in the end, and so has the plan."""
    (tmp_path / "original").mkdir()
    council = Council(tmp_path / "original")
    council.change(*GROWS)
    council.change("1..3", "1..2")
    council.change("validity", "prune: true\nvalidity")
    proposal, first = council.proposed()
    (council.folder / "plan.json").write_bytes(proposal_file(proposal, first))
    second = council.approval(proposal, "bob")
    (council.folder / "bob.approval").write_bytes(second.to_file())
    before = council.kinds()
    states = set()
    for calls in range(1, 1000, EVERY):
        folder = tmp_path / f"{calls}"
        subprocess.run(["cp", "-a", council.folder, folder], check=True)
        done = subprocess.run(
            [sys.executable, "-c", KILLED, folder, str(calls)], check=False, capture_output=True
        )
        assert done.returncode in {0, 9}, done.stderr
        copy = Council.at(folder)
        states.add(tuple(copy.kinds()[len(before) :]))
        if done.returncode == 0:
            break
        if not copy.plan().in_order:
            copy.decide(proposal, first, second, now=NOW + DAY)
        since = copy.kinds()[len(before) :]
        assert since == MADE
        refused(copy, proposal, first, second, words="was applied already", now=NOW + DAY)
        audit(copy.keystore)
    else:
        pytest.fail("it never ended by itself")
    assert len(states) > 2


def test_what_is_left_of_a_killed_plan_is_not_widened(council, monkeypatch):
    """A step that was made once is not made again, though it would fit once more."""
    council.change(*GROWS)
    council.change("1..3", "1..2")
    council.change("validity", "prune: true\nvalidity")
    proposal, first = council.proposed()
    given = first, council.approval(proposal, "bob")
    begun = council.approved(proposal, *given).begin(NOW)
    batches = apply_plan_of(council, begun)
    next(batches)  # the permissions; then it is killed
    batches.close()
    keystore = council.keystore
    new = council.file.read_text()
    council.change(GROWS[1], GROWS[0])
    members = [council.desired.members[name].spec() for name in ("/r1", "/r2")]
    sign_permissions(keystore, keystore.unlock(None), members, now=NOW)  # taken away
    council.write(new)
    assert council.decide(proposal, *given) == [("revoke", "/r3")]
    assert council.allowed("/r1")[1] == ["rt/cmd"]


def test_an_interrupted_plan_does_not_go_on_after_another_one(council):
    """Three people decided otherwise; then one of them took the old approvals out again."""
    before = council.file.read_text()
    council.change(*GROWS)
    interrupted = council.file.read_text()
    proposal, first = council.proposed()
    given = first, council.approval(proposal, "bob")
    council.approved(proposal, *given).begin(NOW)
    council.write(before.replace("1..3", "1..4"))
    instead, second = council.proposed()
    council.decide(instead, second, council.approval(instead, "carol"))
    council.write(interrupted)
    refused(council, proposal, *given, words="another plan was begun after this one")
    assert council.allowed("/r1")[1] == ["rt/cmd"]


def apply_plan_of(council, begun):
    cas = begun.keystore.unlock(None)
    return apply_plan(council.desired, begun.keystore, cas, begun.plan, now=NOW)


def test_a_killed_plan_expires(council):
    council.change(*GROWS)
    proposal, first = council.proposed()
    given = first, council.approval(proposal, "bob")
    council.approved(proposal, *given).begin(NOW)
    refused(council, proposal, *given, words="expired", now=NOW + WEEK)
    assert council.decide(proposal, *given)


def test_each_step_leaves_a_line_by_which_it_is_known():
    left = {*StepAction} - {StepAction.CREATE_CAS, StepAction.STORE_GROUPS}
    assert approved._LINES.keys() == left
