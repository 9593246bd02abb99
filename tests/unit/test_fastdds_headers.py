"""Where headers of a Fast DDS and of its Fast CDR are looked for, in the layouts that people have.

tests/interop compiles with the real ones.
"""

from pathlib import Path

import pytest

from pqsec_pki.vendors.fastdds_headers import FAST_CDR, FAST_DDS, Places

LAYOUTS = {
    "Debian": (
        "usr/lib/x86_64-linux-gnu",
        {3: "usr/include/x86_64-linux-gnu", 2: "usr/include/x86_64-linux-gnu"},
        "usr/include/x86_64-linux-gnu",
    ),
    "ROS 2's packages": (
        "opt/ros/lyrical/lib",
        {3: "opt/ros/lyrical/include/fastdds", 2: "opt/ros/lyrical/include/fastrtps"},
        "opt/ros/lyrical/include/fastcdr",
    ),
    "ROS 2's packages, libraries by processor": (
        "opt/ros/jazzy/lib/aarch64-linux-gnu",
        {3: "opt/ros/jazzy/include/fastdds", 2: "opt/ros/jazzy/include/fastrtps"},
        "opt/ros/jazzy/include/fastcdr",
    ),
    "one folder for all": ("opt/fast/lib64", {3: "opt/fast/include", 2: "opt/fast/include"},
                           "opt/fast/include"),
    "merged workspace": (
        "ws/install/lib",
        {3: "ws/install/include/fastdds", 2: "ws/install/include/fastrtps"},
        "ws/install/include/fastcdr",
    ),
    "isolated workspace": (
        "ws/install/fast/lib",
        {3: "ws/install/fast/include", 2: "ws/install/fast/include"},
        "ws/install/fastcdr/include",
    ),
    "isolated workspace, each project in its folder": (
        "ws/install/fast/lib",
        {3: "ws/install/fast/include/fastdds", 2: "ws/install/fast/include/fastrtps"},
        "ws/install/fastcdr/include/fastcdr",
    ),
    "conda": (
        "home/me/env/lib", {3: "home/me/env/include", 2: "home/me/env/include"},
        "home/me/env/include",
    ),
    "conda, each project in its folder": (
        "home/me/env/lib",
        {3: "home/me/env/include/fastdds", 2: "home/me/env/include/fastrtps"},
        "home/me/env/include/fastcdr",
    ),
    "Fast CDR of the system": ("opt/fast/lib", {3: "opt/fast/include", 2: "opt/fast/include"},
                               "usr/include/x86_64-linux-gnu"),
}  # fmt: skip
"""The folders of the library, of the headers of each generation, and of those of Fast CDR."""
VERSIONS = {2: (2, 14, 6), 3: (3, 2, 5)}


def put(folder: Path, project, version: str) -> None:
    path = folder / project.header
    path.parent.mkdir(parents=True)
    path.write_text(f'#define {project.macro}_VERSION_STR "{version}"\n')


def placed(root: Path, folder: str, generation: int, *named: Path) -> Places:
    path = root / folder / f"lib{FAST_DDS[generation].name}.so"
    return Places((path,), root, named)


@pytest.mark.parametrize("generation", FAST_DDS)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_headers_are_found_in_each_layout(tmp_path, layout, generation):
    library, headers, cdr = LAYOUTS[layout]
    version = VERSIONS[generation]
    put(tmp_path / headers[generation], FAST_DDS[generation], ".".join(map(str, version)))
    put(tmp_path / cdr, FAST_CDR, "2.2.7")
    places = placed(tmp_path, library, generation)
    found = places.headers(FAST_DDS[generation], version[:2])
    assert (found.folders[0], found.version) == (tmp_path / headers[generation], version)
    found = places.headers(FAST_CDR, (2,))
    assert (found.folders[0], found.version) == (tmp_path / cdr, (2, 2, 7))
    for folder in (headers[generation], cdr):
        if folder.endswith("linux-gnu"):  # the other headers are above it
            assert tmp_path / "usr/include" in found.folders


