"""Real participants of real stacks meet, or are refused, as they should be: processes and wire.

The table of what came of it stands in measured.md. PQSEC_WRITE_RESULTS=1 writes it there.
"""

import os
import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from pqsec_pki.errors import VerificationError
from pqsec_pki.trial import (
    MACHINE,
    Act,
    Installation,
    MissingStackError,
    TopicRoute,
    TrialSetup,
    built,
    find,
    run_peers,
    run_trial,
    unauthenticated,
    unique_text,
)
from pqsec_pki.trial.words import words
from tests.interop.conftest import TOPIC
from tests.interop.roots import TRIXIE
from tests.interop.trials import (
    CASES,
    LONGEST_MEETING,
    RECEIVER,
    SENDER,
    Laboratory,
    Runs,
    table,
)

pytestmark = pytest.mark.interop

AT_ONCE = 4 if os.geteuid() == 0 else 1
"""Most of what they do is waiting. Who is not root has but one network for all."""
RESULTS = Path(__file__).parents[2] / "docs/reference/measured.md"
BLOCK = re.compile(r"(?s)(<!-- results: [^\n]*-->\n).*(<!-- end of results -->)")
STACKS = {
    "cyclonedds": ("cyclonedds", MACHINE),
    "cyclonedds trixie": ("cyclonedds", TRIXIE),
    "fastdds": ("fastdds", MACHINE),
    "fastdds trixie": ("fastdds", TRIXIE),
}
"""Those of this machine, and the newer ones of Debian trixie."""
PAIRS = [pytest.param(stack, name, id=f"{stack}-{name}") for stack in STACKS for name in CASES]


@pytest.fixture(scope="module")
def installations() -> dict[str, Installation | MissingStackError]:
    """The stacks, with their peers compiled, as `pqsec try` keeps them; or why that cannot be."""
    found = {}
    for name, (stack, root) in STACKS.items():
        try:
            found[name] = find(stack, root)
            built(found[name])
        except MissingStackError as error:
            found[name] = error
    return found


@pytest.fixture(scope="module")
def installation(installations, requires):
    """installation(name) is that stack."""

    def of(name: str) -> Installation:
        found = installations[name]
        missing = isinstance(found, MissingStackError)
        remedy = "run .ci/trixie" if "trixie" in name else missing and found.hint
        return requires(None if missing else found, f"the stack {name}", remedy)

    return of


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory, now) -> Laboratory:
    return Laboratory.create(tmp_path_factory.mktemp("trials"), now)


@pytest.fixture(scope="module")
def runs(laboratory, installations) -> Runs:
    there = {name: each for name, each in installations.items() if isinstance(each, Installation)}
    pool = ThreadPoolExecutor(AT_ONCE)
    yield Runs(laboratory, there, pool)
    pool.shutdown(cancel_futures=True)


@pytest.mark.slow(but=2)
@pytest.mark.parametrize(("stack", "name"), PAIRS)
def test_two_participants_meet_or_are_refused_as_they_should(installation, runs, stack, name):
    case, which, report = CASES[name], installation(stack), runs.report(stack, name)
    told = "\n".join(f"-- {each.role.name}\n{each.log}" for each in report.trial_run.outcomes)
    expected = case.expected(which)
    if expected is None:
        assert report.accepted, told
        assert report.unauthenticated_heard is case.lets_strangers_hear(which), told
        return
    assert report.unauthenticated.received is None
    assert report.receiver.received is None, told
    assert not report.sender.matched, told
    said = [*words(told), report.sender.refused or "", *(each.said for each in report.findings)]
    assert any(expected in each for each in said), told
    assert report.receiver.signal is None
    assert report.sender.signal is None


@pytest.mark.slow(but=15)
@pytest.mark.parametrize(("stack", "name"), PAIRS)
def test_what_a_refusal_says_comes_with_a_remedy(installation, runs, stack, name):
    if CASES[name].expected(installation(stack)) is None:
        assert runs.report(stack, name).findings == ()
    else:
        assert any(each.remedy for each in runs.report(stack, name).findings)


@pytest.mark.parametrize("stack", STACKS)
def test_a_sample_can_be_read_on_the_wire_only_where_nothing_protects_it(
    installation, runs, requires, stack
):
    installation(stack)
    reports = {name: runs.report(stack, name) for name in CASES}
    seen = {name: each.trial_run.wire for name, each in reports.items() if each.accepted}
    assert len(seen) >= 5
    for name, wire in seen.items():
        requires(wire, "a wire to watch", "run the tests as root")
        assert wire.packets > 100
        assert wire.lost == 0
        assert (wire.readable > 0) is CASES[name].is_open, name


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("stack", STACKS)
def test_strangers_hear_each_other_and_can_be_read_on_the_wire(
    installation, requires, tmp_path, stack
):
    """What the other tests rely on: who has no credentials could hear, and the wire is seen."""
    which, text = installation(stack), unique_text()
    sending = unauthenticated(which, Act.SEND, tmp_path, text)
    listening = replace(
        unauthenticated(which, Act.RECEIVE, tmp_path), unauthenticated=False
    )  # it is waited for
    program = which.peer(built(which))
    setup = TrialSetup(program=program, domain=0, topic=TOPIC, timeout=LONGEST_MEETING)
    trial_run = run_peers(setup, [sending, listening])
    assert trial_run.outcomes[1].received == text
    wire = requires(trial_run.wire, "a wire to watch", "run the tests as root")
    assert wire.readable > 0


@pytest.mark.slow(but=2)
@pytest.mark.parametrize("stack", STACKS)
def test_a_stranger_that_sends_is_not_heard(installation, runs, stack):
    installation(stack)
    sender, receiver = runs.unauthenticated(stack).outcomes
    assert sender.joined
    assert receiver.joined
    assert (sender.matched, receiver.received) == (False, None)


def test_transition_is_not_exported_for_a_fast_dds_that_cannot_send_it(installation, laboratory):
    trial = laboratory.trial(installation("fastdds trixie"), CASES["transition"], timeout=1)
    way = TopicRoute(sender=SENDER, receiver=RECEIVER, domain=0, topic=TOPIC)
    with pytest.raises(VerificationError, match="8192"):
        run_trial(trial, way)


def test_the_table_in_the_documents_is_what_was_measured(installation, runs):
    measured = table(runs, {stack: installation(stack) for stack in STACKS})
    written = BLOCK.sub(lambda found: found[1] + measured + found[2], RESULTS.read_text())
    if os.environ.get("PQSEC_WRITE_RESULTS") == "1":
        RESULTS.write_text(written)
    assert RESULTS.read_text() == written, "PQSEC_WRITE_RESULTS=1 writes what was measured"
