"""pqsec's own plugin for a trial: compiled when it is first needed, with an agent of its own."""

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
"""Seconds after which the agent ends by itself, should nobody be left to end it."""
_START = 10.0
_PAUSE = 0.02


class AgentError(PqsecError):
    """The agent of a trial does not start."""


@dataclass(frozen=True, slots=True)
class Plugin:
    """The plugin, and how those that load it find its agent."""

    folder: Path
    environment: Mapping[str, str]


@contextmanager
def plugin(runtime: Path = _RUNTIME) -> Iterator[Plugin]:
    """The plugin with an agent that serves nobody else, below `runtime`, and is gone after.

    CompileError if it does not compile, AgentError if the agent does not start, FileError if
    the disk refuses.
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
            if not is_own(goal):  # and another trial was not faster
                made.rename(goal)
    return goal


def _digest() -> str:
    """Of all that it is made of, and the interpreter that its agent runs in."""
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
            said = place.log.read_text(errors="replace").strip().splitlines() or ["it said nothing"]
            raise AgentError(f"the agent does not start: {said[-1]}")
        time.sleep(_PAUSE)
