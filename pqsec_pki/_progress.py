"""How far a long operation is. Rooms count; the command line shows it on a terminal."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from pqsec_pki._dataclass import dataclass

Item = TypeVar("Item")


@dataclass(slots=True)
class Stage:
    """So many of one kind are to be done."""

    total: int
    what: str = ""
    """In the plural: participants."""
    done: int = 0

    def add(self, count: int) -> None:
        """So many more are done."""
        self.done = min(self.total, self.done + count)

    def reach(self, count: int) -> None:
        """So many are done at least."""
        self.done = max(self.done, count)


class _Now:
    stage: Stage | None = None
    """The stage of the whole process, which has one terminal."""


def current() -> Stage | None:
    """What is being done."""
    return _Now.stage


@contextmanager
def stage(total: int, what: str = "") -> Iterator[Stage]:
    """Tell the block's value what is done. Within another stage it is that one, which counts."""
    if _Now.stage:
        yield _Now.stage
        return
    made = _Now.stage = Stage(total, what)
    try:
        yield made
    finally:
        _Now.stage = None


def counted(items: Iterable[Item], total: int, what: str = "", *, each: int = 1) -> Iterator[Item]:
    """The items; after each, `each` more of `total` are done."""
    with stage(total, what) as here:
        for item in items:
            yield item
            here.add(each)
