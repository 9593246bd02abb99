"""Reads the elements of a valid document as Python values.

The document was validated against its schema. Only values that the schema allows but Python
cannot represent are refused here: InvalidDocumentError with the line.
"""

import re
from datetime import UTC, datetime, timedelta, timezone
from typing import TYPE_CHECKING

from pqsec_pki.documents._xml import problem
from pqsec_pki.documents.domains import MAX_DOMAIN_ID, DomainRange, DomainSet
from pqsec_pki.errors import InvalidDocumentError, shown

if TYPE_CHECKING:
    from lxml.etree import _Element

_INSTANT = (
    r"(?a)(?P<year>-?\d{4,})-(?P<rest>\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.\d+)?"
    r"(?:Z|(?P<sign>[+-])(?P<hours>\d\d):(?P<minutes>\d\d))?"
)
_XML_SPACE = " \t\r\n"
_OCTAL = "01234567"


def line(element: "_Element") -> int | None:
    """The line of the element in its document."""
    found: int | None = element.sourceline  # type: ignore[assignment] # lxml-stubs has no type
    return found


def text(element: "_Element") -> str:
    """The text of an element without children."""
    return element.text or ""


def boolean(element: "_Element") -> bool:
    """An xs:boolean, whose values are true, false, 1 and 0."""
    return text(element).strip(_XML_SPACE) in {"true", "1"}


def texts(element: "_Element") -> tuple[str, ...]:
    """The texts of its children."""
    return tuple(map(text, element))


def domains(element: "_Element") -> DomainSet:
    """A list of ids and ranges (9.4.1.2); a range without min starts at 0."""
    return DomainSet(
        parts=tuple(
            _domain_range(part) if part.tag == "id_range" else _domain_id(part) for part in element
        )
    )


def _domain_range(element: "_Element") -> DomainRange:
    ends = {end.tag: _domain_id(end) for end in element}
    return DomainRange(first=ends.get("min", 0), last=ends.get("max"), no_min="min" not in ends)


def _domain_id(element: "_Element") -> int:
    written = text(element).strip(_XML_SPACE).lstrip("+-")
    digits = written.lstrip("0") or "0"
    if written != digits and not (len(digits) == 1 and digits in _OCTAL):
        words = f"readers differ: {shown(written, 20)} is octal for Cyclone DDS"
        raise _refused(element, f"{words}; write {shown(digits, 20)}")
    if len(digits) > len(str(MAX_DOMAIN_ID)) or int(digits) > MAX_DOMAIN_ID:
        raise _refused(
            element, f"{shown(digits, 20)} is not a domain id: it is above {MAX_DOMAIN_ID}"
        )
    return int(digits)


def instant(element: "_Element") -> datetime:
    """An xs:dateTime in its zone; without a zone it is in UTC (9.4.1.3.2.2).

    A fraction of a second is dropped: only OpenDDS reads it.
    InvalidDocumentError for years outside 1 to 9999, and for 24:00:00.
    """
    value = text(element).strip(_XML_SPACE)
    try:
        return _instant(value)
    except (ValueError, OverflowError):
        reason = "is not a time between the years 1 and 9999, written with hours 00 to 23"
        raise _refused(element, f"{shown(value)} {reason}") from None


def _instant(value: str) -> datetime:
    found = re.fullmatch(_INSTANT, value)
    next_day = "T24" in value  # which fromisoformat reads since Python 3.14
    if not found or len(found["year"]) > len("9999") or next_day:
        raise ValueError(value)
    local = datetime.fromisoformat(f"{found['year']}-{found['rest']}")
    if not found["sign"]:
        return local.replace(tzinfo=UTC)
    offset = timedelta(hours=int(found["hours"]), minutes=int(found["minutes"]))
    found_in = local.replace(tzinfo=timezone(-offset if found["sign"] == "-" else offset))
    found_in.astimezone(UTC)  # OverflowError if it is not in these years there
    return found_in


def _refused(element: "_Element", message: str) -> InvalidDocumentError:
    return InvalidDocumentError([problem(element, message)])
