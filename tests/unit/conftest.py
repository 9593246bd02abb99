"""Places for keystores that are made and killed by the hundred."""

import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.unit.killing import create, issue_to


@pytest.fixture(scope="module")
def memory(tmp_path_factory) -> Iterator[Path]:
    """A folder in memory where there is such: durability takes time, and is not tested here."""
    shared = Path("/dev/shm")
    if not os.access(shared, os.W_OK):
        yield tmp_path_factory.mktemp("disk")
        return
    with tempfile.TemporaryDirectory(dir=shared) as folder:
        yield Path(folder)


@pytest.fixture
def place(memory) -> Iterator[Path]:
    """An empty folder."""
    with tempfile.TemporaryDirectory(dir=memory) as folder:
        yield Path(folder)


@pytest.fixture(scope="module")
def prepared(memory) -> Callable[[tuple[str, ...]], Path]:
    """prepared(names) is a keystore with these participants, made once."""
    made: dict[tuple[str, ...], Path] = {}

    def make(names: tuple[str, ...]) -> Path:
        if names not in made:
            root = memory / f"prepared{len(made)}"
            create(root)
            if names:
                issue_to(root, *names)
            made[names] = root
        return made[names]

    return make
