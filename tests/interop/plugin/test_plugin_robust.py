"""The library under sanitizers and valgrind, against a mad agent, and over many lives."""

import ctypes
import os
import re
import shutil
import subprocess
import sys
import time
from contextlib import ExitStack
from ctypes import CFUNCTYPE, POINTER, Structure
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.plugin.building import SOURCES, command
from pqsec_pki.trial import MissingStackError, find
from tests.interop.conftest import DOMAINS, LAB_PROFILES, TOPIC, Lab
from tests.interop.cyclone import Participant
from tests.interop.cyclone_abi import ACCESS_CONTROL, AUTHENTICATION, started
from tests.interop.cyclone_types import Byte, Failure, Handle
from tests.interop.plugin.processes import DOMAIN, Stage
from tests.interop.plugin.test_plugin_dds import ended, running

pytestmark = pytest.mark.interop

HERE = Path(__file__).parent
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
ANSWERS = 100_000
BRIEF = timedelta(seconds=15)
"""Enough to start an agent and a participant on a busy machine."""
CYCLES = 150
GROWTH = 600
"""Kilobytes, over a hundred cycles: an allocator's ups and downs. Cyclone's own plugins take 200
too, and no more after 400; a token that is lost each time would be a thousand."""
_pointer = ctypes.c_void_p


