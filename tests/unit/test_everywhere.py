"""Questions about all domains and about patterns: who may, and what is asked for it."""

from datetime import UTC, datetime

from pqsec_pki.access.everywhere import (
    domains_apart,
    domains_named,
    is_known,
    topics_asked,
    who_may_anywhere,
)
from pqsec_pki.documents import DomainRange, DomainSet, Governance
from tests.unit.test_diff import allow, deny, document
from tests.unit.test_matrix_access import member

NOW = datetime(2026, 6, 1, tzinfo=UTC)
UP_TO_NINE = Governance.protected(DomainSet(parts=(DomainRange(first=0, last=9),)))


def found(members, topics, governance=UP_TO_NINE):
    """Of each row: topic, domains, publishers."""
    asked = topics_asked(members, topics)
    placed = who_may_anywhere(governance, members, asked, now=NOW, asked=asked).rows
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


def test_a_topic_is_known_if_a_rule_names_or_covers_it():
    named = ["rt/a", "rt/b*"]

    assert [each for each in ("rt/a", "rt/bc", "rt/c", "a") if is_known(each, named)] == [
        "rt/a",
        "rt/bc",
    ]
