"""`pqsec try cyclonedds --plugin`: real participants with our plugin, as export configures them."""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest

from pqsec_pki.keystore import Keystore
from pqsec_pki.plugin import LIBRARY, AgentFolder, agent_status
from pqsec_pki.stacks import stack_named
from pqsec_pki.trial import (
    Act,
    AgentError,
    TopicRoute,
    Trial,
    TrialPlugin,
    TrialReport,
    TrialSetup,
    built,
    credentialed,
    plugin,
    run_peers,
    run_trial,
    unique_text,
)
from pqsec_pki.vendors import Options, export
from tests.interop.conftest import LAB_PROFILES, TOPIC, Lab
from tests.interop.plugin.processes import PATIENCE
from tests.interop.roots import ROOTS, TRIXIE
from tests.interop.trials import (
    OTHER,
    RECEIVER,
    SENDER,
    Case,
    Laboratory,
    alter_the_permissions,
    encrypt_the_keys,
    let_the_sender_expire,
    revoke_the_sender,
)

pytestmark = pytest.mark.interop

AT_ONCE = 3 if os.geteuid() == 0 else 1
"""Most of what they do is waiting. Who is not root has but one network for all."""
REFUSAL = 5.0


def meet_stock_peers(lab, root, now):
    """Both say that their peers may have Cyclone DDS's own plugin."""
    for name in (SENDER, RECEIVER):
        (root / f"enclaves{name}" / "pqsec.toml").write_text('peers = "stock"\n')


def come_from_another_ca(lab, root, now, who=SENDER):
    """One is of a keystore with the same names."""
    other = Lab.create(root.with_name("other"), LAB_PROFILES[lab.keystore.profile.name], lab.now)
    shutil.rmtree(root / f"enclaves{who}")
    shutil.copytree(other.keystore.root / f"enclaves{who}", root / f"enclaves{who}")


MET = {
    **{f"{profile} {where}": (where, Case(profile, profile=profile), ())
       for profile in LAB_PROFILES for where in ROOTS},
    "encrypted keys": (
        "bookworm", Case("", profile="pq", alter=encrypt_the_keys, password="Correct-Horse_1"), ()
    ),
    **{f"stock {who}": ("bookworm", Case("", profile="transition", alter=meet_stock_peers), (who,))
       for who in (SENDER, RECEIVER)},
}  # fmt: skip
"""Where, in what circumstances, and who runs Cyclone DDS's own plugin."""
REFUSED = {
    "denied topic": (Case("", profile="pq", topic=OTHER), (), "Not Allowed By Security"),
    "revoked": (Case("", profile="pq", alter=revoke_the_sender), (), "was revoked on"),
    "rogue CA": (Case("", profile="pq", alter=come_from_another_ca), (), "not signed by this CA"),
    "expired": (Case("", profile="pq", alter=let_the_sender_expire), (), "expired on"),
    "altered": (Case("", profile="pq", alter=alter_the_permissions), (), "changed after signing"),
    **{f"unasked, stock {who}": (Case("", profile="transition"), (who,), said)
       for who, said in ((SENDER, "the peer asks for 'ECDH"), (RECEIVER, "not say that it knows"))},
}  # fmt: skip
"""Circumstances, who runs Cyclone DDS's own plugin, and what is said."""


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory, now) -> Laboratory:
    return Laboratory.create(tmp_path_factory.mktemp("trials"), now)


@pytest.fixture(scope="module")
def ours(compiler) -> Iterator[TrialPlugin]:
    """The plugin, with an agent that all these trials share."""
    with plugin() as found:
        yield found


@pytest.fixture(scope="module")
def reports(stack_in, laboratory, ours, selected) -> Iterator[Callable[[str], TrialReport]]:
    """reports(name) is what came of it; several run at once."""
    met = {name: MET[name] for name in MET if name in selected("name")}
    refused = {name: REFUSED[name] for name in REFUSED if name in selected("name")}

    def run(where: str, case: Case, stock: tuple[str, ...], **how) -> TrialReport:
        installation = stack_in("cyclonedds", where)
        trial = laboratory.trial(installation, case, plugin=ours, stock=stock, **how)
        return run_trial(
            trial, TopicRoute(sender=SENDER, receiver=RECEIVER, domain=0, topic=case.topic)
        )

    for where in {"bookworm"} | {each[0] for each in met.values()}:
        built(stack_in("cyclonedds", where))
    with ThreadPoolExecutor(AT_ONCE) as pool:
        found: dict[str, Future[TrialReport]] = {}
        for name, (where, case, stock) in met.items():
            found[name] = pool.submit(run, where, case, stock, timeout=PATIENCE)
        for name, (case, stock, _) in refused.items():
            # `anyway`, for what an export would refuse too.
            found[name] = pool.submit(run, "bookworm", case, stock, timeout=REFUSAL, anyway=True)
        yield lambda name: found[name].result()


