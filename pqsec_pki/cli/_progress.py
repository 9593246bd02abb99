"""One line on stderr of a terminal while a command works, from the first second on.

A timer draws it for every command, also for one that waits for something else and counts nothing.
It goes before anything else is printed or asked.
"""

import os
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import click

from pqsec_pki._progress import Stage, current

_FIRST, _NEXT = 1.0, 0.5
"""Seconds until the line is shown, and until it is drawn again."""
_ERASE = b"\r\x1b[K"


class _Line:
    since = 0.0
    """When the command began, or its user last read something."""
    hidden = 0
    """The number of blocks that hide the line."""
    is_drawn = False


@contextmanager
def shown() -> Iterator[None]:
    """Show the line while the block runs, if stderr is a terminal that can erase it."""
    if not sys.stderr.isatty() or os.environ.get("TERM", "") in {"", "dumb"}:
        yield
        return
    _Line.since = time.monotonic()
    signal.signal(signal.SIGALRM, _draw)
    signal.siginterrupt(signal.SIGALRM, False)  # noqa: FBT003 -- it has no name: libraries go on
    signal.setitimer(signal.ITIMER_REAL, _FIRST, _NEXT)
    try:
        yield
    finally:
        stop()


def stop() -> None:
    """Show it no longer: a server runs until it is ended, a pager has the terminal."""
    signal.setitimer(signal.ITIMER_REAL, 0)
    _erase()


@contextmanager
def hidden() -> Iterator[None]:
    """Without the line, for what is printed or asked; then the seconds begin again."""
    _Line.hidden += 1
    _erase()
    try:
        yield
    finally:
        _Line.hidden -= 1
        _Line.since = time.monotonic()


def _draw(*_: object) -> None:
    """Called between any two steps of Python: it writes past Python's buffers, and never fails."""
    seconds = time.monotonic() - _Line.since
    with suppress(OSError):
        if _Line.hidden or seconds < _FIRST or _in_background():
            return
        text = said(_command(), current(), seconds)[: shutil.get_terminal_size().columns - 1]
        _Line.is_drawn = True
        os.write(2, _ERASE + text.encode())


def _in_background() -> bool:
    """Whether the shell has the terminal, or another job of it."""
    try:
        return os.tcgetpgrp(2) != os.getpgrp()
    except OSError:  # not the terminal of this session
        return False


def _erase() -> None:
    if _Line.is_drawn:
        _Line.is_drawn = False
        with suppress(OSError):
            os.write(2, _ERASE)


def _command() -> str:
    context = click.get_current_context(silent=True)
    return context.command_path if context else "pqsec"


def said(command: str, stage: Stage | None, seconds: float) -> str:
    """Such as "pqsec issue: 120 of 1000, 12 s"."""
    done = f"{stage.done} of {stage.total} {stage.what}".rstrip() + ", " if stage else ""
    return f"{command}: {done}{seconds:.0f} s"
