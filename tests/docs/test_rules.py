"""rules.md is what the rules say, and nothing that was measured is without its rule."""

import re

import pytest

from pqsec_pki.access import INTERPRETATIONS, SPEC, Viewpoint
from pqsec_pki.lint import RULES
from tests.docs.rules_page import MEASURED, PAGE, is_refused, page, rules_of
from tests.docs.stack_differences import HABITS

VARIANTS = {row["variant"] for row in MEASURED}
FIELDS = (
    *("covers", "governs", "is_for", "includes", "in_force", "skips_grants_out_of_force"),
    *("knows_relay", "partitions_met", "tags_met", "flaw"),
)


def test_the_page_is_made_of_the_rules():
    assert PAGE.read_text() == page(), "run `python tests/docs/rules_page.py`"


def test_the_page_has_a_section_for_each_rule():
    assert re.findall(r"(?m)^### (PQS[0-9]{3}): ", PAGE.read_text()) == list(RULES)


@pytest.mark.parametrize(
    "row", [row for row in MEASURED if is_refused(row)], ids=lambda row: row["variant"]
)
def test_what_a_stack_refuses_has_its_rule_or_a_reason_for_none(row):
    assert bool(rules_of(row["variant"])) != bool(row.get("why"))


def test_rules_stand_on_rows_that_were_measured():
    assert len(VARIANTS) == len(MEASURED) == 165
    assert {row for rule in RULES.values() for row in rule.rows} - VARIANTS == set()


def parts(interpretation):
    """The reading, by the names that habits have for its fields."""
    found = {field: getattr(interpretation, field) for field in FIELDS}
    for side in Viewpoint:
        found |= {
            f"join {side}": interpretation.join[side],
            f"use {side}": interpretation.use[side],
        }
    return found


@pytest.mark.parametrize(
    "interpretation", INTERPRETATIONS[1:], ids=lambda interpretation: interpretation.name
)
def test_each_divergence_of_a_reading_has_its_rule_or_a_reason_for_none(interpretation):
    standard, own = parts(SPEC), parts(interpretation)
    told = {
        field for habit in HABITS if habit.stack == interpretation.stack for field in habit.fields
    }
    assert {field for field in own if own[field] != standard[field]} == told


@pytest.mark.parametrize("habit", HABITS, ids=lambda habit: habit.what)
def test_a_habit_is_told_by_rules_that_matter_to_its_stack(habit):
    assert habit.told_by
    for id_ in habit.rules:
        stacks = RULES[id_].stacks
        assert not stacks or habit.stack == "all" or habit.stack in stacks
