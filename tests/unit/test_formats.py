"""A list as CSV, for spreadsheets."""

import csv
from datetime import UTC, datetime
from pathlib import Path

import pytest

from pqsec_pki.cli._formats import as_csv


def read(value):
    """The cell that a reader of CSV gets for this value."""
    lines = list(as_csv(["name"], [{"name": value}]))
    assert all(line.isprintable() for line in lines)
    [[head], [cell]] = csv.reader(lines)
    assert head == "name"
    return cell


@pytest.mark.parametrize("begin", ["=", "+", "-", "@", "\t", "\r", "\n"])
def test_a_cell_that_a_spreadsheet_would_run_is_prefixed(begin):
    text = f'{begin}HYPERLINK("http://x","y")'
    assert read(text).startswith("'")
    assert read([text, "second"]).startswith("'")


@pytest.mark.parametrize("between", ["", '"', '""'])
@pytest.mark.parametrize("begin", ["=", "+", "-", "@"])
def test_a_cell_of_semicolons_begins_no_formula(between, begin):
    """A spreadsheet of many countries separates cells by semicolons, and takes it for several."""
    assert read(f"/a;{between}{begin}1;b") == f"/a;'{between}{begin}1;b"


def test_other_cells_are_as_they_were():
    for text in ("/talker", "a,b", 'say "=1"', "ü", "0-3", "", "' is kept", "a; --yes", "a;b"):
        assert read(text) == text


def test_values_are_written_as_json_has_them():
    assert read(None) == ""
    assert read(True) == "true"  # noqa: FBT003 -- a cell
    assert read(7) == "7"
    assert read(Path("k/x")) == "k/x"
    assert read(datetime(2026, 1, 2, tzinfo=UTC)) == "2026-01-02T00:00:00Z"
    assert read(("rt/a", "rt/b")) == "rt/a rt/b"
    assert read({"reason": "superseded"}) == '{"reason": "superseded"}'


def test_control_characters_and_line_ends_stay_in_their_line():
    assert read("a\nb\x1b[2J") == r"a\u000ab\u001b[2J"


def test_a_list_without_items_has_its_columns():
    assert list(as_csv(["a", "b"], [])) == ["a,b"]
