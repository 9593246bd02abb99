"""pqsec's plugin in versions of Fast DDS that no distribution has, each with its own library.

What differs in them is how they describe participants and endpoints, and what they call. Each
test runs in the library of the version that it is named after, or not at all.
"""

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from pqsec_pki.trial import (
    Act,
    TopicRoute,
    TrialReport,
    TrialRun,
    TrialSetup,
    built,
    credentialed,
    plugin,
    run_peers,
    run_trial,
    unauthenticated,
    unique_text,
)
from pqsec_pki.vendors import FastDds
from pqsec_pki.vendors._symbols import read_symbols
from pqsec_pki.vendors.fastdds_adapter import FASTDDS_SOURCES, here, install, installed
from pqsec_pki.vendors.fastdds_library import AdapterError
from pqsec_pki.vendors.own_plugin import PRELOAD
from tests.interop.conftest import TOPIC
from tests.interop.plugin.fastdds_builds import VARIABLES, build_of, in_prefix, installation_of
from tests.interop.plugin.processes import PATIENCE
from tests.interop.plugin.test_plugin_try import REFUSAL, logs
from tests.interop.trials import OTHER, RECEIVER, SENDER, Case, Laboratory

pytestmark = [pytest.mark.interop, pytest.mark.slow]

IN_EACH = pytest.mark.parametrize("version", VARIABLES)
SINCE_3_2 = pytest.mark.parametrize("version", [each for each in VARIABLES if each >= "3.2"])


@pytest.fixture(scope="module")
def build(requires) -> Callable[[str], FastDds]:
    """build("3.2.5") is that version."""
    return cache(lambda version: build_of(version, requires))


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory, now) -> Laboratory:
    return Laboratory.create(tmp_path_factory.mktemp("trials"), now)


@pytest.fixture(scope="module")
def tried(build, laboratory) -> Callable[..., TrialReport]:
    """tried("3.2.5", case) is a trial of two participants in that version with our plugin."""

    def run(version: str, case: Case, **how: object) -> TrialReport:
        installation = installation_of(build(version))
        with plugin(fastdds=installation) as ours:
            trial = laboratory.trial(installation, case, plugin=ours, **how)
            route = TopicRoute(sender=SENDER, receiver=RECEIVER, domain=0, topic=case.topic)
            return run_trial(trial, route)

    return run


@IN_EACH
def test_it_is_installed_and_finds_the_topics_of_endpoints(build, tmp_path, version):
    stack = build(version)
    install(stack, tmp_path / "plugin", here())
    [found] = installed(tmp_path / "plugin")
    assert (found.release, found.problem) == (stack.version, "")


@SINCE_3_2
def test_an_adapter_that_looks_without_the_pointer_before_is_not_installed(
    build, tmp_path, monkeypatch, version
):
    """It compiles, has the functions of the library and shakes hands; the topic is garbage."""
    stack = build(version)
    assert stack.derived
    sources = Path(shutil.copytree(FASTDDS_SOURCES, tmp_path / "sources"))
    path = sources / "interface3.hpp"
    text = re.sub(r"virtual (~(?:Writer|Reader)ProxyData)", r"\1", path.read_text())
    assert text != path.read_text()
    path.write_text(text)
    monkeypatch.setattr("pqsec_pki.vendors.fastdds_adapter.FASTDDS_SOURCES", sources)
    with pytest.raises(AdapterError, match="does not find the topics of endpoints in") as refusal:
        install(stack, tmp_path / "plugin", here())
    assert "report this one" in refusal.value.hint
    assert not (tmp_path / "plugin").exists()


@IN_EACH
def test_each_function_that_the_preload_library_names_is_one_of_fast_dds(build, tmp_path, version):
    stack = build(version)
    install(stack, tmp_path / "plugin", here())
    space = {2: b"8fastrtps", 3: b"7fastdds"}[stack.generation]
    octets = (tmp_path / "plugin" / PRELOAD).read_bytes()
    named = {each.decode() for each in re.findall(rb"_ZN8eprosima%s\w+" % space, octets)}
    assert len(named) == 10
    assert named - read_symbols(stack.library.path).exported == set()


@IN_EACH
@pytest.mark.parametrize("profile", ["pq", "transition", "classical"])
def test_two_meet_and_a_stranger_gets_nothing(tried, requires, version, profile):
    """The governance has access control for each topic: the plugin was asked for the right one."""
    report = tried(version, Case(profile, profile=profile), timeout=PATIENCE)
    assert report.ok, logs(report)
    assert set(report.plugged) == {SENDER, RECEIVER}
    wire = requires(report.trial_run.wire, "a wire to watch", "run the tests as root")
    assert wire.packets > 100
    assert report.readable is False


@IN_EACH
def test_a_topic_without_permission_is_refused(tried, version):
    case = Case("", profile="pq", topic=OTHER)
    report = tried(version, case, timeout=REFUSAL, anyway=True)
    assert report.receiver.received is None, logs(report)
    assert [each for each in report.findings if "says whether it may" in each.said]


@pytest.fixture(scope="module")
def met(build, laboratory, stack_in, plugin_for) -> Callable[..., TrialRun]:
    """met("3.2.5", "trixie", sends=True) is what came of a meeting of that version and another."""

    def run(version: str, other: str, *, sends: bool) -> TrialRun:
        one, two = installation_of(build(version)), stack_in("fastdds", other)
        sending, receiving = (one, two) if sends else (two, one)
        with plugin(fastdds=one) as ours:
            first, second = (ours, plugin_for(other)) if sends else (plugin_for(other), ours)
            trial = laboratory.trial(
                sending,
                Case("", profile="pq"),
                receiving=receiving,
                plugin=first,
                timeout=PATIENCE,
            )
            folder = trial.keystore.root.parent
            roles = [
                credentialed(trial, SENDER, Act.SEND, folder, unique_text()),
                credentialed(replace(trial, plugin=second), RECEIVER, Act.RECEIVE, folder),
                unauthenticated(sending, Act.RECEIVE, folder),
            ]
            setup = TrialSetup(
                program=sending.peer(built(sending)), domain=0, topic=TOPIC, timeout=PATIENCE
            )
            return run_peers(setup, roles)

    return run


@pytest.mark.parametrize("sends", [True, False], ids=["sends", "receives"])
@pytest.mark.parametrize("other", ["bookworm", "trixie"])
@IN_EACH
def test_it_meets_the_fast_dds_of_a_distribution(met, version, other, sends):
    sender, receiver, stranger = met(version, other, sends=sends).outcomes
    assert receiver.received == sender.role.text, f"{sender.log}\n{receiver.log}"
    assert (stranger.joined, stranger.received) == (True, None)


def test_a_build_of_another_version_runs_no_test(fastdds_here):
    prefix = fastdds_here.root / fastdds_here.prefix
    with pytest.raises(AssertionError, match=r"is Fast DDS 2\.9\.1, not 2\.14\.6"):
        in_prefix(prefix, "2.14.6")