def test_those_of_the_librarys_version_count_though_others_are_nearer(tmp_path):
    places = placed(tmp_path, "ws/install/fast/lib", 3)
    put(tmp_path / "ws/install/fast/include", FAST_DDS[3], "3.1.2")
    assert places.headers(FAST_DDS[3], (3, 2)).version == (3, 1, 2)
    assert places.headers(FAST_DDS[3], (3, 2)).folders == ()
    put(tmp_path / "ws/install/include/fastdds", FAST_DDS[3], "3.2.5")
    found = places.headers(FAST_DDS[3], (3, 2))
    assert found.folders == (tmp_path / "ws/install/include/fastdds",)


@pytest.mark.parametrize("below", ["", "fastdds", "x86_64-linux-gnu"])
def test_a_folder_that_is_named_comes_first(tmp_path, below):
    for place in ("usr/include", f"named/{below}"):
        put(tmp_path / place, FAST_DDS[3], "3.2.5")
    places = placed(tmp_path, "usr/lib", 3, tmp_path / "named")
    assert places.headers(FAST_DDS[3], (3, 2)).folders[0] == tmp_path / "named" / below


def test_a_folder_that_is_named_with_another_version_is_refused(tmp_path):
    """The compiler would see its headers first."""
    put(tmp_path / "usr/include", FAST_DDS[3], "3.2.5")
    put(tmp_path / "named", FAST_DDS[3], "3.6.2")
    found = placed(tmp_path, "usr/lib", 3, tmp_path / "named").headers(FAST_DDS[3], (3, 2))
    assert (found.folders, found.version) == ((), (3, 6, 2))


def test_nothing_outside_the_root_file_system_is_found(tmp_path):
    put(tmp_path / "include", FAST_DDS[3], "3.2.5")
    found = placed(tmp_path / "root", "usr/lib", 3).headers(FAST_DDS[3], (3, 2))
    assert found.folders == ()


def test_headers_of_a_library_that_a_link_names_are_found_beside_the_link(tmp_path):
    """As colcon does with --symlink-install."""
    put(tmp_path / "install/include", FAST_DDS[3], "3.2.5")
    paths = tmp_path / "install/lib/libfastdds.so", tmp_path / "build/x/libfastdds.so.3.2.5"
    found = Places(paths, tmp_path).headers(FAST_DDS[3], (3, 2, 5))
    assert found.folders == (tmp_path / "install/include",)


@pytest.mark.parametrize(
    "folder", ["ws/install/fastdds/lib", "ws/install/fastcdr/lib", "ws/install/lib", "usr/lib64"]
)
def test_the_folder_of_fast_cdr_is_that_of_the_library_that_is_loaded(tmp_path, folder):
    (tmp_path / folder).mkdir(parents=True)
    (tmp_path / folder / "libfastcdr.so.1").touch()
    places = placed(tmp_path, "ws/install/fastdds/lib", 3)
    headers = places.headers(FAST_CDR, (2,))
    assert places.folder_of("libfastcdr.so.2", FAST_CDR, headers) is None
    (tmp_path / folder / "libfastcdr.so.2").touch()
    assert places.folder_of("libfastcdr.so.2", FAST_CDR, headers) == tmp_path / folder


def test_fast_cdr_is_found_above_headers_that_were_named(tmp_path):
    """An underlay, which the library is not below."""
    put(tmp_path / "opt/ros/x/include/fastcdr", FAST_CDR, "2.2.7")
    (tmp_path / "opt/ros/x/lib").mkdir()
    (tmp_path / "opt/ros/x/lib/libfastcdr.so.2").touch()
    places = placed(tmp_path, "ws/install/lib", 3, tmp_path / "opt/ros/x/include")
    headers = places.headers(FAST_CDR, (2,))
    found = places.folder_of("libfastcdr.so.2", FAST_CDR, headers)
    assert found == tmp_path / "opt/ros/x/lib"
