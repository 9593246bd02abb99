"""What a library says of itself, read as binutils read it; what is broken is refused."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pqsec_pki.errors import FileError, MalformedError, PqsecError
from pqsec_pki.vendors.elf import MAX_HEADERS, read_library, release_in, runs_here

OF_THE_SYSTEM = sorted(Path("/usr/lib").glob("*-linux-gnu*/*.so*"))
OTHER = ("-m32",)
MOST = 150
"""Of them; a machine may have thousands."""
NAMES = ("libddsc.so.0debian", "libc.so.6", f"lib{'x' * 180}.so.1")


def by_readelf(path: Path) -> tuple[str, tuple[str, ...], str]:
    """soname, names of those needed, build ID."""
    command = ["readelf", "--wide", "--dynamic", "--notes", str(path)]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    sonames = re.findall(r"\(SONAME\) +Library soname: \[(.*)\]", said)
    needed = re.findall(r"\(NEEDED\) +Shared library: \[(.*)\]", said)
    builds = re.findall(r"Build ID: ([0-9a-f]+)", said)
    return (sonames or [""])[0], tuple(needed), (builds or [""])[0]


@pytest.fixture
def flags(request, library, requires) -> tuple[str, ...]:
    """What the compiler is told."""
    can = library.can(*request.param)
    return requires(request.param if can else None, f"gcc {request.param}", "apt-get install gcc")


@pytest.fixture
def put(tmp_path):
    def file(data: bytes, name: str = "lib.so") -> Path:
        path = tmp_path / name
        path.write_bytes(data)
        return path

    return file


@pytest.mark.parametrize("flags", [(), OTHER], ids=["own", "ELF32"], indirect=True)
@pytest.mark.parametrize("hash_style", ["gnu", "sysv"])
def test_a_librarys_own_words_are_read(library, put, flags, hash_style):
    more = (*flags, f"-Wl,--hash-style={hash_style}")
    path = put(library("libmine.so.3", *NAMES, build="00ff10", flags=more))
    found = read_library(path)
    assert (found.soname, found.needed, found.build) == ("libmine.so.3", NAMES, "00ff10")
    assert runs_here(found) is (flags == ())


def test_a_library_without_words_has_none(library, put):
    found = read_library(put(library()))
    assert (found.soname, found.needed) == ("", ())
    assert len(found.build) == 64


def test_another_library_without_a_build_id_is_another_build(library, put):
    one, other = (read_library(put(library(name), name)) for name in ("one.so", "other.so"))
    assert one.build != other.build


def test_libraries_of_this_machine_are_read_as_readelf_reads_them(requires):
    requires(shutil.which("readelf"), "readelf", "apt-get install binutils")
    wrong, seen = {}, 0
    for path in OF_THE_SYSTEM:
        if seen == MOST or path.read_bytes()[:4] != b"\x7fELF":  # a linker script
            continue
        seen += 1
        found, expected = read_library(path), by_readelf(path)
        build = expected[2] or found.build
        if (found.soname, found.needed, found.build) != (*expected[:2], build):
            wrong[path] = (found, expected)
    assert not wrong
    assert seen


@pytest.mark.parametrize(
    ("name", "release"),
    [
        ("libddsc.so.0.10.2", (0, 10, 2)),
        ("libddsc.so.0debian", (0,)),
        ("libddsc.so.11", (11,)),
        ("libfastrtps.so.2.9.1", (2, 9, 1)),
        ("libddsc.so", ()),
        ("libdds_security_auth.so", ()),
        ("", ()),
    ],
)
def test_a_name_tells_the_version(name, release):
    assert release_in(name) == release


def test_the_files_name_tells_more_than_the_soname(library, put):
    link = put(library("libddsc.so.0debian"), "libddsc.so.0.10.2").with_name("libddsc.so")
    link.symlink_to("libddsc.so.0.10.2")
    assert read_library(link).release == (0, 10, 2)
    assert read_library(link).path.name == "libddsc.so.0.10.2"


def test_what_is_not_a_library_is_refused(put, tmp_path):
    scripts = {"empty": b"", "text": b"INPUT(-lddsc)\n", "short": b"\x7fELF\2\1\1" + bytes(20)}
    for name, data in scripts.items():
        with pytest.raises(MalformedError, match=f"{name}: not a library"):
            read_library(put(data, name))
    with pytest.raises(MalformedError, match="not a file"):
        read_library(tmp_path)
    with pytest.raises(FileError, match="no such file"):
        read_library(tmp_path / "nothing")
    many = bytearray(b"\x7fELF\2\1\1" + bytes(57))
    many[56:58] = (MAX_HEADERS + 1).to_bytes(2, "little")
    with pytest.raises(MalformedError, match="program headers"):
        read_library(put(bytes(many), "many"))


@pytest.mark.parametrize("flags", [(), OTHER], ids=["own", "ELF32"], indirect=True)
def test_a_damaged_library_is_read_or_refused_and_nothing_else(library, put, flags):
    """Every byte of its headers, dynamic section and names, each to several values; every end."""
    whole, path = library("libmine.so.3", "libddsc.so.11", build="aa", flags=flags), put(b"")
    strings = whole.index(b"libddsc.so.11")
    dynamic = whole.rindex((1).to_bytes(4, sys.byteorder))
    places = {*range(1024), *range(strings - 64, strings + 64), *range(dynamic, dynamic + 256)}
    refused = 0
    with path.open("r+b") as file:
        file.write(whole)
        for place in sorted(each for each in places if each < len(whole)):
            for value in {0, 1, 0x7F, 0x80, 0xFF} - {whole[place]}:
                file.seek(place)
                file.write(bytes([value]))
                file.flush()
                try:
                    read_library(path)
                except PqsecError:
                    refused += 1
            file.seek(place)
            file.write(whole[place : place + 1])
        for end in range(0, len(whole), 97):
            file.truncate(0)
            file.seek(0)
            file.write(whole[:end])
            file.flush()
            try:
                read_library(path)
            except PqsecError:
                refused += 1
    assert refused > 100
