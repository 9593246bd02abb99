"""Certificate subjects as text: parses them, and compares two spellings.

A permissions document names its participant by the subject of the identity certificate, in a
text form that the standard does not define (9.4.1.3.2.1). Four forms are in use: RFC 2253
(`CN=x,O=Lab,C=ES`, last part first), the order of the certificate, both of these with spaces
after the commas, and OpenSSL's `/C=ES/O=Lab/CN=x`.
"""

import re
from collections.abc import Iterable
from typing import TypeAlias

from pqsec_pki.errors import MalformedError, shown

Subject: TypeAlias = tuple[frozenset[tuple[str, str]], ...]
"""The parts (RDNs) in the order of the text; each is a set, mostly of one, of (type, value)."""

MAX_SUBJECT = 4096
"""Characters. Subject names of real certificates are much shorter."""

_SPACE = " \t\r\n"
_TYPE = r"(?P<type>[A-Za-z][A-Za-z0-9_-]*+|\d++(?:\.\d++)++)\s*+=\s*+"
_COMMA_PART = re.compile(
    rf'\s*+{_TYPE}(?:"(?P<quoted>(?:[^"\\]|\\.)*+)"\s*+|(?P<plain>(?:[^,+"\\]|\\.)*+))(?P<end>[,+]|\Z)',
    re.DOTALL | re.ASCII,
)
# The expressions below are for few names: they are compiled when one is read.
_SLASH_PART = rf"(?as)\s*+{_TYPE}(?P<value>.*)"
# A slash starts a part only if a type and "=" follow: CN=/ns/node is one part.
_SLASH = r"(?a)(?<!\\)/(?=\s*+[A-Za-z0-9][A-Za-z0-9.-]*+\s*+=)"
_DER_FORM = r"#(?:[0-9A-Fa-f]{2})+[ \t\r\n]*"
_COMMA_FORM = r"(?s)\\(?P<byte>[0-9A-Fa-f]{2})|\\(?P<char>.)|(?P<raw>.)"
_SLASH_FORM = r"(?s)\\x(?P<byte>[0-9A-Fa-f]{2})|\\(?P<char>/)|(?P<raw>.)"


def parse_subject(text: str) -> Subject:
    """The parts of the name, in the order of the text. MalformedError if it is not a name.

    Types keep their case and spelling: no stack accepts `cn=` or `2.5.4.3=` as `CN=`.
    """
    if len(text) > MAX_SUBJECT:
        raise MalformedError(f"longer than {MAX_SUBJECT} characters, so not a subject name")
    try:
        return _slash_form(text) if text.lstrip(_SPACE).startswith("/") else _comma_form(text)
    except UnicodeError:
        raise _no_subject(text) from None


def same_subject(one: Subject, other: Subject) -> bool:
    """Whether both are the same name, in the same or in reverse order.

    All parts must be equal: a name with fewer parts, which Cyclone DDS would accept, is a
    different name.
    """
    return bool(one) and (one == other or one == other[::-1])


def _comma_form(text: str) -> Subject:
    parts: list[frozenset[tuple[str, str]]] = []
    joined: set[tuple[str, str]] = set()
    place, end = 0, ","
    while end:
        found = _COMMA_PART.match(text, place)
        if not found or not _is_readable(found["type"], found["plain"] or ""):
            raise _no_subject(text)
        joined.add((found["type"], _comma_value(found)))
        place, end = found.end(), found["end"]
        if end != "+":
            parts.append(frozenset(joined))
            joined = set()
    return tuple(parts)


def _is_readable(kind: str, plain: str) -> bool:
    """A value that begins with # is in DER: OpenSSL writes those of unknown types, and bits, so."""
    if not plain.startswith("#"):
        return True
    is_dumped = kind[0].isdigit() or plain.startswith("#03")
    return is_dumped and bool(re.fullmatch(_DER_FORM, plain))


def _comma_value(found: re.Match[str]) -> str:
    if found["quoted"] is not None:
        return _unescaped(re.finditer(_COMMA_FORM, found["quoted"]))
    plain = found["plain"]
    if plain.startswith("#"):
        return plain.rstrip(_SPACE).upper()
    if plain.isascii() and "\\" not in plain:  # so with nearly all names
        return plain.rstrip(_SPACE)
    characters = list(re.finditer(_COMMA_FORM, plain))
    while characters and characters[-1][0] in _SPACE:  # an escaped space is part of the value
        characters.pop()
    return _unescaped(characters)


def _slash_form(text: str) -> Subject:
    before, *parts = re.split(_SLASH, text.strip(_SPACE))
    found = [re.fullmatch(_SLASH_PART, part) for part in parts]
    if before or not found or None in found:
        raise _no_subject(text)
    return tuple(
        frozenset({(part["type"], _slash_value(part["value"].rstrip(_SPACE)))})
        for part in found
        if part
    )


def _slash_value(text: str) -> str:
    return _unescaped(re.finditer(_SLASH_FORM, text))


def _unescaped(characters: Iterable[re.Match[str]]) -> str:
    return b"".join(
        bytes.fromhex(found["byte"]) if found["byte"] else (found["char"] or found["raw"]).encode()
        for found in characters
    ).decode()


def _no_subject(text: str) -> MalformedError:
    return MalformedError(
        f"'{shown(text)}' is not a subject name", hint="write it as in CN=x,O=Lab,C=ES"
    )
