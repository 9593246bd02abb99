"""Compiles pqsec's own plugin when it is first needed, and runs it with an agent for a trial."""

import hashlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from pqsec_pki._files import disk_errors
from pqsec_pki.errors import PqsecError
from pqsec_pki.plugin import LIBRARY, AgentFolder, agent_status, build
from pqsec_pki.plugin.build import SOURCES, command
from pqsec_pki.trial.building import cache, is_own

_RUNTIME = Path("/tmp")  # noqa: S108 -- a socket's path must be short; the folder in it is 0700
_IDLE = "20"
"""Seconds after which the agent ends by itself, if the trial was killed."""
_START = 10.0
_PAUSE = 0.02


class AgentError(PqsecError):
    """The agent of a trial does not start."""


@dataclass(frozen=True, slots=True)
class Plugin:
    """The plugin's folder, and the variables with which it finds its agent."""

    folder: Path
    environment: Mapping[str, str]


@contextmanager
def plugin(runtime: Path = _RUNTIME) -> Iterator[Plugin]:
    """The plugin with its own agent, below `runtime`; the agent is stopped when the block ends.

    CompileError if it does not compile, AgentError if the agent does not start, FileError for
    a disk error.
    """
    folder = _built()
    with disk_errors(folder), tempfile.TemporaryDirectory(prefix="pqsec-", dir=runtime) as own:
        place = AgentFolder.of({"XDG_RUNTIME_DIR": own})
        place.prepare()
        with _agent(place):
            yield Plugin(folder, {"XDG_RUNTIME_DIR": own, "PQSEC_AGENT": ""})


def _built() -> Path:
    """The folder with the plugin, compiled now unless it is in the user's cache."""
    home = cache()
    goal = home / f"plugin-{_digest()}"
    if not is_own(goal):
        with disk_errors(goal), tempfile.TemporaryDirectory(dir=home, prefix=".plugin-") as draft:
            made = Path(draft) / "made"
            made.mkdir(mode=0o700)
            build(made)
            if not is_own(goal):  # another trial may have been faster
                made.rename(goal)
    return goal


def _digest() -> str:
    """A digest of the plugin's sources and of the compiler's command."""
    parts = [path.read_bytes() for path in sorted(SOURCES.iterdir()) if path.is_file()]
    parts += [word.encode() for word in command("cc", Path(LIBRARY))]
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
    while agent_status(place) is None:
        if process.poll() is not None or time.monotonic() > end:
            lines = place.log.read_text(errors="replace").strip().splitlines() or ["no message"]
            raise AgentError(f"the agent does not start: {lines[-1]}")
        time.sleep(_PAUSE)
