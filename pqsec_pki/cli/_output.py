"""Standard streams whose reader may leave, as `head` does: then pqsec ends without a word.

The signal SIGPIPE stays ignored, as Python starts. It also comes when a server closes a
connection, and that is an error, which is reported.
"""

import io
import os
import signal
import sys
from contextlib import suppress
from typing import NoReturn, TextIO


class ReaderGoneError(BaseException):
    """Nobody reads the output. Only `main` handles it, and what is open is closed on the way."""


class _Output(io.FileIO):
    """A standard stream that raises ReaderGoneError once, and then discards what is written."""

    def write(self, data: object) -> int:
        try:
            return super().write(data)  # type: ignore[arg-type] # typed as the base class, for octets
        except BrokenPipeError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.fileno())  # Python flushes again at exit
            os.close(nowhere)
            raise ReaderGoneError from None


_own: list[TextIO] = []
"""The stderr that `watch` replaced."""


def watch() -> None:
    """From now on a write to a stream without a reader raises ReaderGoneError."""
    _own[:] = [sys.stderr]
    sys.stdout, sys.stderr = _watched(sys.stdout), _watched(sys.stderr)


def stay() -> None:
    """Undo `watch` for stderr: a server goes on if nobody reads its log."""
    if _own:
        sys.stderr = _own.pop()


def end() -> NoReturn:
    """End this process by SIGPIPE, which a shell knows as exit code 141."""
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    os.kill(os.getpid(), signal.SIGPIPE)
    sys.exit(128 + signal.SIGPIPE)


def _watched(stream: TextIO) -> TextIO:
    """The stream with an `_Output` below it; itself if it is not a file of the system."""
    if not isinstance(stream, io.TextIOWrapper):
        return stream
    raw = getattr(stream.buffer, "raw", stream.buffer)
    if not isinstance(raw, io.FileIO):
        return stream
    with suppress(ReaderGoneError):
        stream.flush()
    return io.TextIOWrapper(
        io.BufferedWriter(_Output(raw.fileno(), "w", closefd=False)),
        encoding=stream.encoding,
        errors=stream.errors,
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )
