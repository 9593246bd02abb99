"""What is said of two patterns is true of the names they match."""

from fnmatch import fnmatchcase
from itertools import chain, product

from hypothesis import given
from hypothesis import strategies as st

from pqsec_pki.documents import DomainRange, DomainSet
from pqsec_pki.lint.documents._shadows import (
    ODD_PATTERNS,
    Patterns,
    Starts,
    covers_all,
    covers_domains,
    domains_meet,
)

PATTERNS = st.text("ab*?", max_size=5)
NAMES = ["".join(letters) for size in range(5) for letters in product("ab", repeat=size)]
ENDS = st.tuples(st.integers(0, 4), st.none() | st.integers(0, 5))
DOMAINS = st.lists(
    st.integers(0, 5) | ENDS.map(lambda ends: DomainRange(first=ends[0], last=ends[1])),
    min_size=1,
    max_size=3,
).map(lambda parts: DomainSet(parts=tuple(parts)))


def matched(pattern):
    return {name for name in NAMES if fnmatchcase(name, pattern)}


@given(st.lists(PATTERNS, max_size=4), PATTERNS)
def test_a_pattern_is_covered_only_if_all_it_matches_is(earlier, later):
    patterns = Patterns[str]()
    for pattern in earlier:
        patterns.add(pattern, pattern)
    for pattern in patterns.covering(later):
        assert matched(later) <= matched(pattern)


@given(st.lists(PATTERNS, max_size=4), PATTERNS)
def test_patterns_may_meet_where_they_do(earlier, later):
    starts = Starts()
    for pattern in earlier:
        starts.add(pattern)
    if matched(later) & set(chain.from_iterable(map(matched, earlier))):
        assert starts.may_meet(later)


def test_patterns_that_begin_otherwise_never_meet():
    starts = Starts()
    for pattern in ("ab*", "b", "a?x"):
        starts.add(pattern)
    assert [starts.may_meet(each) for each in ("bb", "b?", "ba*", "c*")] == [
        False,
        True,
        False,
        False,
    ]
    assert [starts.may_meet(each) for each in ("ab", "aba", "*", "a")] == [True, True, True, True]


@given(DOMAINS, DOMAINS)
def test_what_is_said_of_sets_of_domains_is_true_of_the_domains(one, other):
    first, second = ({each for each in range(12) if each in domains} for domains in (one, other))
    if first & second:
        assert domains_meet(one, other)
    if covers_domains(one, other):
        assert first >= second


def test_sets_of_other_domains_do_not_meet():
    assert not domains_meet(DomainSet.parse("0-3"), DomainSet.parse("4-9"))
    assert not domains_meet(DomainSet.of(0), DomainSet(parts=(1, DomainRange(first=5))))


def test_a_set_of_many_domains_lies_within_another_only_if_all_do():
    many = tuple(range(0, 2 * ODD_PATTERNS, 2))
    below, beyond = DomainSet(parts=(*many, 99)), DomainSet(parts=(*many, 101))
    assert covers_domains(DomainSet.parse("0-100"), DomainSet(parts=many))
    assert not covers_domains(DomainSet.parse("0-100"), beyond)
    assert covers_domains(beyond, beyond)
    assert not covers_domains(below, beyond)


def test_a_question_mark_is_one_octet_and_not_a_letter_of_two():
    patterns = Patterns[str]()
    patterns.add("rt/?", "one octet")
    patterns.add("rt/??", "two octets")
    assert list(patterns.covering("rt/é")) == ["two octets"]


@given(PATTERNS)
def test_a_pattern_is_for_all_only_if_it_matches_every_name(pattern):
    if covers_all(pattern):
        assert matched(pattern) >= set(NAMES) - {""}


def test_patterns_for_all_are_known():
    everything = ["*", "**", "?*", "*?", "*?*"]
    assert list(filter(covers_all, [*everything, "", "?", "??*", "a*", "[*]"])) == everything
