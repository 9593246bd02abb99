"""Compiles the plugin for arm64 on another machine: `python -m tests.install.cross ROOT FOLDER`.

With Debian's cross compiler and pqsec's own commands: the library for Cyclone DDS, both libraries
for the Fast DDS in the root file system, and the test of the values of OpenDDS's adapter.
"""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from pqsec_pki.plugin import LIBRARY
from pqsec_pki.plugin.building import SOURCES, command
from pqsec_pki.vendors import elf, examine, fastdds_library, find_fastdds
from pqsec_pki.vendors.fastdds_adapter import Compilers, compile_adapter
from pqsec_pki.vendors.opendds_adapter import OPENDDS_SOURCES

CC, CXX = "aarch64-linux-gnu-gcc", "aarch64-linux-gnu-g++"
ARM64 = (2, 183)
"""ELF64, EM_AARCH64."""
PYTHON = "/usr/lib/pqsec/bin/python"
"""Of pqsec, there."""
VALUES = Path(__file__).parents[1] / "unit/opendds_values.cpp"


def compile_all(root: Path, folder: Path) -> None:
    """The compiled files for the root file system, in `folder`."""
    sys.executable = PYTHON  # the agent that the libraries start

    def run(words: Sequence[str], where: Path) -> None:
        subprocess.run([*words, f"--sysroot={root}"], cwd=where, check=True, timeout=600)

    fastdds, values = folder / "fastdds", folder / "values"
    fastdds.mkdir(parents=True)
    values.mkdir()
    run(command(CC, folder / LIBRARY, "-Wall", "-Wextra", "-Werror"), folder)
    fastdds_library.runs_here = lambda library: library.machine == ARM64
    stack = examine(find_fastdds(root))
    compile_adapter(stack, fastdds, Compilers(c=CC, cxx=CXX, run=run))
    run([CC, "-std=c11", "-c", str(SOURCES / "wire.c")], values)
    words = [CXX, "-std=c++11", f"-I{OPENDDS_SOURCES}", f"-I{SOURCES}", str(VALUES), "wire.o"]
    run([*words, "-o", "values"], values)
    for path in (folder / LIBRARY, *fastdds.glob("*.so"), values / "values"):
        assert elf.read_library(path).machine == ARM64, path


if __name__ == "__main__":
    compile_all(Path(sys.argv[1]).absolute(), Path(sys.argv[2]).absolute())
