"""A bill of materials of files and folders; the library for CycloneDX is loaded when needed."""

from collections.abc import Iterable
from dataclasses import field
from datetime import datetime
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._libraries import needs_libraries


@dataclass(frozen=True, slots=True)
class Unread:
    """A file, or a part of one, that is missing in a bill."""

    path: Path
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Bill:
    """A bill of materials, and what it lacks."""

    document: str = field(repr=False)
    """CycloneDX 1.7 in JSON, with a final newline."""
    counts: dict[str, int]
    """Number of components by CycloneDX's assetType."""
    unread: tuple[Unread, ...]
    """What could not be read, by path."""


def bill_of(paths: Iterable[Path], *, now: datetime, timestamp: datetime | None = None) -> Bill:
    """The bill of all files below `paths`. The same files give the same bytes.

    `now` is for reading only. `timestamp` is written into the bill if given, and is not part of
    its serial number, which is derived from the content. FileError if a path does not exist;
    PqsecError if the library for CycloneDX is not installed.
    """
    with needs_libraries("the library for CycloneDX is not installed"):
        from pqsec_pki.cbom import _document, _reading  # noqa: PLC0415 -- an extra of the package
    named = tuple(paths)
    assets, unread = _reading.read_assets(named, now)
    subject = ", ".join(
        dict.fromkeys(_reading.text_of(Path(path.resolve().name or "/")) for path in named)
    )
    return Bill(
        document=_document.written(assets, subject, timestamp),
        counts=assets.counts,
        unread=tuple(
            Unread(path, reason) for path, reason in sorted(unread, key=lambda each: str(each[0]))
        ),
    )
