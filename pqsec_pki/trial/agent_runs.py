"""Compiles pqsec's own plugin when it is first needed, and runs it with an agent for a trial.

For Cyclone DDS it is one library; for Fast DDS it is compiled for each build of the stack, by the
compilers of the root file system that the stack is in.
"""

import hashlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors
from pqsec_pki.errors import FileError, PqsecError
from pqsec_pki.plugin import LIBRARY, AgentFolder, agent_status, build
from pqsec_pki.plugin.building import SOURCES, CompileError, command
from pqsec_pki.trial.building import cache, compiling_once, run_tool
from pqsec_pki.trial.host_process import processor_seconds
from pqsec_pki.trial.installation import MACHINE, Installation
from pqsec_pki.vendors import FastDds, examine
from pqsec_pki.vendors.fastdds_adapter import Compilers, commands, here, install, sources

_RUNTIME = Path("/tmp")  # noqa: S108 -- a socket's path must be short; the folder in it is 0700
_IDLE = "20"
"""Seconds after which the agent ends by itself, if the trial was killed."""
_START = 10.0
_PAUSE = 0.02


class AgentError(PqsecError):
    """The agent of a trial does not start."""


@dataclass(frozen=True, slots=True)
class TrialPlugin:
    """The plugin's folder, and the variables with which it finds its agent."""

    folder: Path
    environment: Mapping[str, str]


@contextmanager
def plugin(
    runtime: Path = _RUNTIME, *, fastdds: Installation | None = None
) -> Iterator[TrialPlugin]:
    """The plugin with its own agent, below `runtime`; the agent is stopped when the block ends.

    It is for Cyclone DDS, and with `fastdds` also for that Fast DDS. CompileError if it does not
    compile, AdapterError if it cannot run in that Fast DDS, AgentError if the agent does not
    start, FileError for a disk error.
    """
    folder = _built(fastdds)
    with disk_errors(folder), tempfile.TemporaryDirectory(prefix="pqsec-", dir=runtime) as own:
        place = AgentFolder.of({"XDG_RUNTIME_DIR": own})
        place.prepare()
        with _agent(place):
            yield TrialPlugin(folder, {"XDG_RUNTIME_DIR": own, "PQSEC_AGENT": ""})


@dataclass(frozen=True, slots=True)
class AgentUse:
    """What the agent and its workers have taken until now."""

    cpu: Mapping[int, float]
    """Process -> seconds of the processor."""
    memory: int
    """Kilobytes; what processes share is counted once."""

    @classmethod
    def of(cls, plugin: TrialPlugin) -> Self:
        """The use of a running agent; nothing if it is too busy to answer."""
        try:
            status = agent_status(AgentFolder.of(plugin.environment))
        except FileError:
            status = None
        running = (status.process, *status.workers) if status else ()
        cpu = {each: processor_seconds(each) for each in running}
        return cls(cpu, sum(map(_proportional, running)))


def _proportional(process: int) -> int:
    """Kilobytes of a process (proc_pid_smaps(5)); 0 if it has ended."""
    try:
        lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith("Pss:")), 0)


def _built(fastdds: Installation | None) -> Path:
    """The folder with the plugin, compiled now unless it is in the user's cache."""
    home = cache()
    compilers = _compilers(fastdds) if fastdds else None
    stack = examine(fastdds.library.path, fastdds.root) if fastdds else None
    goal = home / f"plugin-{_digest(stack, compilers)}"
    with disk_errors(goal), compiling_once(goal) as missing:
        if missing:
            with tempfile.TemporaryDirectory(dir=home, prefix=".plugin-") as draft:
                made = Path(draft) / "made"
                made.mkdir(mode=0o700)
                build(made)
                if stack and compilers:
                    install(stack, made, compilers)
                made.rename(goal)
    return goal


def _compilers(fastdds: Installation) -> Compilers:
    """The compilers in its root file system."""
    if fastdds.root == MACHINE:
        return here()
    run = partial(_run_there, fastdds)
    return Compilers(c="gcc", cxx="g++", run=run, folder=fastdds.root / "tmp")


def _run_there(fastdds: Installation, words: Sequence[str], folder: Path) -> None:
    place = f"/{folder.relative_to(fastdds.root)}"
    code, said = run_tool(words[0], fastdds.tool(tuple(words), place))
    if code:
        raise CompileError.of(said)


def _digest(stack: FastDds | None, compilers: Compilers | None) -> str:
    """A digest of the plugin's sources and of the compilers' commands."""
    files = [path for path in sorted(SOURCES.iterdir()) if path.is_file()]
    words = list(command("cc", Path(LIBRARY)))
    if stack and compilers:
        files += sources()
        words += [str(stack.root), *(word for line in commands(stack, compilers) for word in line)]
    parts = [path.read_bytes() for path in files] + [word.encode() for word in words]
    return hashlib.sha256(b"\0".join(parts)).hexdigest()[:16]


@contextmanager
def _agent(place: AgentFolder) -> Iterator[None]:
    with place.log.open("wb") as log:
        process = subprocess.Popen(  # noqa: S603 -- this interpreter
            [sys.executable, "-I", "-m", "pqsec_pki.plugin", str(place.socket), _IDLE],
            cwd="/",
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=log,
            start_new_session=True,
        )
    try:
        _wait_for(process, place)
        yield
    finally:
        process.kill()
        process.wait()


def _wait_for(process: "subprocess.Popen[bytes]", place: AgentFolder) -> None:
    end = time.monotonic() + _START
    while not _answers(place):
        if process.poll() is not None or time.monotonic() > end:
            lines = place.log.read_text(errors="replace").strip().splitlines() or ["no message"]
            raise AgentError(f"the agent does not start: {lines[-1]}")
        time.sleep(_PAUSE)


def _answers(place: AgentFolder) -> bool:
    try:
        return agent_status(place) is not None
    except FileError:  # it is starting, on a busy machine
        return False