def logs(report: TrialReport) -> str:
    return "\n".join(f"-- {each.role.name}\n{each.log}" for each in report.trial_run.outcomes)


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("name", MET)
def test_two_meet_and_a_stranger_gets_nothing(reports, requires, name):
    report = reports(name)
    assert report.ok, logs(report)
    assert set(report.plugged) == {SENDER, RECEIVER} - set(MET[name][2])
    wire = requires(report.trial_run.wire, "a wire to watch", "run the tests as root")
    assert wire.packets > 100
    assert report.readable is False


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("name", REFUSED)
def test_nothing_passes_and_it_is_said_why(reports, name):
    report, said = reports(name), REFUSED[name][2]
    assert report.receiver.received is None, logs(report)
    assert report.unauthenticated.received is None
    assert not any(each.signal for each in report.trial_run.outcomes)
    told = [each for each in report.findings if said in each.said]
    assert told, logs(report)
    assert all(each.cause and each.remedy for each in told)
    assert not any("--as cyclonedds" in each.remedy for each in told if each.remedy)


def test_the_script_for_ros_2_puts_the_plugin_in_the_place_of_cyclones_own(
    stack_in, laboratory, ours, requires
):
    """Its variables, read in twice by a shell; the libraries are named as rmw_cyclonedds does."""
    cyclone = stack_in("cyclonedds", "bookworm")
    trial = laboratory.trial(cyclone, Case("", profile="pq"), timeout=PATIENCE, plugin=ours)
    roles = []
    for name, act, text in ((SENDER, Act.SEND, unique_text()), (RECEIVER, Act.RECEIVE, "")):
        role = credentialed(trial, name, act, laboratory.folder / act.value, text)
        configuration = Path(role.environment["CYCLONEDDS_URI"].removeprefix("file://"))
        _name_the_libraries(configuration)
        options = Options(plugin=ours.folder, anyway=True)  # they may do less than a node needs
        made = export(stack_named("ros2"), trial.keystore, name, options, now=trial.now)
        script = str(made.files[made.main])
        roles.append(replace(role, environment=role.environment | _sourced(script, role)))
    program = cyclone.peer(built(cyclone))
    went = run_peers(TrialSetup(program=program, domain=0, topic=TOPIC, timeout=PATIENCE), roles)
    assert went.outcomes[1].received == roles[0].text, went.outcomes[1].log
    assert not requires(went.wire, "a wire to watch", "run the tests as root").readable


def _name_the_libraries(configuration: Path) -> None:
    text = configuration.read_text()
    for plugin_name in ("auth", "ac"):
        text = text.replace(f'path="{_library(text)}"', f'path="dds_security_{plugin_name}"', 1)
    configuration.write_text(text)


def _library(text: str) -> str:
    return text.partition(LIBRARY)[0].rpartition('"')[2] + LIBRARY


