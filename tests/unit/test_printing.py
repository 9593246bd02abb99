"""What commands print with --json: values of rooms, by one encoder."""

import json
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import pytest

from pqsec_pki.cli._printing import JSON_VERSION, as_json


@dataclass(frozen=True)
class Key:
    name: str
    private: bytes = field(default=b"secret", repr=False)


@dataclass(frozen=True)
class Named:
    hidden: bytes = b"secret"

    def to_json(self):
        return {"keys": (Key("a"), Key("b"))}


def test_values_of_rooms_are_written_as_objects_without_what_their_repr_leaves_out():
    value = {
        "one": Key("a"),
        "all": (each for each in (Named(),)),
        "at": datetime(2026, 1, 2, tzinfo=UTC),
        "path": Path("k/public"),
        "names": frozenset({"/a"}),
    }
    assert json.loads(as_json(value)) == {
        "version": JSON_VERSION,
        "one": {"name": "a"},
        "all": [{"keys": [{"name": "a"}, {"name": "b"}]}],
        "at": "2026-01-02T00:00:00Z",
        "path": "k/public",
        "names": ["/a"],
    }


@pytest.mark.parametrize("value", [b"secret", object()])
def test_what_has_no_form_in_json_is_not_guessed(value):
    with pytest.raises(TypeError, match="no form in JSON"):
        as_json({"value": value})
