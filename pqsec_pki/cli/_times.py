"""Times for people: in the zone of this machine or of TZ, also through a pipe.

JSON, CSV and files are for programs, other machines and later: their times are in UTC. A pipe has
the lines of the terminal, as of `ls -l` or `git log`: who adds `| less` sees the same times.
"""

import re
from datetime import datetime, timedelta

from pqsec_pki._times import said
from pqsec_pki.cli import _settings

_SAID = re.compile(r"\b([0-9]{4}-[0-9]{2}-[0-9]{2} [0-9]{2}:[0-9]{2}(:[0-9]{2})?) UTC\b")
"""A time as `pqsec_pki._times` writes it."""
_SOON = timedelta(days=2)
_FOR_PROGRAMS = re.compile(r'("|^)([0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9:.]{8,15})\+00:00("|$)')


def local(text: str) -> str:
    """`text`, with its times in UTC in the zone of the reader: 2026-11-24 03:10 CET."""
    return _SAID.sub(_in_zone, text) if " UTC" in text else text  # most lines have none


def _in_zone(found: re.Match[str]) -> str:
    try:
        here = datetime.fromisoformat(f"{found[1]}+00:00").astimezone()
    except (ValueError, OverflowError, OSError):  # no such time, or the zone makes it year 10000
        return found[0]
    return f"{here:%Y-%m-%d %H:%M:%S %Z}" if found[2] else f"{here:%Y-%m-%d %H:%M %Z}"


def day(when: datetime) -> str:
    """The date in the reader's zone: 2026-11-24."""
    try:
        return f"{when.astimezone():%Y-%m-%d}"
    except (ValueError, OverflowError, OSError):
        return f"{when:%Y-%m-%d}"


def end(when: datetime) -> str:
    """The date at which something ends, with the minute if that is soon: 2026-11-24 03:10 CET."""
    return local(said(when)) if abs(when - _settings.now()) < _SOON else day(when)


def for_programs(text: str) -> str:
    """JSON, or the cell of a CSV: each time that is a whole value ends in Z, not in +00:00."""
    return _FOR_PROGRAMS.sub(r"\1\2Z\3", text) if "+00:00" in text else text