def _sourced(script: str, role) -> dict[str, str]:
    done = subprocess.run(
        ["sh", "-euc", f"{script}\n{script}\nenv -0"],
        env={"PATH": os.environ["PATH"], "CYCLONEDDS_URI": role.environment["CYCLONEDDS_URI"]},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    found = dict(line.split("=", 1) for line in done.stdout.split("\0") if line)
    return {name: found[name] for name in ("LD_LIBRARY_PATH", "CYCLONEDDS_URI")}


@pytest.fixture
def shared(stack_in) -> Iterator[Path]:
    """A folder that has the same path outside of trixie's root file system and inside of it."""
    stack_in("cyclonedds", "trixie")
    inside = Path(tempfile.mkdtemp(prefix="pqsec-shared-", dir=TRIXIE / "tmp"))
    outside = Path("/tmp", inside.name)
    outside.symlink_to(inside)
    yield outside
    outside.unlink()
    shutil.rmtree(inside)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may change its root folder")
def test_a_process_in_another_root_asks_the_agent_outside(stack_in, labs, ours, shared, now):
    """All that it has of pqsec is the library; files and the socket are shared."""
    newer = stack_in("cyclonedds", "trixie")
    own = shared / "cyclone" / newer.plugins.name
    shutil.copytree(newer.plugins, own)  # the same path leads to them outside and inside
    shutil.copy(newer.library.path, own.parent)
    (own.parent / newer.soname).symlink_to(newer.library.path.name)
    shutil.copytree(labs("pq").keystore.root, shared / "keystore", symlinks=True)
    shutil.copytree(ours.folder, shared / "plugin", symlinks=True)
    shutil.copy(built(newer), shared / "peer")
    trial = Trial(
        installation=replace(newer, build=replace(newer.build, plugins=lambda *_: own)),
        keystore=Keystore.open(shared / "keystore"),
        timeout=PATIENCE,
        now=now,
    )
    with plugin(shared) as outside:
        trial = replace(trial, plugin=replace(outside, folder=shared / "plugin"))
        roles = [
            credentialed(trial, SENDER, Act.SEND, shared, unique_text()),
            credentialed(trial, RECEIVER, Act.RECEIVE, shared),
        ]
        program = ["chroot", str(TRIXIE), str(shared / "peer")]
        went = run_peers(
            TrialSetup(program=program, domain=0, topic=TOPIC, timeout=PATIENCE), roles
        )
    assert went.outcomes[1].received == roles[0].text, went.outcomes


@pytest.mark.slow
def test_the_users_own_agent_is_left_alone(laboratory, stack_in, compiler, tmp_path, monkeypatch):
    cyclone = stack_in("cyclonedds", "bookworm")
    runtime = tmp_path / "run"
    runtime.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime))
    monkeypatch.setenv("PQSEC_AGENT", "private")
    with plugin() as found:
        place = AgentFolder.of(found.environment)
        trial = laboratory.trial(cyclone, Case("", profile="pq"), timeout=PATIENCE, plugin=found)
        way = TopicRoute(sender=SENDER, receiver=RECEIVER, domain=0, topic=TOPIC)
        assert run_trial(trial, way).ok
        assert agent_status(place)
        assert place.log.read_text().count("listening at ") == 1  # and no private one
    assert not place.folder.exists()
    assert list(runtime.iterdir()) == []


def test_an_agent_that_does_not_start_is_said_with_its_last_words(compiler, tmp_path):
    deep = tmp_path / ("x" * 90)
    deep.mkdir()
    with pytest.raises(AgentError, match="path too long"), plugin(deep):
        pass
    assert list(deep.iterdir()) == []


def test_the_plugin_is_compiled_once(compiler, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with plugin() as first:
        library = first.folder / LIBRARY
        made = library.stat()
    with plugin() as again:
        assert again.folder == first.folder
        assert library.stat() == made
    # Trials of `reports` may still run in threads, and compile their peers into this folder too.
    assert list(first.folder.parent.glob("plugin-*")) == [first.folder]


def _agents(parent: int) -> list[int]:
    """The agents that this process has started itself."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            above = int((path / "stat").read_text().rpartition(")")[2].split()[1])
            if above == parent and b"pqsec_pki.plugin" in (path / "cmdline").read_bytes():
                found.append(int(path.name))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_a_trial_that_is_stopped_leaves_no_agent(laboratory, stack_in, how):
    case = Case("", profile="pq", alter=come_from_another_ca)
    trial = laboratory.trial(stack_in("cyclonedds", "bookworm"), case, timeout=PATIENCE)
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "pqsec_pki", "-k", str(trial.keystore.root)),
            *("try", "cyclonedds", "--plugin", "--anyway", "--timeout", "60", SENDER, RECEIVER),
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    until = time.monotonic() + PATIENCE
    while not (agents := _agents(process.pid)) and time.monotonic() < until:
        time.sleep(0.05)
    time.sleep(0.5)
    process.send_signal(how)
    process.communicate(timeout=300)
    assert len(agents) == 1
    assert not Path(f"/proc/{agents[0]}").exists()
