"""The adapter for Fast DDS under sanitizers and valgrind: all of its functions, with an agent and
without one."""

import os
import random
import re
import shutil
import socketserver
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread

import pytest

from pqsec_pki.errors import PqsecError
from pqsec_pki.lifecycle import renew_list
from pqsec_pki.plugin import AgentFolder
from pqsec_pki.plugin.building import SOURCES
from pqsec_pki.plugin.connection import AgentContext, Connection
from pqsec_pki.vendors.fastdds_adapter import ADAPTER, FASTDDS_SOURCES
from tests.fuzz.mutation import blindly
from tests.interop.conftest import LAB_PROFILES, TOPIC, Lab
from tests.longer import LONG
from tests.unit.plugin_wire import framed

pytestmark = pytest.mark.interop

PROGRAM = Path(__file__).with_name("fastdds_every_function.cpp")
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
WARNINGS = ("-Wall", "-Wextra", "-Werror")
OF_2 = ("-std=c++17", "-O0", "-DPQSEC_FASTDDS=2", "-I", SOURCES, "-I", FASTDDS_SOURCES)
ROUNDS = 400 if LONG else 20
"""With an agent that has gone mad."""

OVERRIDE = re.compile(r"(?m)^  [\w:<>*]+ (\w+)\([^;]*?\) (?:const )?override")


def compiled(*command: str | Path, where: Path) -> None:
    done = subprocess.run(command, cwd=where, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def sanitized(fastdds_here, compiler, tmp_path_factory) -> list[str]:
    """The program with all of the adapter in it."""
    folder = tmp_path_factory.mktemp("sanitized")
    python = f'-DPQSEC_PYTHON="{sys.executable}"'
    shim = [SOURCES / f"{name}.c" for name in ("wire", "frames", "link", "agent", "watch")]
    compiled(compiler, "-std=c11", "-g", *SANITIZERS, python, "-c", *shim, where=folder)
    objects = sorted(folder.glob("*.o"))
    sources = [PROGRAM, FASTDDS_SOURCES / "adapter.cpp"]
    words = [*OF_2, *SANITIZERS, *WARNINGS, '-DPQSEC_BUILD_ID="00"', "-o", "program"]
    compiled("g++", *words, *sources, *objects, "-lfastrtps", "-lfastcdr", where=folder)
    return [str(folder / "program")]


@pytest.fixture(scope="module")
def installed(requires, fastdds_here, plugin_for, tmp_path_factory) -> list[str]:
    """The program under valgrind, with the adapter as it is installed."""
    valgrind = requires(shutil.which("valgrind"), "valgrind", "apt-get install valgrind")
    folder = tmp_path_factory.mktemp("installed")
    adapter = plugin_for("bookworm").folder
    library = adapter / ADAPTER.format(fastdds_here.library.build_id)
    words = [*OF_2, "-o", "program", PROGRAM, library, f"-Wl,-rpath,{adapter}"]
    compiled("g++", *words, "-lfastrtps", "-lfastcdr", where=folder)
    kinds = "--errors-for-leak-kinds=definite,indirect,possible"
    options = ("-q", "--error-exitcode=99", "--leak-check=full", kinds)
    return [valgrind, *options, str(folder / "program")]


@pytest.fixture(scope="module")
def lab(tmp_path_factory, now) -> Lab:
    """With a revocation list, so the adapter has a thread."""
    made = Lab.create(tmp_path_factory.mktemp("listed") / "lab", LAB_PROFILES["pq"], now)
    renew_list(made.keystore, made.authorities, now=now)
    return made


@pytest.fixture
def every_function(shim, lab, tmp_path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """every_function(program, "agent") runs it; with "none", no agent can be trusted."""
    (tmp_path / "pqsec").mkdir()
    (tmp_path / "pqsec").chmod(0o755)

    def run(program: list[str], agent: str) -> subprocess.CompletedProcess[str]:
        runtime = {"XDG_RUNTIME_DIR": str(tmp_path)} if agent == "none" else {}
        return subprocess.run(
            [*program, lab.alice, lab.bob, TOPIC, agent],
            env=os.environ | runtime,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )

    return run


@pytest.mark.slow
@pytest.mark.parametrize("agent", ["agent", "none"])
@pytest.mark.parametrize("how", ["sanitized", "installed"])
def test_each_function_does_no_harm(request, every_function, how, agent):
    done = every_function(request.getfixturevalue(how), agent)
    said = [line for line in done.stderr.splitlines() if "not a folder of this user's" not in line]
    assert (done.returncode, said) == (0, [])
    assert int(done.stdout) > 60


class Mad(socketserver.ThreadingUnixStreamServer):
    """An agent that answers as ours, but spoils one answer in four."""

    daemon_threads = True

    def __init__(self, place: AgentFolder, now: datetime) -> None:
        self.rng = random.Random(1)  # noqa: S311 -- the same spoilt answers each time
        self.spoil = blindly(self.rng)
        self.context = AgentContext(lambda: now, lambda line: None, dict, lambda: None)
        place.prepare()
        super().__init__(str(place.socket), Answer)

    def answer(self, frame: bytes) -> bytes:
        if self.rng.randrange(4):
            return frame
        spoilt = framed(self.spoil(frame[4:]))
        return spoilt if self.rng.randrange(8) else self.spoil(frame)


class Answer(socketserver.BaseRequestHandler):
    def handle(self) -> None:
        connection = Connection(self.server.context, "test")
        with suppress(OSError, PqsecError):
            while octets := self.request.recv(1 << 16):
                for frame in connection.receive(octets):
                    self.request.sendall(self.server.answer(frame))


@pytest.mark.slow
def test_the_answers_of_a_mad_agent_do_no_harm(sanitized, lab, now):
    with TemporaryDirectory(prefix="pqsec-run-") as runtime:
        place = AgentFolder.of({"XDG_RUNTIME_DIR": runtime})
        with Mad(place, now) as server:
            thread = Thread(target=server.serve_forever)
            thread.start()
            done = subprocess.run(
                [*sanitized, lab.alice, lab.bob, TOPIC, f"mad{ROUNDS}"],
                env=os.environ | {"XDG_RUNTIME_DIR": runtime, "PQSEC_AGENT_TIMEOUT": "200"},
                capture_output=True,
                text=True,
                timeout=500,
                check=False,
            )
            server.shutdown()
            thread.join()
    assert done.returncode == 0, done.stderr[-5000:]
    assert "Sanitizer" not in done.stderr
    assert int(done.stdout) > 50 * ROUNDS


def test_no_function_is_forgotten():
    text = PROGRAM.read_text()
    functions = set()
    for name in ("authentication", "access_control"):
        whole = (FASTDDS_SOURCES / f"{name}.cpp").read_text()
        source = re.sub("(?s)#if PQSEC_MORE_FUNCTIONS.*?#endif", "", whole)  # not in 2.9
        functions |= set(
            re.findall(r"(?m)^  [\w:<>\*]+ (\w+)\([^;]*?\) (?:const )?override", source)
        )
    assert len(functions) == 16 + 17
    assert [name for name in functions if not re.search(rf"\b{name}\b", text)] == []
