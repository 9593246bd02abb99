"""docs/reference/rfc7030.md: the tests that it names are there, and it names all of them."""

import re

import pytest

from tests.docs.reference_pages import ROOT

PAGE = (ROOT / "docs/reference/rfc7030.md").read_text()
ROWS = [line.split(" | ") for line in PAGE.splitlines() if re.match(r"\| (RFC )?\d", line)]
TESTS = {
    name: path
    for path in ROOT.glob("tests/**/test_*.py")
    for name in re.findall(r"(?m)^def (test_\w+)", path.read_text())
}


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0].strip("| "))
def test_each_clause_has_its_test(row):
    named = re.findall(r"`(test_\w+)`", row[-1])
    assert set(named) <= set(TESTS)
    assert named or row[2].startswith("no")


def test_each_test_of_a_clause_is_in_the_table():
    own = {name for name, path in TESTS.items() if path == ROOT / "tests/unit/test_rfc7030.py"}
    assert own <= set(re.findall(r"`(test_\w+)`", PAGE))
