"""Fast DDS with the plugin under hard conditions: small datagrams, loss, many participants in one
process, and an agent that has gone mad."""

import os
import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from pqsec_pki.trial import (
    Act,
    Installation,
    TrialRole,
    TrialRun,
    TrialSetup,
    built,
    credentialed,
    run_peers,
    unique_text,
)
from pqsec_pki.trial.building import source
from pqsec_pki.trial.network import alone
from tests.interop.conftest import TOPIC
from tests.interop.plugin.processes import PATIENCE
from tests.interop.roots import ROOTS, compiled
from tests.interop.trials import RECEIVER, SENDER, Case, Laboratory
from tests.longer import LONG

pytestmark = pytest.mark.interop

HERE = Path(__file__).parent
SMALL = "<maxMessageSize>1400</maxMessageSize>"
CYCLES, MANY = (100, 6) if LONG else (10, 3)
LONGEST = 5 * PATIENCE
"""Seconds; with loss, one pair took 4 and another 48."""
PLACES = list(ROOTS) if LONG else ["bookworm"]


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory, now) -> Laboratory:
    return Laboratory.create(tmp_path_factory.mktemp("hard"), now)


@pytest.fixture(scope="module")
def lossy(compiler, tmp_path_factory) -> Path:
    """A library that loses what is sent."""
    library = tmp_path_factory.mktemp("lossy") / "lossy.so"
    words = [compiler, "-shared", "-fPIC", "-o", library, HERE / "lossy.c", "-ldl"]
    subprocess.run(words, check=True)
    return library


@pytest.fixture
def meeting(stack_in, plugin_for, laboratory) -> Callable[..., TrialRun]:
    """meeting(where, profile, preload) is what came of two with datagrams of 1400 bytes."""

    def run(where: str, profile: str, preload: str = "") -> TrialRun:
        installation = stack_in("fastdds", where)
        trial = laboratory.trial(
            installation, Case("", profile=profile), plugin=plugin_for(where), timeout=LONGEST
        )
        folder = trial.keystore.root.parent
        roles = [
            credentialed(trial, SENDER, Act.SEND, folder, unique_text()),
            credentialed(trial, RECEIVER, Act.RECEIVE, folder),
        ]
        setup = TrialSetup(
            program=installation.peer(built(installation)), domain=0, topic=TOPIC, timeout=LONGEST
        )
        return run_peers(setup, [_small(each, installation, preload) for each in roles])

    return run


def _small(role: TrialRole, installation: Installation, preload: str) -> TrialRole:
    path = Path(role.environment[installation.build.variable])
    text = path.read_text()
    path.write_text(text.replace("</type>", f"</type>{SMALL}"))
    assert SMALL in path.read_text()
    first = role.environment["LD_PRELOAD"]
    return replace(role, environment={**role.environment, "LD_PRELOAD": f"{first}{preload}"})


@pytest.mark.slow
@pytest.mark.parametrize("profile", ["cnsa2", "pq"])
@pytest.mark.parametrize("where", ROOTS)
def test_two_meet_in_datagrams_of_1400_bytes(meeting, where, profile):
    went = meeting(where, profile)
    assert went.outcomes[1].received == went.outcomes[0].role.text, went.outcomes[1].log


@pytest.mark.slow
@pytest.mark.parametrize("where", ROOTS)
def test_two_meet_where_one_datagram_in_ten_is_lost(meeting, lossy, where):
    went = meeting(where, "pq", f":{lossy}")
    log = "\n".join(each.log for each in went.outcomes)
    assert not any(each.signal or each.refused for each in went.outcomes), log
    assert went.outcomes[1].received == went.outcomes[0].role.text, log


@pytest.fixture(scope="module")
def many(stack_in) -> Iterator[Callable[[str], list[str]]]:
    """many("trixie") is the command of fastdds_many.cpp there."""
    text = source("fastdds.cpp").replace(b"int main(", b"int peer_main(")
    sources = {"fastdds.cpp": text + (HERE / "fastdds_many.cpp").read_bytes()}
    with ExitStack() as stack:
        yield cache(
            lambda where: stack.enter_context(compiled(stack_in("fastdds", where), sources))
        )


@pytest.fixture
def run_alone(
    stack_in, plugin_for, laboratory, many
) -> Callable[..., subprocess.CompletedProcess[str]]:
    """run_alone(where, "meet", 3) runs it in a network of its own."""

    def run(where: str, act: str, count: int) -> subprocess.CompletedProcess[str]:
        case, ours = Case("", profile="pq"), plugin_for(where)
        trial = laboratory.trial(stack_in("fastdds", where), case, plugin=ours, timeout=PATIENCE)
        role = credentialed(trial, SENDER, Act.SEND, trial.keystore.root.parent, "")
        words = [*many(where), act, str(count), TOPIC, str(int(PATIENCE))]
        environment = os.environ | dict(role.environment)
        return alone(
            lambda _: subprocess.run(
                words, env=environment, capture_output=True, text=True, timeout=600, check=False
            )
        )

    return run


@pytest.mark.slow
@pytest.mark.parametrize("where", PLACES)
@pytest.mark.parametrize(
    ("act", "count", "said"),
    [("meet", MANY, "all matched"), ("cycle", CYCLES, "cycled, more than before: 0")],
)
def test_several_participants_of_one_process(run_alone, where, act, count, said):
    """They meet each other; and nothing is left of those that are deleted."""
    done = run_alone(where, act, count)
    words = f"{done.stdout[-3000:]}{done.stderr[-3000:]}"
    assert (done.returncode, said in done.stdout.splitlines()) == (0, True), words
