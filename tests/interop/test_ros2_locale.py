"""The locale in which nodes of ROS 2 match patterns: Fast DDS's fnmatch follows it."""

import subprocess

import pytest

from pqsec_pki.access import FASTDDS

pytestmark = pytest.mark.interop

NODE = """
import ctypes, rclpy
rclpy.init()
rclpy.create_node("talker")
libc = ctypes.CDLL(None)
libc.setlocale.restype = ctypes.c_char_p
named = libc.setlocale(0, None).decode()  # LC_CTYPE
covers = libc.fnmatch(b"rt/arm?", "rt/armé".encode(), 2) == 0  # FNM_NOESCAPE, as Fast DDS
print(named, covers)
"""
CALLS = ("setlocale", "newlocale", "uselocale")
NATIVE = ("librcl*", "librmw*", "libfast*", "librosidl*", "librcutils*", "librcpputils*")


@pytest.mark.parametrize(
    ("variables", "locale"),
    [
        ({}, "C.UTF-8"),
        ({"LANG": "C"}, "C.UTF-8"),
        ({"LANG": "C.UTF-8"}, "C.UTF-8"),
        ({"LC_ALL": "C"}, "C"),
    ],
    ids=["no variable", "LANG=C", "LANG=C.UTF-8", "LC_ALL=C"],
)
def test_a_python_node_matches_by_characters_unless_lc_all_names_c(
    ros2, tmp_path, variables, locale
):
    """Python calls setlocale, and takes C.UTF-8 for C (PEP 538)."""
    environment = {"PATH": "/usr/bin:/bin"} | ros2.variables(tmp_path)
    del environment["LANG"]
    done = subprocess.run(
        [str(ros2.folder / "bin" / "python"), "-c", NODE],
        env=environment | variables,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.stdout.split() == [locale, str(locale == "C.UTF-8")], done.stderr
    [reading] = [each for each in FASTDDS.locales if each.locale == locale]
    assert reading.covers("rt/arm?", "rt/armé") is (locale == "C.UTF-8")


def test_no_library_below_a_node_chooses_a_locale(ros2):
    """So a node in C++ is in C, unless its own code calls setlocale. The wheels have no rclcpp."""
    libraries = sorted(
        {path for pattern in NATIVE for path in (ros2.folder / "lib").glob(f"{pattern}.so*")}
    )
    names = {path.name.partition(".so")[0] for path in libraries}
    assert {"librcl", "librmw_fastrtps_cpp", "libfastrtps"} <= names, names
    for path in libraries:
        done = subprocess.run(
            ["nm", "-D", "--undefined-only", path], capture_output=True, text=True, check=True
        )
        wanted = {line.split()[-1].partition("@")[0] for line in done.stdout.splitlines()}
        assert not wanted.intersection(CALLS), path
