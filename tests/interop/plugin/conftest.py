"""The plugin, compiled for this run, and an agent of its own that nobody else meets."""

import ctypes
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
from pqsec_pki.trial import Installation, MissingStackError, find, plugin
from pqsec_pki.vendors.own_plugin import PRELOAD
from tests.interop import fastdds


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


@pytest.fixture(scope="session")
def fastdds_here(requires) -> Installation:
    """The Fast DDS of this machine."""
    try:
        return find("fastdds")
    except MissingStackError as error:
        return requires(None, "Fast DDS to compile against", error.hint or str(error))


@pytest.fixture(scope="session")
def adapter(fastdds_here) -> Path:
    """The folder with the plugin for it, which `pqsec try` compiles once."""
    with plugin(fastdds=fastdds_here) as found:
        return found.folder


@pytest.fixture(scope="session")
def ours_in_fastdds(adapter, fastdds_here, shim, tmp_path_factory) -> ctypes.CDLL:
    """Our plugin as Fast DDS gets it, behind the shim that its own has in other tests.

    That shim has the build ID of Fast DDS: the preload library takes it for the caller.
    """
    compiler = fastdds.find_compiler()
    identity = f"-Wl,--build-id=0x{fastdds_here.library.build_id}"
    where = f"-Wl,-rpath,{adapter}"
    return fastdds.build(
        compiler, tmp_path_factory.mktemp("ours"), adapter / PRELOAD, identity, where
    )


@pytest.fixture
def settings(enclave) -> Callable[..., Path]:
    """settings(folder, text) is a copy of an enclave with that pqsec.toml."""

    def copy(original: Path, text: str) -> Path:
        return enclave(original, {"pqsec.toml": text.encode()})

    return copy
