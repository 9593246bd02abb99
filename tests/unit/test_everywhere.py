"""Questions about all domains and about patterns: who may, and what is asked for it."""

from datetime import UTC, datetime

import pytest

from pqsec_pki.access.everywhere import (
    domains_apart,
    domains_named,
    domains_ungoverned,
    is_known,
    topics_asked,
    who_may_anywhere,
)
from pqsec_pki.documents import DomainRange, DomainSet, Governance
from tests.unit.test_diff import allow, deny, document
from tests.unit.test_matrix_access import member

NOW = datetime(2026, 6, 1, tzinfo=UTC)
UP_TO_NINE = Governance.protected(DomainSet(parts=(DomainRange(first=0, last=9),)))


def found(members, topics, governance=UP_TO_NINE, domains=None):
    """Of each row: topic, domains, publishers."""
    asked = topics_asked(members, topics)
    placed = who_may_anywhere(
        governance, members, asked, domains=domains, now=NOW, asked=asked
    ).rows
    return [(each.row.topic, str(each.domains), each.row.publishers) for each in placed]


def test_domains_that_do_not_follow_one_another_are_not_told_as_a_range():
    apart = member("/apart", allow("a", domains=DomainSet.of(0, 1, 5)))

    assert found([apart], ["a"]) == [("a", "0-1,5", ("/apart",))]


def test_a_rule_for_a_range_that_ends_is_not_told_as_one_without_an_end():
    some = member("/some", allow("a", domains=DomainSet(parts=(DomainRange(first=2, last=4),))))

    assert found([some], ["a"]) == [("a", "2-4", ("/some",))]


def test_the_first_domain_of_a_range_without_an_end_stands_apart_as_some_stacks_read_it_alone():
    endless = DomainSet(parts=(DomainRange(first=3),))

    firsts = [each.first for each in domains_apart(Governance.protected(endless), ())]
    assert firsts == [0, 3, 4]
    firsts = [each.first for each in domains_apart(UP_TO_NINE, ())]
    assert firsts == [0, 10]


def test_domains_that_no_document_names_are_not_told_with_those_that_are_named():
    twelve = document(allow("a", domains=DomainSet.of(12)))
    every = Governance.protected(DomainSet(parts=(DomainRange(first=0),)))

    named = domains_named(UP_TO_NINE, twelve)
    assert [(each.first, each.last) for each in named] == [(0, 9), (12, 12)]
    named = domains_named(every, twelve)
    assert [each.first for each in named] == [0, 1, 12, 13]


def test_of_the_domains_that_are_asked_about_no_others_are_answered():
    some = member("/some", allow("a", domains=DomainSet(parts=(DomainRange(first=2),))))
    seven_on = DomainSet(parts=(DomainRange(first=7),))

    assert found([some], ["a"], domains=seven_on) == [("a", "7-9", ("/some",))]
    assert found([some], ["a"], domains=DomainSet.of(10)) == []


def test_domains_are_ungoverned_that_are_asked_about_and_that_governance_does_not_name():
    asked = DomainSet(parts=(DomainRange(first=8, last=11), 20))

    ungoverned = domains_ungoverned(UP_TO_NINE, asked)
    assert [(each.first, each.last) for each in ungoverned] == [(10, 11), (20, 20)]


def test_a_topic_that_nobody_may_use_has_a_row_for_all_domains_of_the_governance():
    nobody = member("/nobody", deny("a"), allow("b"))

    assert found([nobody], ["a"]) == [("a", "0-9", ())]


def test_a_pattern_asks_for_topics_and_patterns_that_it_meets():
    one = member("/one", allow("rt/a", "rt/b*", "other/*"))
    asked = topics_asked([one], ["rt/*"])

    assert list(asked) == ["rt/a", "rt/b*", "rt/*"]
    assert asked["rt/a"] == "rt/a"
    assert topics_asked([one], ["rt/a"]) == {"rt/a": "rt/a"}
    for pattern, topic in asked.items():
        assert topic
        assert topic.startswith(pattern.rstrip("*"))


def test_of_two_patterns_that_begin_alike_and_end_apart_no_topic_is_asked():
    one = member("/one", allow("rt/*/b"))

    assert list(topics_asked([one], ["rt/*/c"])) == ["rt/*/c"]
    assert not is_known("rt/*/c", ["rt/*/b"])
    assert is_known("rt/*", ["rt/*/b"])


def test_a_pattern_of_a_rule_is_no_topic_that_is_asked():
    one = member("/one", allow("rt/a", "rt/[a]"))

    assert list(topics_asked([one], ["rt/*"])) == ["rt/a", "rt/*"]


def test_a_topic_is_known_if_one_pattern_of_several_covers_it_and_not_without_patterns():
    assert is_known("rt/bc", ["rt/a*", "rt/b*"])
    assert not is_known("rt/bc", ["rt/a*", "rt/c*"])
    assert not is_known("rt/bc", ["rt/a"])


@pytest.mark.parametrize("named", [["rt/a"], ["rt/*/b"], ["rt/a*", "other/*"], ["other/*", "*"]])
def test_a_pattern_is_known_if_it_covers_or_meets_one_of_several(named):
    assert is_known("rt/*", named)


@pytest.mark.parametrize(("one", "other"), [("rt/a*", "rt/*b"), ("rt/*/b", "rt/a/*")])
def test_patterns_of_which_neither_covers_the_other_meet(one, other):
    assert is_known(one, [other])
    assert is_known(other, [one])


@pytest.mark.parametrize("named", [[], ["other"], ["other/*", "rt/b*"]])
def test_a_pattern_that_meets_none_is_not_known(named):
    assert not is_known("rt/a*", named)


def test_a_topic_is_known_if_a_rule_names_or_covers_it():
    named = ["rt/a", "rt/b*"]

    assert [each for each in ("rt/a", "rt/bc", "rt/c", "a") if is_known(each, named)] == [
        "rt/a",
        "rt/bc",
    ]
