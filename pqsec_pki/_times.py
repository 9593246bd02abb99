"""Times as text, in UTC. The command line shows those of messages in the zone of its reader.

A message may end as JSON, in a log or in a file, which are in UTC; so a room never uses a zone.
"""

from datetime import datetime


def said(when: datetime) -> str:
    """For people, to the minute: 2026-11-24 02:10 UTC."""
    return f"{when:%Y-%m-%d %H:%M} UTC"


def exact(when: datetime) -> str:
    """For people, to the second: 2026-11-24 02:10:00 UTC."""
    return f"{when:%Y-%m-%d %H:%M:%S} UTC"


def rfc3339(when: datetime, *, timespec: str = "seconds") -> str:
    """For programs: 2026-11-24T02:10:00Z."""
    return f"{when.replace(tzinfo=None).isoformat(timespec=timespec)}Z"
