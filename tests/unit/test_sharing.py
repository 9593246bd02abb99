"""What one may publish and another subscribe to: asked of the engine, for each way."""

from dataclasses import replace
from datetime import UTC, datetime

import pytest

from pqsec_pki.access.sharing import ParticipantDocuments, topics_between
from pqsec_pki.documents import Criteria, DefaultAction, DomainSet, Permissions
from tests.unit.test_diff import STRICT, allow, deny, document, topic_rule, with_rule

NOW = datetime(2026, 6, 1, tzinfo=UTC)


def documents(name, *rules, governance=STRICT, **more):
    subject = f"CN={name}"
    permissions = document(*rules, subject=subject, **more)
    return ParticipantDocuments(subject=subject, governance=governance, permissions=permissions)


def hears(*topics, **more):
    return replace(allow("x"), publish=(), subscribe=(Criteria(topics=topics, **more),))


def says(*topics, **more):
    return replace(allow("x"), publish=(Criteria(topics=topics, **more),))


def shared(one, other, domain=0):
    return topics_between(one, other, domain=domain, now=NOW)


TAGS = (("k", "v"),)
CASES = {
    "a topic": ([says("a", "b")], [hears("b", "c")], ("b",)),
    "none": ([says("a")], [hears("b")], ()),
    "the wrong way": ([hears("a")], [says("a")], ()),
    "a pattern and a topic": ([says("rt/*")], [hears("rt/a", "b")], ("rt/a",)),
    "a topic and a pattern": ([says("rt/a")], [hears("rt/*")], ("rt/a",)),
    "one pattern": ([says("rt/*")], [hears("rt/*")], ("rt/*",)),
    "patterns that meet": ([says("a*")], [hears("*b")], ("ab",)),
    "a pattern that meets one, beside a topic": ([says("a*")], [hears("*b", "a")], ("ab", "a")),
    "patterns that do not": ([says("a*")], [hears("b*")], ()),
    "denied": ([deny("a"), says("a", "c")], [hears("*")], ("c",)),
    "denied but for one": ([deny("a?"), says("a*")], [hears("a*")], ("a*",)),
    "all denied": ([deny("a*"), says("a*")], [hears("a*")], ()),
    "a partition of both": (
        [says("a", partitions=("P",))],
        [hears("a", partitions=("P", "Q"))],
        ("a",),
    ),
    "partitions apart": ([says("a", partitions=("P",))], [hears("a", partitions=("Q",))], ()),
    "a partition that has no name": ([says("a", partitions=("[b-a]",))], [hears("a")], ()),
    "a partition and the default": ([says("a", partitions=("P",))], [hears("a")], ()),
    "data tags": ([says("a", data_tags=TAGS)], [hears("a")], ("a",)),
    "denied with a data tag": (
        [replace(says("a", data_tags=TAGS), allow=False), says("a", data_tags=TAGS)],
        [hears("a")],
        ("a",),
    ),
    "another domain": (
        [replace(says("a"), domains=DomainSet.of(1)), says("b")],
        [hears("a", "b")],
        ("b",),
    ),
    "what all nodes of ROS 2 share": (
        [says("ros_discovery_info")],
        [hears("ros_discovery_info")],
        (),
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_what_they_share(case):
    said, heard, found = CASES[case]
    assert shared(documents("/talker", *said), documents("/listener", *heard)) == found


def test_each_of_two_patterns_that_meet_a_third_is_shared_by_a_topic_of_its_own():
    apart = with_rule(topics=tuple(map(topic_rule, ("a*", "b*", "*"))))
    one = documents("/talker", says("a*", "b*"), governance=apart)
    other = documents("/listener", hears("*"), governance=apart)
    assert [name[0] for name in shared(one, other)] == ["a", "b"]


def test_what_governance_or_a_default_opens_is_shared():
    opened = with_rule(topics=(topic_rule("open", enable_read_access_control=False),))
    one = documents("/talker", says("open"), governance=opened)
    other = documents("/listener", hears("x"), governance=opened)
    assert shared(one, other) == ("open",)
    assert shared(other, one) == ()
    free = documents("/free", default=DefaultAction.ALLOW)
    assert shared(free, documents("/listener", hears("a", "b*"))) == ("a", "b")


def test_what_the_default_of_one_of_several_grants_allows_is_shared():
    free = documents("/free", default=DefaultAction.ALLOW)
    grants = (*document(subject="CN=/other").grants, *free.permissions.grants)
    several = replace(free, permissions=Permissions(grants=grants))
    assert shared(several, documents("/listener", hears("a"))) == ("a",)


def test_both_governances_count():
    """Each stack judges its own endpoint and the peer's, by the governance that it has."""
    opened = with_rule(topics=(topic_rule("*", enable_write_access_control=False),))
    hearing = documents("/listener", hears("a"))
    assert shared(documents("/talker", says("b"), governance=opened), hearing) == ()
    assert shared(
        documents("/talker", says("b"), governance=opened), replace(hearing, governance=opened)
    )
