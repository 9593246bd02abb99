"""Reads the name, the linked libraries and the build of a compiled library.

A strict reader of the few parts of ELF that have them (System V gABI: ELF Header, Program Header,
Dynamic Section, Note Section), because a robot has no binutils. It reads some kilobytes of a
library of any size, follows nothing in it without a limit, and runs nothing of it.
"""

import hashlib
import os
import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from stat import S_ISREG
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors, resolved
from pqsec_pki.errors import MalformedError, PqsecError, located
from pqsec_pki.vendors.exports import Version

MAX_HEADERS = 128
"""Program headers; a library has about ten."""
MAX_DYNAMIC = 1 << 16
"""Bytes of the dynamic section; 4096 entries, of which a library has about forty."""
MAX_NOTES = 1 << 12
"""Bytes of one note segment; a build ID takes 36."""
MAX_NAME = 256
"""Bytes of a library's name: more than a file's may have."""

_LOAD, _DYNAMIC, _NOTE = 1, 2, 4
_END, _NEEDED, _STRINGS, _STRINGS_SIZE, _SONAME = 0, 1, 5, 10, 14
_BUILD_ID = (b"GNU\0", 3)
_RELEASE = re.compile(r"\.so\.([0-9]{1,4}(?:\.[0-9]{1,4}){0,3})")


@dataclass(frozen=True, slots=True, kw_only=True)
class Library:
    """A shared library, or a program that loads shared libraries."""

    path: Path
    """Where the file itself is, links resolved."""
    soname: str
    """The name by which others load it (DT_SONAME); empty if it has none."""
    needed: tuple[str, ...]
    """The names of the libraries that it loads (DT_NEEDED), in their order."""
    build_id: str
    """The build ID in hexadecimal; empty if it has none."""
    build: str
    """The build ID; SHA-256 of the file if it has none."""
    machine: tuple[int, int]
    """EI_CLASS and e_machine: the processor and the mode that it is for."""

    @property
    def release(self) -> Version:
        """The version as far as the file's name or soname shows it; () if they do not."""
        return max(release_in(self.path.name), release_in(self.soname), key=len)


def release_in(name: str) -> Version:
    """The numbers behind `.so` in a library's name: (0, 10, 2) of libddsc.so.0.10.2, (0,) of
    libddsc.so.0debian; () if there are none."""
    found = _RELEASE.search(name)
    return tuple(map(int, found[1].split("."))) if found else ()


def runs_here(library: Library) -> bool:
    """Whether it is for the processor, and the mode, that this process runs in."""
    own = _own_machine()
    return own is None or library.machine == own


@cache
def _own_machine() -> tuple[int, int] | None:
    with suppress(PqsecError):
        return read_library(Path("/proc/self/exe")).machine
    return None  # a system without /proc


def read_library(path: Path) -> Library:
    """The library at `path`; FileError if it cannot be read, MalformedError if it is not one."""
    with opened(path) as image:
        return image.library(resolved(path))


