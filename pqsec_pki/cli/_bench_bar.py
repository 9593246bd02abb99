"""The progress bar of `pqsec bench`."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import click


@contextmanager
def bar(length: int, label: str) -> Iterator[Callable[[int], None]]:
    """On a terminal; the block calls the value with the number of steps that are done."""
    with click.progressbar(
        length=length, label=label, show_pos=True, file=sys.stderr, hidden=not sys.stderr.isatty()
    ) as shown:
        yield shown.update
