"""The plugin in a Python host: Cyclone DDS's own package for Python, on the system's library."""

import os
import subprocess

import pytest

from tests.interop.conftest import NOT_STOCK, TOPIC
from tests.interop.plugin.hosts import cyclonedds, perform_each, python_peer
from tests.interop.plugin.processes import DOMAIN, PATIENCE, Stage, logs, met
from tests.interop.plugin.test_plugin_dds import ended, running

pytestmark = pytest.mark.interop

NO_HANG = 300.0
VISITS = 30
LONGEST = 0.3
"""Seconds: a handshake takes some 0.15, most of it waiting."""
PROFILES = [*NOT_STOCK, "transition"]


@pytest.fixture
def stage(requires, shim, plugins, tmp_path) -> Stage:
    found = requires(cyclonedds(), "Cyclone DDS to compile against", "cyclonedds-dev and -tools")
    return Stage(found, shim, plugins, tmp_path)


@pytest.fixture
def programs(requires, stage) -> dict[str, list[str]]:
    """What runs a peer in either language."""
    what = "Cyclone DDS's package for Python"
    python = requires(python_peer(), what, "run .ci/cyclonedds-python")
    return {"C": stage.program, "Python": python}


@pytest.fixture
def python(stage, programs, labs):
    """python(act, text, seconds) is what became of alice, a process in Python."""

    def run(act, text, seconds):
        words = [*programs["Python"], act, str(DOMAIN), TOPIC, text, str(seconds)]
        return subprocess.run(
            words,
            env=os.environ | stage.environment(labs("pq").alice),
            capture_output=True,
            text=True,
            timeout=NO_HANG,
            check=False,
        )

    return run


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("pair", ["Python to C", "C to Python", "Python to Python"])
@pytest.mark.parametrize("profile", PROFILES)
def test_data_flows_to_and_from_a_python_host(stage, programs, labs, profile, pair):
    sender, receiver = (programs[language] for language in pair.split(" to "))
    lab = labs(profile)
    went = perform_each((stage.sender(lab.alice), sender), (stage.receiver(lab.bob), receiver))
    assert met(went), logs(went)
    assert went.seconds < PATIENCE  # the receiver ended by itself


@pytest.mark.slow
def test_participants_deleted_in_the_middle_of_a_handshake_do_not_hang(stage, python, labs):
    with running(stage, stage.receiver(labs("pq").bob), seconds=NO_HANG):
        done = python("visit", str(VISITS), LONGEST)
    said = done.stdout.splitlines()
    assert (done.returncode, said[-1:]) == (0, ["home"]), done.stderr
    assert 0 < said.count("matched") < VISITS == said.count("joined")


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("after", [0.0, 0.05, 0.1, 0.15, 1.0])
def test_a_host_that_ends_by_an_exception_ends(stage, python, labs, after):
    """Before, in and after a handshake; what it holds dies with the interpreter."""
    with running(stage, stage.receiver(labs("pq").bob), seconds=NO_HANG) as receiver:
        done = python("fall", "falling", after)
        if after == 1:
            assert "received falling" in ended(receiver)
    assert (done.returncode, done.stdout) == (1, "joined\n"), done.stderr
    assert "RuntimeError: ('over'" in done.stderr