def compiled(goal, *words):
    line = ["cc", "-std=gnu11", "-g", "-O1", "-pthread", "-o", goal, *words]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return goal


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("standard", ["c11", "gnu17", "c2x"])
def test_the_library_compiles_without_a_warning(requires, tmp_path, standard):
    cc = requires(shutil.which("cc"), "a C compiler", "apt-get install gcc libc6-dev")
    strict = f"-std={standard}", "-Wall", "-Wextra", "-Wconversion", "-Werror"
    done = subprocess.run(
        command(cc, tmp_path / "library", *strict, "-Wno-cast-function-type"),
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.slow
def test_a_mad_agents_answers_are_refused_and_do_no_harm(shim, tmp_path):
    sources = "-I", SOURCES, HERE / "fuzz_answers.c", SOURCES / "wire.c", SOURCES / "frames.c"
    program = compiled(tmp_path / "fuzz", *SANITIZERS, *sources)
    done = subprocess.run(
        [program, str(ANSWERS), "1"], capture_output=True, text=True, check=False, timeout=200
    )
    assert done.returncode == 0, done.stderr
    taken, refused = (int(word) for word in done.stdout.split() if word.isdigit())
    assert min(taken, refused) > ANSWERS / 10


@pytest.mark.slow(but=1)
@pytest.mark.parametrize(
    ("program", "said"), [("own_listener", "1\n"), ("set_clock", "both\n")], ids=str
)
def test_the_thread_goes_on_whatever_its_host_does(requires, tmp_path, program, said):
    """A listener takes itself away; the clock is set back by a day, and forward by one."""
    requires(shutil.which("cc"), "a C compiler", "apt-get install gcc libc6-dev")
    sources = ["-I", SOURCES, HERE / f"{program}.c"]
    if program == "own_listener":  # the other has it inside, with a clock of its own
        sources.append(SOURCES / "watch.c")
    done = subprocess.run(
        [compiled(tmp_path / program, *SANITIZERS, *sources)],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, said, "")


@pytest.fixture
def everything(shim, labs, tmp_path):
    """everything(flag...) compiles a program that calls each function, and says how to run it."""
    lab = labs("pq")

    def program(*flags):
        python = f'-DPQSEC_PYTHON="{sys.executable}"'
        sources = sorted(SOURCES.glob("*.c"))
        words = "-I", SOURCES, python, HERE / "every_function.c", *sources
        return [compiled(tmp_path / "every_function", *flags, *words), lab.alice, lab.bob, TOPIC]

    return program


def _functions():
    """All that the library has for Cyclone DDS."""
    text = (SOURCES / "abi.h").read_text()
    tables = re.findall(r"struct (?:authentication|access_control) \{\n(.*?)\n\};", text, re.DOTALL)
    return {name for table in tables for name in re.findall(r"\b[a-z]+_[a-z_]+\b", table)}


@pytest.mark.slow
def test_each_function_does_no_harm_with_and_without_an_agent(everything):
    program = (HERE / "every_function.c").read_text()
    assert len(_functions()) == 17 + 30 - 1  # both have set_listener
    assert [name for name in _functions() if not re.search(rf"\b{name}\b", program)] == []
    done = subprocess.run(
        everything(*SANITIZERS), capture_output=True, text=True, check=False, timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert int(done.stdout) > 2 * len(_functions())


def test_valgrind_finds_nothing_in_any_function(requires, everything):
    valgrind = requires(shutil.which("valgrind"), "valgrind", "apt-get install valgrind")
    options = "--error-exitcode=99", "--leak-check=full", "--errors-for-leak-kinds=all"
    done = subprocess.run(
        [valgrind, "-q", *options, *everything()],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.fixture
def stage(requires, shim, plugins, tmp_path):
    try:
        return Stage(find("cyclonedds"), shim, plugins, tmp_path)
    except MissingStackError as error:
        return requires(None, "Cyclone DDS to compile against", error.hint or str(error))


@pytest.fixture
def cycles(stage, labs, tmp_path_factory):
    """cycles(how many, ms, what runs it) lets alice come and go, while bob is there."""
    lab = labs("pq")
    folder = tmp_path_factory.mktemp("cycles")
    program = compiled(folder / "cycles", HERE / "cycles.c", "-lddsc")

    def run(count, milliseconds, *runner):
        with running(stage, stage.receiver(lab.bob), seconds=100):
            done = subprocess.run(
                [*runner, program, str(DOMAIN), str(count), str(milliseconds)],
                env=os.environ | stage.environment(lab.alice),
                capture_output=True,
                text=True,
                timeout=100,
                check=False,
            )
        assert done.returncode == 0, done.stderr
        return [int(line) for line in done.stdout.splitlines() if line.isdigit()]

    return run


@pytest.mark.slow
def test_a_hundred_lives_more_take_no_more_memory(cycles):
    early, late = cycles(CYCLES, 20)
    assert late - early < GROWTH


@pytest.mark.slow
def test_valgrind_finds_nothing(requires, cycles):
    """Two participants that meet a peer, and end: no bad access, no leak."""
    valgrind = requires(shutil.which("valgrind"), "valgrind", "apt-get install valgrind")
    options = "--error-exitcode=99", "--leak-check=full", "--errors-for-leak-kinds=definite"
    assert len(cycles(2, 1500, valgrind, "-q", *options)) == 2


class Listener(Structure):
    _fields_ = (("on_revoke", CFUNCTYPE(Byte, _pointer, Handle)), ("on_status", _pointer))


_SET = CFUNCTYPE(Byte, _pointer, POINTER(Listener), POINTER(Failure))


class Authentication(AUTHENTICATION):
    _fields_ = (("set_listener", _SET),)


class AccessControl(ACCESS_CONTROL):
    _fields_ = (("set_listener", _SET),)


@pytest.fixture
def brief(tmp_path):
    """A lab, and the enclave of one who is good for a short time from now."""
    start = datetime.now(UTC)
    lab = Lab.create(tmp_path / "lab", LAB_PROFILES["pq"], start)
    spec = {"domains": DOMAINS, "publish": (TOPIC,), "validity": BRIEF}
    issue(lab.keystore, lab.authorities, [ParticipantSpec(name="/lab/brief", **spec)], now=start)
    return lab, lab.alice.with_name("brief")


@pytest.mark.slow
def test_a_participant_that_expires_is_removed_and_its_process_lives_on(stage, brief):
    lab, folder = brief
    stage.folder.joinpath("xml").mkdir()
    stage = replace(stage, folder=stage.folder / "xml")
    with running(stage, stage.sender(folder), seconds=20) as sender:
        with running(stage, stage.receiver(lab.bob), seconds=4) as early:
            assert "received" in ended(early)
        while datetime.now(UTC) < lab.now + BRIEF + timedelta(seconds=1.5):
            time.sleep(0.05)
        with running(stage, stage.receiver(lab.bob), seconds=2) as late:
            assert "received" not in ended(late)
        ended(sender)


@pytest.mark.slow
def test_the_stack_is_told_when_identities_and_permissions_end(shim, brief):
    """Without the agent, if it must be: the library keeps the time."""
    lab, folder = brief
    told = {}
    listen = Listener(
        CFUNCTYPE(Byte, _pointer, Handle)(
            lambda plugin, handle: bool(told.setdefault(handle, datetime.now(UTC)))
        )
    )
    with ExitStack() as stack:
        names = (
            ("auth", "authentication", Authentication),
            ("ac", "access_control", AccessControl),
        )
        both = [
            stack.enter_context(started(shim.folder / f"libdds_security_{file}.so", name, table))
            for file, name, table in names
        ]
        for each in both:
            each.call("set_listener", listen)
        participant = Participant(*both, folder, "")
        participant.join(0)
        shim.kill_agent()
        end = time.monotonic() + 120
        while len(told) < 2 and time.monotonic() < end:
            time.sleep(0.05)
        assert len(told) == 2
        assert participant._identity in told
        assert min(told.values()) >= lab.now + BRIEF - timedelta(seconds=1)
        for each in both:
            each.call("set_listener", None)
