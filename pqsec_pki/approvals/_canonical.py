"""JSON as it is signed: by RFC 8785, for values without fractions; and read strictly.

Two readers of one text must not see two plans. So a name that appears twice in an object is
refused, and so are numbers that are not integers. A signature is over the canonical form of what
was read: blanks and line ends, which mail and git may change, do not matter.
"""

import hashlib
import json
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from typing import Any

from pqsec_pki.errors import MalformedError, PqsecError, shown

SHA256 = re.compile("[0-9a-f]{64}")


def canonical(value: object) -> bytes:
    """`value` in the form of RFC 8785; all names of objects are ASCII here."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return text.encode()


def digest_of(value: object) -> str:
    """SHA-256, in hex, of the canonical form."""
    return hashlib.sha256(canonical(value)).hexdigest()


def readable(value: object) -> bytes:
    """`value` as JSON with line breaks, for a file that people read."""
    text = json.dumps(value, sort_keys=True, indent=1, ensure_ascii=False)
    return text.encode() + b"\n"


def parsed(data: bytes) -> Any:
    """The value of the JSON text `data`; ValueError or RecursionError if it is not strict."""
    text = data.decode()
    value = json.loads(
        text, object_pairs_hook=_object, parse_float=_no_number, parse_constant=_no_number
    )
    if "\\u" in text:
        canonical(value)  # half a character has no form
    return value


@contextmanager
def reading(what: str) -> Iterator[None]:
    """What goes wrong with values from outside, as MalformedError."""
    wrong = ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError
    try:
        yield
    except (*wrong, PqsecError) as error:
        reason = f"it has no {error}" if isinstance(error, KeyError) else str(error)
        raise MalformedError(f"not {what} of pqsec: {shown(reason, 200)}") from error


def exactly(value: object, *names: str) -> Mapping[str, Any]:
    """The object, which must have these names and no others."""
    if not isinstance(value, dict):
        raise TypeError("an object is missing")
    if other := sorted(value.keys() - {*names}):
        raise ValueError(f"'{other[0]}' is not known here")
    return {name: value[name] for name in names}


def text(value: object) -> str:
    """A text that a terminal can show."""
    if not isinstance(value, str) or not value.isprintable():
        raise TypeError("a text is missing")
    return value


def sha256(value: object) -> str:
    """A SHA-256 in hex."""
    if not SHA256.fullmatch(text(value)):
        raise ValueError("a SHA-256 is missing")
    return text(value)


def whole(value: object) -> int:
    """An integer."""
    if type(value) is not int:
        raise TypeError("a number is missing")
    return value


def boolean(value: object) -> bool:
    """true or false."""
    if not isinstance(value, bool):
        raise TypeError("true or false is missing")
    return value


def items(value: object, reader: Callable[[object], Any]) -> tuple[Any, ...]:
    """The items of a list."""
    if not isinstance(value, list):
        raise TypeError("a list is missing")
    return tuple(map(reader, value))


def time(value: object) -> datetime:
    """A time in UTC."""
    found = datetime.fromisoformat(text(value))
    if found.utcoffset() != timedelta(0):
        raise ValueError("a time that is not in UTC")
    return found.astimezone(UTC)


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a name appears twice in an object")
    return found


def _no_number(found: str) -> Any:
    raise ValueError(f"{found[:20]} is not an integer")
