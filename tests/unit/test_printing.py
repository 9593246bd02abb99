"""What commands print with --json: values of rooms, by one encoder."""

import json
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import pytest

from pqsec_pki.cli import _printing
from pqsec_pki.cli._printing import JSON_VERSION, as_json, table


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


WORDS = "one two three four five six seven eight nine ten"
ROWS = [("/talker", WORDS, "   7", WORDS), ("/listener", "one", "  12", "two")]


@pytest.mark.parametrize("columns", [60, 80, 110])
def test_the_widest_columns_of_a_table_are_wrapped_until_it_fits(monkeypatch, columns):
    monkeypatch.setattr(_printing, "_room", lambda: columns)
    lines = table(("name", "has", "number", "may"), ROWS)
    assert max(map(len, lines)) <= columns
    assert len({line.index("7") for line in lines if "   7" in line}) == 1
    assert " ".join(lines).split().count("seven") == 2
    assert [line.split()[0] for line in lines if line[0] == "/"] == ["/talker", "/listener"]


def test_a_table_that_cannot_be_as_narrow_keeps_its_words(monkeypatch):
    wide = table(("name", "has", "number", "may"), ROWS)
    assert len(wide) == 3
    monkeypatch.setattr(_printing, "_room", lambda: 10)
    narrow = table(("name", "has", "number", "may"), ROWS)
    assert sorted(" ".join(narrow).split()) == sorted(" ".join(wide).split())
