"""The plugin, compiled for this run, and an agent of its own that nobody else meets."""

import os
import shutil
import signal
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

from pqsec_pki.plugin import AgentFolder, agent_status, build, stop_agent


@dataclass(frozen=True)
class Shim:
    """A folder with the library, named as Cyclone DDS's own plugins are, and its agent."""

    folder: Path
    place: AgentFolder

    def wait_for_agent(self) -> int:
        """The process of the agent, once one runs."""
        while not (status := agent_status(self.place)):
            time.sleep(0.01)
        return status.process

    @property
    def log(self) -> str:
        """All that agents wrote."""
        return self.place.log.read_text() if self.place.log.exists() else ""

    def kill_agent(self, process: int = 0) -> None:
        """Kill the agent, or the one that is meant, and see it gone."""
        process = process or self.wait_for_agent()
        with suppress(ProcessLookupError):
            os.kill(process, signal.SIGKILL)
        while _runs(process):
            time.sleep(0.01)


def _runs(process: int) -> bool:
    with suppress(OSError):
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
        return state != "Z"
    return False


@pytest.fixture(scope="session")
def compiler(requires) -> str:
    """The C compiler."""
    return requires(shutil.which("cc"), "a C compiler", "apt-get install gcc libc6-dev")


@pytest.fixture(scope="session")
def shim(compiler, tmp_path_factory) -> Iterator[Shim]:
    """The plugin; what loads it in this process or below finds an agent of this run."""
    runtime = Path(tempfile.mkdtemp(prefix="pqsec-run-"))  # a socket's path must be short
    before = os.environ.get("XDG_RUNTIME_DIR")
    os.environ["XDG_RUNTIME_DIR"] = str(runtime)
    try:
        built = build(tmp_path_factory.mktemp("plugin"))
        place = AgentFolder.of(os.environ)
        yield Shim(built.library.parent, place)
        stop_agent(place)
    finally:
        os.environ.pop("XDG_RUNTIME_DIR")
        if before is not None:
            os.environ["XDG_RUNTIME_DIR"] = before
        shutil.rmtree(runtime, ignore_errors=True)


@pytest.fixture
def settings(enclave) -> Callable[..., Path]:
    """settings(folder, text) is a copy of an enclave with that pqsec.toml."""

    def copy(original: Path, text: str) -> Path:
        return enclave(original, {"pqsec.toml": text.encode()})

    return copy
