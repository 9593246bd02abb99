"""pqsec's plugin is compiled with the real Fast DDS in the layouts of ROS 2, colcon and conda.

Headers and libraries are those of this machine, copied. On it the compiler also finds the
originals: what it has read must be the copies.
"""

import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import pytest

from pqsec_pki.vendors import examine
from pqsec_pki.vendors.fastdds_adapter import here, install, installed, sources
from pqsec_pki.vendors.fastdds_library import AdapterError, FastDds

pytestmark = [pytest.mark.interop, pytest.mark.slow]

FAST = ("fastdds", "fastrtps")
ONE, EACH = "", "each"
"""One folder of headers for all projects, or one for each."""


@dataclass(frozen=True)
class Copy:
    """Where a copy of Fast DDS and Fast CDR is, below the folder of a test."""

    fast: str
    """The prefix of Fast DDS."""
    cdr: str
    headers: str = ONE
    include: str = ""
    """A folder that the user names."""


LAYOUTS = {
    "ROS 2's packages": Copy("opt/ros/x", "opt/ros/x", EACH),
    "merged workspace": Copy("ws/install", "ws/install"),
    "isolated workspace": Copy("ws/install/fastrtps", "ws/install/fastcdr"),
    "isolated workspace, each in its folder": Copy(
        "ws/install/fastrtps", "ws/install/fastcdr", EACH
    ),
    "conda": Copy("env", "env"),
    "workspace over packages that are named": Copy(
        "ws/install", "opt/ros/x", EACH, "opt/ros/x/include"
    ),
}


@pytest.fixture
def copied(fastdds_here, tmp_path) -> Callable[[Copy], FastDds]:
    """copied(copy) is this machine's Fast DDS, in that layout."""
    original = fastdds_here.library

    def placed(headers: Iterable[str], prefix: str, project: str, where: str) -> None:
        goal = tmp_path / prefix / "include" / (project if where else "")
        for name in headers:
            for folder in ("/usr/include", *Path("/usr/include").glob("*-linux-gnu*")):
                if (Path(folder) / name).is_dir():
                    shutil.copytree(Path(folder) / name, goal / name, dirs_exist_ok=True)

    def made(copy: Copy) -> FastDds:
        placed(FAST, copy.fast, "fastrtps", copy.headers)
        placed(["fastcdr"], copy.cdr, "fastcdr", copy.headers)
        [cdr] = [each for each in original.needed if each.startswith("libfastcdr")]
        libraries = tmp_path / copy.fast / "lib", tmp_path / copy.cdr / "lib"
        for folder, name in zip(libraries, (original.soname, cdr), strict=True):
            folder.mkdir(parents=True, exist_ok=True)
            shutil.copy(original.path.parent / name, folder)
        named = [tmp_path / copy.include] if copy.include else []
        return examine(libraries[0] / original.soname, include=named)

    return made


def reads(stack: FastDds, folder: Path) -> set[Path]:
    """The headers of Fast DDS and Fast CDR that the compiler reads."""
    for source in sources():
        shutil.copy(source, folder)
    include = [f"-I{each}" for each in stack.include]
    # Those of later versions include Fast CDR's.
    (folder / "all.cpp").write_text('#include "stack.hpp"\n#include <fastcdr/Cdr.h>\n')
    words = ["-std=c++17", "-DPQSEC_FASTDDS=2", *include, "-M", "-MF", "read", "all.cpp"]
    here().run([here().cxx, *words], folder)
    read = (Path(each) for each in (folder / "read").read_text().replace("\\\n", " ").split())
    return {each for each in read if {*FAST, "fastcdr"} & {*each.parts[:-1]}}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_compiler_reads_the_headers_of_that_copy_alone(
    copied, tmp_path, tmp_path_factory, layout
):
    stack = copied(LAYOUTS[layout])
    read = reads(stack, tmp_path_factory.mktemp("sources"))
    assert {each.name for each in read} >= {
        "WriterProxyData.h",
        "Authentication.h",
        "fastcdr_dll.h",
    }
    assert {each for each in read if not each.is_relative_to(tmp_path)} == set()


@pytest.mark.parametrize("layout", ["ROS 2's packages", "isolated workspace"])
def test_it_is_installed_and_probed_there(copied, tmp_path, layout):
    stack = copied(LAYOUTS[layout])
    install(stack, tmp_path / "plugin", here())
    [found] = installed(tmp_path / "plugin")
    assert (found.library, found.problem) == (stack.library.path, "")


def test_without_the_headers_of_fast_cdr_the_way_out_is_told(copied, tmp_path, monkeypatch):
    monkeypatch.setattr("pqsec_pki.vendors.fastdds_headers._SYSTEM", ())
    copy = Copy("ws/install", "opt/ros/x", EACH)
    with pytest.raises(AdapterError, match="headers of Fast CDR, and they are not") as refusal:
        copied(copy)
    assert "libfastcdr-dev" in refusal.value.hint
    assert "that has fastcdr/config.h: --include DIR" in refusal.value.hint
    assert copied(Copy(copy.fast, copy.cdr, EACH, "opt/ros/x/include/fastcdr")).include
