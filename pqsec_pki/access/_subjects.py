"""Whether a grant is for a subject: how each stack compares two texts of a name.

The subject is always the RFC 2253 text of Certificate.subject_name: the last part of the
certificate's name comes first, and letters of all languages are not escaped.
"""

import re
from collections.abc import Callable
from functools import lru_cache
from typing import TypeAlias

from pqsec_pki.documents import Subject, parse_subject, same_subject
from pqsec_pki.errors import MalformedError

IsFor: TypeAlias = Callable[[str, str], bool]
"""Arguments: the text of a grant's subject_name, and a subject. Whether the grant is for it."""

_SPACE = " \t\r\n"
_MOST_PARTS = 20
"""The most parts that Cyclone DDS keeps; a name with more parts matches no participant."""


def standard(named: str, subject: str) -> bool:
    """9.4.1.3.2.1 does not define the form: any spelling of the whole name matches."""
    return same_subject(_parsed(named), _parsed(subject))


def cyclonedds(named: str, subject: str) -> bool:
    r"""ac_check_subjects_are_equal of 0.10.2 (measured).

    It splits both at each `,` `/` and `|`, and each piece at its first `=`. The grant must
    have all pieces that the certificate has, in any order, and may have more. So
    CN=/robot may use a grant for CN=/robot/admin.
    """
    return _has_pieces(named, subject, str)


def cyclonedds_11(named: str, subject: str) -> bool:
    """As 0.10, but spaces around a piece's name and value are ignored (11.0.1, measured)."""
    return _has_pieces(named, subject, lambda text: text.strip(" "))


def _has_pieces(named: str, subject: str, trimmed: Callable[[str], str]) -> bool:
    pieces = [piece for piece in _cut(named.strip(_SPACE)) if piece]
    wanted = _cut("".join(map(_escaped, subject)))
    if wanted[-1] == "":
        wanted.pop()  # empty text after the last separator is not a piece
    if len(pieces) > _MOST_PARTS or not all(wanted):
        return False
    values: dict[str, str] = {}
    for piece in pieces:
        word, _, value = piece.partition("=")
        values.setdefault(trimmed(word), trimmed(value))  # of two OUs, only the first counts
    asked = (piece.partition("=") for piece in wanted)
    return all(values.get(trimmed(word)) == trimmed(value) for word, _, value in asked)


def fastdds(named: str, subject: str) -> bool:
    """rfc2253_string_compare of 2.9.1: the same parts in the same order (measured).

    It ignores spaces around each part, but not line ends. 3.x also accepts the order of the
    certificate.
    """
    return _parts(named) == _parts(subject)


def opendds(named: str, subject: str) -> bool:
    r"""SubjectName::operator== (read in 3.34's source, and run): the certificate's order.

    It compares with the text that OpenSSL prints. So a letter beyond ASCII only matches as
    escaped octets, such as `\C3\B1`, never as the letter.
    """
    return named.isascii() and bool(_parsed(named)) and _parsed(named) == _parsed(subject)[::-1]


@lru_cache(maxsize=4096)
def _parsed(text: str) -> Subject:
    """Its parts; empty if it is not a subject name."""
    try:
        return parse_subject(text.strip(_SPACE))
    except MalformedError:
        return ()


def _parts(text: str) -> list[str]:
    return [part.strip(" ") for part in text.split(",")]


def _cut(text: str) -> list[str]:
    return re.split("[,/|]", text)


def _escaped(character: str) -> str:
    if character.isascii():
        return character
    return "".join(f"\\{octet:02X}" for octet in character.encode(errors="surrogatepass"))
