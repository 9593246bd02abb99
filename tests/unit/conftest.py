"""Places for keystores that are made and killed by the hundred; umasks."""

import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.unit import killing
from tests.unit.domains import Scene
from tests.unit.killing import create, issue_to


@pytest.fixture(params=[0o000, 0o022, 0o077], ids=lambda mask: f"umask {mask:03o}")
def umask(request) -> Iterator[int]:
    """Each umask that is usual somewhere."""
    before = os.umask(request.param)
    yield request.param
    os.umask(before)


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


@pytest.fixture
def links_count_too(monkeypatch):
    """For changes that hold an old key by a link until it is overwritten."""
    monkeypatch.setattr(killing, "CALLS", (*killing.CALLS, "link"))


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


@pytest.fixture(scope="session")
def applied_domain(tmp_path_factory) -> Scene:
    """The domain file of tests/unit/domains.py, applied."""
    made = Scene(tmp_path_factory.mktemp("applied"))
    made.apply()
    return made


@pytest.fixture
def scene(applied_domain, tmp_path) -> Scene:
    """The same, for this test alone."""
    return Scene.copy(applied_domain, tmp_path)
