"""Limits what a connection writes to the agent's log.

A peer on the network can cause any number of refusals, and vary their text. It must not push
other messages out of the log.
"""

from collections.abc import Callable
from datetime import datetime, timedelta
from typing import TypeAlias

Clock: TypeAlias = Callable[[], datetime]
Log: TypeAlias = Callable[[str], None]

WINDOW = timedelta(minutes=1)
MOST = 30
"""Lines of one connection within WINDOW."""


class Notes:
    """Writes equal lines at most once per WINDOW, and how many were left out."""

    def __init__(self, who: str, log: Log, clock: Clock) -> None:
        self._who, self._log, self._now = who, log, clock
        self._since = clock()
        self._said: set[str] = set()
        self._left_out = 0

    def add(self, line: str) -> None:
        """Write it, unless the same line or MOST others were written within WINDOW."""
        if abs(self._now() - self._since) > WINDOW:
            self.finish()
        if line in self._said or len(self._said) >= MOST:
            self._left_out += 1
            return
        self._said.add(line)
        self._log(f"{self._who}: {line}")
        if len(self._said) == MOST:
            self._log(f"{self._who}: further lines of this minute are counted, not written")

    def finish(self) -> None:
        """Write how many lines were left out, and start a new WINDOW."""
        if self._left_out:
            since = f"{self._since:%H:%M:%S}"
            self._log(f"{self._who}: {self._left_out} lines like these were left out since {since}")
        self._since, self._left_out = self._now(), 0
        self._said.clear()