@contextmanager
def opened(path: Path) -> "Iterator[Image]":
    """The ELF file at `path`, while the block runs; errors as of read_library."""
    with located(path), disk_errors(path):
        handle = os.open(resolved(path), os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            if not S_ISREG(os.fstat(handle).st_mode):
                raise MalformedError("not a library: not a file")
            yield Image.of(handle)
        finally:
            os.close(handle)


@dataclass(frozen=True, slots=True)
class _Segment:
    kind: int
    offset: int
    address: int
    size: int


@dataclass(frozen=True, slots=True)
class Image:
    """An open ELF file. Methods raise MalformedError for an invalid one."""

    handle: int
    order: str
    """`<` or `>`, as in struct."""
    wide: bool
    """Whether it is ELF64."""
    machine: int
    segments: tuple[_Segment, ...] = ()

    @classmethod
    def of(cls, handle: int) -> Self:
        start = os.pread(handle, 64, 0)
        if len(start) < 52 or start[:4] != b"\x7fELF" or start[4] not in {1, 2}:  # noqa: PLR2004
            raise MalformedError("not a library: it is not ELF")
        if start[5] not in {1, 2}:
            raise MalformedError("not a library: its byte order is unknown")
        order, wide = "<>"[start[5] - 1], start[4] == 2  # noqa: PLR2004 -- ELFCLASS64
        (machine,) = struct.unpack_from(f"{order}H", start, 18)
        bare = cls(handle, order, wide, machine)
        offset, size, count = bare._table(start)
        if count > MAX_HEADERS or size != bare._header.size:
            raise MalformedError("not a library: its program headers are not those of ELF")
        table = bare.at(offset, size * count)
        segments = tuple(map(bare._segment, bare._header.iter_unpack(table)))
        return replace(bare, segments=segments)

    def library(self, path: Path) -> Library:
        entries = list(self.entries())
        names = {kind: [value for tag, value in entries if tag == kind] for kind in (1, 14)}
        tables = dict(entries)
        if _STRINGS not in tables or _STRINGS_SIZE not in tables:
            raise MalformedError("not a library: it has no names")
        strings, size = self.offset(tables[_STRINGS]), tables[_STRINGS_SIZE]
        needed = tuple(self._name(strings, size, each) for each in names[_NEEDED])
        sonames = [self._name(strings, size, each) for each in names[_SONAME]]
        build_id = self._build_id()
        return Library(
            path=path,
            soname=sonames[0] if sonames else "",
            needed=needed,
            build_id=build_id,
            build=build_id or self._digest(),
            machine=(2 if self.wide else 1, self.machine),
        )

    def at(self, offset: int, size: int) -> bytes:
        """The `size` bytes at `offset`; MalformedError if the file has fewer."""
        try:
            data = os.pread(self.handle, size, offset)
        except (OverflowError, OSError):
            data = b""
        if len(data) != size:
            raise MalformedError("not a library: it ends too early")
        return data

    @property
    def _header(self) -> struct.Struct:
        return struct.Struct(self.order + ("IIQQQQQQ" if self.wide else "8I"))

    def _table(self, start: bytes) -> tuple[int, int, int]:
        """The position of the program headers, the size of one, and their number."""
        if self.wide:
            (offset,) = struct.unpack_from(f"{self.order}Q", start.ljust(64, b"\0"), 32)
            size, count = struct.unpack_from(f"{self.order}HH", start.ljust(64, b"\0"), 54)
        else:
            (offset,) = struct.unpack_from(f"{self.order}I", start, 28)
            size, count = struct.unpack_from(f"{self.order}HH", start, 42)
        return offset, size, count

    def _segment(self, header: tuple[int, ...]) -> _Segment:
        kind, *rest = header
        offset, address, _, size = rest[1:5] if self.wide else rest[0:4]
        return _Segment(kind, offset, address, size)

    def entries(self) -> Iterator[tuple[int, int]]:
        """(tag, value) of each entry of the dynamic section."""
        found = [each for each in self.segments if each.kind == _DYNAMIC]
        if len(found) != 1 or found[0].size > MAX_DYNAMIC:
            raise MalformedError("not a library: it has no dynamic section, or more than one")
        entry = struct.Struct(self.order + ("qQ" if self.wide else "iI"))
        size = found[0].size - found[0].size % entry.size
        for tag, value in entry.iter_unpack(self.at(found[0].offset, size)):
            if tag == _END:
                return
            yield tag, value

    def offset(self, address: int) -> int:
        """The position in the file of what is loaded at `address`."""
        for each in self.segments:
            if each.kind == _LOAD and 0 <= address - each.address < each.size:
                return each.offset + address - each.address
        raise MalformedError("not a library: its names are not in a segment")

    def _name(self, strings: int, size: int, index: int) -> str:
        """The string at `index` of the string table."""
        if index >= size:
            raise MalformedError("not a library: a name is outside the string table")
        data, end, _ = self.at(strings + index, min(MAX_NAME, size - index)).partition(b"\0")
        if not end:
            raise MalformedError("not a library: a name has no end")
        return os.fsdecode(data)

    def _build_id(self) -> str:
        for each in self.segments:
            if each.kind == _NOTE and each.size <= MAX_NOTES:
                for note, text in self._notes(self.at(each.offset, each.size)):
                    if note == _BUILD_ID:
                        return text.hex()
        return ""

    def _notes(self, data: bytes) -> Iterator[tuple[tuple[bytes, int], bytes]]:
        """((name, type), description) of each complete note; notes of a build ID align to 4."""
        while len(data) >= 12:  # noqa: PLR2004 -- three words
            name_size, text_size, kind = struct.unpack_from(f"{self.order}III", data)
            text = 12 + name_size + -name_size % 4
            if text + text_size > len(data):
                return
            yield (data[12 : 12 + name_size], kind), data[text : text + text_size]
            data = data[text + text_size + -text_size % 4 :]

    def _digest(self) -> str:
        digest, offset = hashlib.sha256(), 0
        while data := os.pread(self.handle, 1 << 20, offset):
            digest.update(data)
            offset += len(data)
        return digest.hexdigest()
