"""Reads which functions a library exports, and which it calls so that others can replace them.

Read from the tables of symbols and relocations of an ELF64 library (System V gABI: Sections, Symbol
Table, Relocation) for x86-64 and AArch64. C++'s tables of virtual functions are those of the
Itanium C++ ABI, 2.5.2: two words, and then a pointer to each function.
"""

import struct
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import MalformedError
from pqsec_pki.vendors.elf import Image, opened

MAX_SECTIONS = 1 << 12
MAX_TABLE = 64 << 20
"""Bytes of a table; those of Fast DDS have about 1 MB."""

_SYMBOLS, _RELOCATIONS, _DYNAMIC_SYMBOLS = 2, 4, 11
_SECTION, _SYMBOL, _RELOCATION = struct.Struct("<IIQQQQIIQQ"), "<IBBHQQ", "<QQq"
_FUNCTION = 2
_LOCAL = 0
_DEFAULT = 0
_SYMBOLIC, _FLAGS, _SYMBOLIC_FLAG = 16, 30, 2
_WORD, _HEAD = 8, 16
_CALLS = {62: {6, 7}, 183: {1025, 1026}}
"""By e_machine: relocations through which functions are called, GLOB_DAT and JUMP_SLOT."""
_POINTERS = {62: {1}, 183: {257}}
"""Relocations that put the address of a symbol into a table."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Symbols:
    """The functions of a library, by their names in it."""

    exported: frozenset[str]
    """Functions that others can call, and define in its place."""
    called: frozenset[str]
    """Functions that it calls through its table of addresses, so that another definition counts."""
    pointed: frozenset[str]
    """Virtual functions that it calls in that way."""
    tables: Mapping[str, tuple[frozenset[str], ...]]
    """Table of virtual functions -> the names of each function; empty for one without a name."""
    is_symbolic: bool
    """Whether the loader takes its own definitions first in any case (-Bsymbolic)."""


@dataclass(frozen=True, slots=True)
class _Section:
    kind: int
    offset: int
    size: int
    link: int


@dataclass(frozen=True, slots=True)
class _Symbol:
    name: str
    kind: int
    binding: int
    visibility: int
    is_defined: bool
    address: int
    size: int


def read_symbols(path: Path, tables: Iterable[str] = ()) -> Symbols:
    """The symbols of the library at `path`, with the functions of these virtual tables.

    A table that the library does not have is left out. FileError if it cannot be read,
    MalformedError if it is not a library, or is of a kind that this reader does not support.
    """
    with opened(path) as image:
        if not image.wide or image.order != "<" or image.machine not in _CALLS:
            raise MalformedError("its symbols are read for x86-64 and AArch64 only")
        return _symbols(image, tables)


def _symbols(image: Image, wanted: Iterable[str]) -> Symbols:
    sections = list(_sections(image))
    lists = {
        index: list(_symbol_list(image, sections, section))
        for index, section in enumerate(sections)
        if section.kind in {_SYMBOLS, _DYNAMIC_SYMBOLS}
    }
    defined = [each for found in lists.values() for each in found if each.is_defined]
    called, slots = set(), {}
    for place, kind, symbol, addend in _relocations(image, sections, lists):
        if symbol and kind in _CALLS[image.machine]:
            called.add(symbol)
        slots[place] = (symbol if kind in _POINTERS[image.machine] else "", addend)
    names: dict[int, set[str]] = {}
    for each in defined:
        if each.kind == _FUNCTION:
            names.setdefault(each.address, set()).add(each.name)
    at = {each.name: each for each in defined}
    return Symbols(
        exported=frozenset(
            each.name
            for index, found in lists.items()
            if sections[index].kind == _DYNAMIC_SYMBOLS
            for each in found
            if each.is_defined and each.binding != _LOCAL and each.visibility == _DEFAULT
        ),
        called=frozenset(called),
        pointed=frozenset(symbol for symbol, _ in slots.values() if symbol),
        tables={
            name: tuple(_functions(image, at[name], slots, names)) for name in wanted if name in at
        },
        is_symbolic=any(
            tag == _SYMBOLIC or (tag == _FLAGS and value & _SYMBOLIC_FLAG)
            for tag, value in image.entries()
        ),
    )


def _sections(image: Image) -> Iterator[_Section]:
    start = image.at(0, 64)
    (offset,) = struct.unpack_from("<Q", start, 40)
    size, count = struct.unpack_from("<HH", start, 58)
    if not offset or size != _SECTION.size or count > MAX_SECTIONS:
        raise MalformedError("its sections cannot be read: it was stripped of their headers")
    for each in _SECTION.iter_unpack(image.at(offset, size * count)):
        _, kind, _, _, place, length, link, *_ = each
        yield _Section(kind, place, length, link)


def _content(image: Image, section: _Section) -> bytes:
    if section.size > MAX_TABLE:
        raise MalformedError(f"a table of more than {MAX_TABLE} bytes")
    return image.at(section.offset, section.size)


def _rows(image: Image, section: _Section, form: str) -> Iterator[tuple[int, ...]]:
    row = struct.Struct(form)
    data = _content(image, section)
    yield from row.iter_unpack(data[: len(data) - len(data) % row.size])


def _symbol_list(image: Image, sections: list[_Section], section: _Section) -> Iterator[_Symbol]:
    if section.link >= len(sections):
        raise MalformedError("a table of symbols without names")
    names = _content(image, sections[section.link])
    for name, info, other, index, address, size in _rows(image, section, _SYMBOL):
        end = names.find(b"\0", name)
        yield _Symbol(
            name=names[name : max(name, end)].decode(errors="replace"),
            kind=info & 15,
            binding=info >> 4,
            visibility=other & 3,
            is_defined=index != 0,
            address=address,
            size=size,
        )


def _relocations(
    image: Image, sections: list[_Section], lists: Mapping[int, list[_Symbol]]
) -> Iterator[tuple[int, int, str, int]]:
    """(place, kind, symbol if it has one, addend) of each relocation."""
    for section in sections:
        if section.kind != _RELOCATIONS:
            continue
        symbols = lists.get(section.link, [])
        for place, info, addend in _rows(image, section, _RELOCATION):
            index = info >> 32
            name = symbols[index].name if 0 < index < len(symbols) else ""
            yield place, info & 0xFFFFFFFF, name, addend


def _functions(
    image: Image,
    table: _Symbol,
    slots: Mapping[int, tuple[str, int]],
    names: Mapping[int, set[str]],
) -> Iterator[frozenset[str]]:
    """The names of the function that each slot after the first two words points to."""
    for place in range(table.address + _HEAD, table.address + min(table.size, 1 << 12), _WORD):
        symbol, address = slots.get(place) or ("", _word(image, place))
        yield frozenset([symbol]) if symbol else frozenset(names.get(address, ()))


def _word(image: Image, address: int) -> int:
    """The word at that place in the file; a packed relative relocation adds the load address."""
    found: int = struct.unpack("<Q", image.at(image.offset(address), _WORD))[0]
    return found
