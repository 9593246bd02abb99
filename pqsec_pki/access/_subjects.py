"""Is a grant for this subject? How each stack compares two texts of a name.

The subject is always the text of RFC 2253 that Certificate.subject_name gives: the last
part of the certificate's name first, letters of every language as they are.
"""

import re
from collections.abc import Callable
from functools import lru_cache
from typing import TypeAlias

from pqsec_pki.documents import Subject, parse_subject, same_subject
from pqsec_pki.errors import MalformedError

IsFor: TypeAlias = Callable[[str, str], bool]
"""Whether the text of a grant's subject_name is for a subject, in that order."""

_MOST_PARTS = 20
"""The most that Cyclone DDS keeps; a name with more of them matches no participant."""


def standard(named: str, subject: str) -> bool:
    """9.4.1.3.2.1 leaves the form open: any spelling of the whole name will do."""
    return same_subject(_parsed(named), _parsed(subject))


def cyclonedds(named: str, subject: str) -> bool:
    r"""ac_check_subjects_are_equal, 0.10.2 to 11.0.1 (measured).

    Both are cut at each `,` `/` and `|`, and each piece at its first `=`: the grant must
    have all pieces that the certificate has, in any order, and may have more. So
    CN=/robot may use a grant for CN=/robot/admin.
    """
    pieces = [piece for piece in _cut(named) if piece]
    if len(pieces) > _MOST_PARTS:
        return False
    values: dict[str, str] = {}
    for piece in pieces:
        word, _, value = piece.partition("=")
        values.setdefault(word, value)  # of two OUs only the first is ever seen
    wanted = _cut("".join(map(_escaped, subject)))
    if wanted[-1] == "":
        wanted.pop()  # nothing after the last separator is no piece
    return all(piece and _has(values, piece) for piece in wanted)


def fastdds(named: str, subject: str) -> bool:
    """rfc2253_string_compare of 2.9.1: the same parts in the same order (measured).

    Spaces around commas do not count. 3.x also takes the order of the certificate.
    """
    return _parts(named) == _parts(subject)


def opendds(named: str, subject: str) -> bool:
    r"""SubjectName::operator== (read in 3.34's source, and run): the certificate's order.

    It compares with what OpenSSL prints, so that of letters beyond ASCII only octets such as
    `\C3\B1` match, never the letters themselves.
    """
    return named.isascii() and bool(_parsed(named)) and _parsed(named) == _parsed(subject)[::-1]


@lru_cache(maxsize=4096)
def _parsed(text: str) -> Subject:
    """Its parts; empty if it is not a subject name."""
    try:
        return parse_subject(text)
    except MalformedError:
        return ()


def _parts(text: str) -> list[str]:
    return [part.strip(" ") for part in text.split(",")]


def _cut(text: str) -> list[str]:
    return re.split("[,/|]", text)


def _has(values: dict[str, str], piece: str) -> bool:
    word, _, value = piece.partition("=")
    return values.get(word) == value


def _escaped(character: str) -> str:
    if character.isascii():
        return character
    return "".join(f"\\{octet:02X}" for octet in character.encode(errors="surrogatepass"))
