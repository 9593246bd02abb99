"""Whoever opens a keystore that somebody prepared changes nothing beside it, and nothing in it."""

import json
from contextlib import suppress

import pytest

from pqsec_pki.errors import PqsecError
from pqsec_pki.keystore import Keystore
from tests.unit.keystores import made


@pytest.fixture
def keystore(tmp_path):
    return made(tmp_path / "k", "classical")


def test_what_a_journals_spent_link_shows_is_not_zeroed(keystore, tmp_path):
    (tmp_path / "victim").mkdir()
    (tmp_path / "victim/file").write_bytes(b"precious")
    (keystore.root / ".journal").mkdir()
    (keystore.root / ".journal/moves.json").write_text(json.dumps({"targets": [], "entries": []}))
    (keystore.root / ".journal/spent").symlink_to(tmp_path / "victim")
    try:
        with suppress(PqsecError):
            Keystore.open(keystore.root)
        with suppress(PqsecError):
            Keystore.open(keystore.root, to_change=True)
    finally:
        assert (tmp_path / "victim/file").read_bytes() == b"precious"
