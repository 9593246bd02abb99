"""The plugin, compiled for this run, and an agent of its own that nobody else meets."""

import os
import shutil
import signal
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

from pqsec_pki.plugin import AgentFolder, agent_status, build, stop_agent
from pqsec_pki.trial import Installation, TrialPlugin, plugin
from pqsec_pki.vendors.own_plugin import PRELOAD
from tests.interop import fastdds_shim
from tests.interop.fastdds_shim import FastDdsShim
from tests.interop.roots import compiled


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
        """Kill the agent, or the one that is meant, with its workers, and see them gone."""
        process = process or self.wait_for_agent()
        them = [process, *children(process)]
        for each in them:
            with suppress(ProcessLookupError):
                os.kill(each, signal.SIGKILL)
        while any(map(_runs, them)):
            time.sleep(0.01)


def children(process: int) -> list[int]:
    path = Path(f"/proc/{process}/task/{process}/children")
    return list(map(int, path.read_text().split())) if path.exists() else []


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


@pytest.fixture(scope="session")
def fastdds_here(stack_in) -> Installation:
    """The Fast DDS of this machine."""
    return stack_in("fastdds", "bookworm")


@pytest.fixture(scope="module")
def plugin_for(stack_in) -> Iterator[Callable[[str], TrialPlugin]]:
    """plugin_for("trixie") is the plugin for the Fast DDS that is there, with an agent.

    `pqsec try` compiles it once.
    """
    with ExitStack() as stack:
        yield cache(lambda where: stack.enter_context(plugin(fastdds=stack_in("fastdds", where))))


@pytest.fixture(scope="session")
def fastdds_with_ours(stack_in, shim) -> Iterator[Callable[[str], FastDdsShim]]:
    """fastdds_with_ours("trixie") is the Fast DDS that is there, in a process with our plugin."""
    with ExitStack() as stack:

        def started(where: str) -> FastDdsShim:
            installation = stack_in("fastdds", where)
            sources, options = fastdds_shim.program(installation)
            command = stack.enter_context(compiled(installation, sources, *options))
            with plugin(fastdds=installation) as found:
                preload = {"LD_PRELOAD": str(found.folder / PRELOAD)}
            return stack.enter_context(fastdds_shim.process(command, preload))

        yield cache(started)


@pytest.fixture
def settings(enclave) -> Callable[..., Path]:
    """settings(folder, text) is a copy of an enclave with that pqsec.toml."""

    def copy(original: Path, text: str) -> Path:
        return enclave(original, {"pqsec.toml": text.encode()})

    return copy
