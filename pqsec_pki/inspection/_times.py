"""Describes times: when something is valid, and how long it remains valid."""

from datetime import datetime, timedelta

from pqsec_pki._times import exact
from pqsec_pki.inspection.description import Fact, Value

_UNITS = (
    ("day", timedelta(days=1)),
    ("hour", timedelta(hours=1)),
    ("minute", timedelta(minutes=1)),
)


def span(length: timedelta) -> str:
    """A length of time in its largest whole unit: 3 days, 1 hour."""
    for unit, size in _UNITS:
        if count := length // size:
            return f"{count} {unit}" if count == 1 else f"{count} {unit}s"
    return "less than a minute"


def standing(not_before: datetime, not_after: datetime, now: datetime) -> str:
    """The state of that validity at `now`: 364 days left, expired 3 days ago."""
    if not_before > not_after:
        return "never valid: it ends before it starts"
    if now < not_before:
        return f"not valid yet: starts in {span(not_before - now)}"
    if now > not_after:
        return f"expired {span(now - not_after)} ago"
    return f"{span(not_after - now)} left"


def window(not_before: datetime, not_after: datetime, now: datetime) -> str:
    """The validity as one line of text."""
    where = standing(not_before, not_after, now)
    return f"{exact(not_before)} to {exact(not_after)} ({where})"


def window_value(not_before: datetime, not_after: datetime, now: datetime) -> dict[str, Value]:
    """The validity as a JSON value."""
    return {
        "not_before": not_before.isoformat(),
        "not_after": not_after.isoformat(),
        "valid_now": not_before <= now <= not_after,
        "state": standing(not_before, not_after, now),
    }


def validity(not_before: datetime, not_after: datetime, now: datetime) -> Fact:
    """The validity as a fact."""
    value = window_value(not_before, not_after, now)
    return Fact.of("validity", value, window(not_before, not_after, now))
