"""Times as text, in UTC. The command line shows those of messages in the zone of its reader.

A message may end as JSON, in a log or in a file, which are in UTC; so a room never uses a zone.
"""

import re
from collections.abc import Mapping
from datetime import datetime, timedelta

UNITS = {"y": timedelta(365), "w": timedelta(7), "d": timedelta(1), "h": timedelta(hours=1)}


def said(when: datetime) -> str:
    """For people, to the minute: 2026-11-24 02:10 UTC."""
    return f"{when:%Y-%m-%d %H:%M} UTC"


def exact(when: datetime) -> str:
    """For people, to the second: 2026-11-24 02:10:00 UTC."""
    return f"{when:%Y-%m-%d %H:%M:%S} UTC"


def days(length: timedelta) -> str:
    """For people: 90 days, or 0.5 days."""
    return f"{length / timedelta(days=1):g} days"


def duration(text: str, units: Mapping[str, timedelta] = UNITS) -> timedelta | None:
    """Such as 10y or 90d, in these units; a year has 365 days. None for other texts."""
    found = re.fullmatch(r"([1-9][0-9]{0,5})([a-z])", text)
    return int(found[1]) * units[found[2]] if found and found[2] in units else None


def rfc3339(when: datetime, *, timespec: str = "seconds") -> str:
    """For programs: 2026-11-24T02:10:00Z."""
    return f"{when.replace(tzinfo=None).isoformat(timespec=timespec)}Z"
