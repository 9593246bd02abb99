"""Rows of other installed packages, loaded when their names are asked for (ADR 21)."""

import re
from collections.abc import Iterable, Iterator
from dataclasses import fields, is_dataclass
from importlib.metadata import EntryPoint
from typing import Any, get_args, get_origin

from pqsec_pki._asn1 import Oid
from pqsec_pki._packages import fault, foreign_errors, package_of
from pqsec_pki.errors import shown

_OWN = ("name", "wire_name", "token_name", "key_oid", "identifier")
"""Attributes that no two rows may share; a key agreement has the first two."""
_NAME = re.compile(r"[A-Za-z0-9+_.-]{1,63}")
"""Names on the wire are joined with `+` and end with NUL; people write lists with commas."""
_PREFIX = "id-"
"""A prefix that a table removes from a name before it looks for a row."""
_MOST_BYTES = 1 << 24
"""Octets of a key, ciphertext or signature; the largest published keys (Classic McEliece) have 1.3
MB."""
_TOP_LEVEL = 5
"""NIST's highest security category."""


def load(entry: EntryPoint, row_type: type[Any], known: Iterable[Any]) -> Any:
    """The row of `entry`.

    ForeignPackageError if it fails or ends the process, is not of class `row_type`, has attributes
    of other types, or shares a name with a known row.
    """
    words = f"the package {package_of(entry)} cannot add {entry.name!r}"
    with foreign_errors(words):
        row = entry.load()
        wrong = next(_faults(entry, row, row_type, known), None)
    if wrong:
        raise fault(words, wrong)
    return row


def _faults(
    entry: EntryPoint, row: Any, row_type: type[Any], known: Iterable[Any]
) -> Iterator[str]:
    """What is wrong with the row; after the first, others may fail."""
    if not isinstance(row, row_type):
        yield f"{entry.value} is not a {row_type.__name__}"
    yield from _mistyped(row, row_type)
    if row.name != entry.name.lower():
        yield f"its row has the name {row.name!r}"
    if row.name.startswith(_PREFIX):
        yield f"its name begins with {_PREFIX!r}, which pqsec removes before it looks for a name"
    yield from _out_of_range(row, row_type)
    for other in known:
        names = {row.name, *row.aliases} & {other.name, *other.aliases}
        shared = [each for each in _OWN if hasattr(row, each) and _same(row, other, each)]
        if names or shared:
            yield f"it would replace {other.name} ({', '.join(shared) or 'alias'})"


def _out_of_range(row: Any, row_type: type[Any]) -> Iterator[str]:
    """Names, numbers and an OID that have the right types only; raises TypeError without a hash."""
    for each in (row.name, *row.aliases, row.wire_name, getattr(row, "token_name", row.name)):
        if not _NAME.fullmatch(each):
            yield f"the name '{shown(each)}' is not 1 to 63 letters, digits or any of +_.-"
    if not 0 <= row.level <= _TOP_LEVEL:
        yield f"its level is not from 0 to {_TOP_LEVEL}"
    for field in fields(row_type):
        if field.name.endswith("_size") and not 1 <= getattr(row, field.name) <= _MOST_BYTES:
            yield f"its {field.name} is not from 1 to {_MOST_BYTES}"
    if hasattr(row, "key_oid"):
        Oid(row.key_oid)
    hash(row)


def _mistyped(value: Any, kind: type[Any]) -> Iterator[str]:
    """Each field of the dataclass `kind` for which `value` has something else than it declares."""
    for field in fields(kind):
        found = getattr(value, field.name)
        declared: Any = field.type
        elements, whole = get_args(declared), get_origin(declared)
        if whole not in (tuple, frozenset):
            elements, whole = (), declared
        if not isinstance(found, whole) or isinstance(found, bool):
            yield f"its {field.name} is not a {getattr(whole, '__name__', whole)}"
        elif elements and not all(isinstance(each, elements[0]) for each in found):
            yield f"its {field.name} has an element that is not a {elements[0].__name__}"
        elif isinstance(declared, type) and is_dataclass(declared):
            yield from _mistyped(found, declared)


def _same(row: Any, other: Any, attribute: str) -> bool:
    return bool(getattr(row, attribute) == getattr(other, attribute))
