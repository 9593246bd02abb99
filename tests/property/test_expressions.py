"""Partitions that are expressions on both sides, compared name by name."""

from functools import cache
from itertools import product

from hypothesis import given, settings
from hypothesis import strategies as st

from pqsec_pki.access import _patterns as patterns
from pqsec_pki.access._expressions import Budget, meets, within
from tests.longer import examples

NAMES = tuple("".join(each) for size in range(7) for each in product("abc", repeat=size))
"""Of three letters patterns name two: the third stands for all others."""
ODD_NAMES = tuple("".join(each) for size in range(4) for each in product("ab[]*\\", repeat=size))


def globs(*tokens):
    return st.lists(st.sampled_from(tokens), max_size=3).map("".join)


PLAIN = globs("a", "b", "*", "?")
RULES = st.lists(globs("a", "b", "*", "?", "[ab]", "[!a]", "[^b]", "\\a"), max_size=4)
ODD = globs("a", "b", "*", "?", "[ab]", "[!a]", "[^b]", "[a", "]", "\\*", "\\")
INTERPRETATIONS = (
    patterns.posix,
    patterns.posix_without_escapes,
    patterns.opendds,
    patterns.cyclonedds,
)


@cache
def covered(expression, names, covers=patterns.posix):
    return frozenset(name for name in names if covers(expression, name))


def of_all(rules, names):
    return frozenset().union(*(covered(each, names) for each in rules))


@settings(max_examples=examples(1000))
@given(PLAIN, RULES)
def test_an_expression_lies_within_others_as_all_its_names_do(expression, rules):
    budget = Budget()
    assert within(expression, rules, budget) is (covered(expression, NAMES) <= of_all(rules, NAMES))
    assert not budget.spent


@settings(max_examples=examples(1000))
@given(PLAIN, RULES)
def test_an_expression_meets_others_as_one_of_its_names_does(expression, rules):
    budget = Budget()
    assert meets(expression, rules, budget) is bool(
        covered(expression, NAMES) & of_all(rules, NAMES)
    )
    assert not budget.spent


@settings(max_examples=examples(1000))
@given(ODD, st.lists(ODD, max_size=4))
def test_a_bracket_is_never_less_than_any_stack_takes_it_for(expression, rules):
    """Nor less than the name that it is to a stack without brackets."""
    found = of_all(rules, ODD_NAMES)
    is_within, is_met = within(expression, rules, Budget()), meets(expression, rules, Budget())
    for covers in INTERPRETATIONS:
        stands_for = covered(expression, ODD_NAMES, covers)
        assert not is_within or stands_for <= found
        assert is_met or not stands_for & found
    by_name = any(patterns.posix(each, expression) for each in rules)
    assert by_name or not is_within
    assert is_met or not by_name


HOSTILE = st.lists(st.sampled_from("*?[]!ab\\-"), max_size=60).map("".join)


@settings(max_examples=examples(100))
@given(HOSTILE, st.lists(HOSTILE, max_size=8))
def test_whatever_is_asked_the_steps_are_bounded(expression, rules):
    for compare in (within, meets):
        budget = Budget()
        assert compare(expression, rules, budget) in {True, False}
        assert budget.left > -100
