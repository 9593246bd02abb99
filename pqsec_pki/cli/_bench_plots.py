"""`pqsec bench --plot`: the folder of plots."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from pqsec_pki._files import disk_errors, refuse_existing, write
from pqsec_pki.benchmark import refuse_without_library

Draw = Callable[[Callable[[], Mapping[str, bytes]]], None]
"""Writes what its argument draws, by file name."""


@contextmanager
def plots(folder: Path | None, names: Sequence[str], *, force: bool) -> Iterator[Draw]:
    """A function that writes plots into the folder, which exists before measurements begin.

    PqsecError without the library, ExistsError for a plot that is there already.
    """
    if folder is None:
        yield lambda _: None
        return
    refuse_without_library()
    for name in names:
        if not force:
            refuse_existing(folder / name)
    with disk_errors(folder):
        is_new = not folder.exists()
        folder.mkdir(parents=True, exist_ok=True)
    try:
        yield lambda drawn: _write(folder, drawn(), force=force)
    except BaseException:
        if is_new:
            with suppress(OSError):  # something is in it
                folder.rmdir()
        raise


def _write(folder: Path, drawn: Mapping[str, bytes], *, force: bool) -> None:
    for name, content in drawn.items():
        write(folder / name, content, force=force)
