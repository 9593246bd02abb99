"""Rights without the other side: found, and never where another right may be the other side."""

from dataclasses import replace
from itertools import product

import pytest

from pqsec_pki.access import Action, CriteriaRight, open_rights, rights_of, without_counterpart
from pqsec_pki.access.counterparts import is_one_edit
from pqsec_pki.documents import DefaultAction, DomainSet, ros
from tests.unit.test_diff import STRICT, document, topic_rule, with_rule

ZERO = DomainSet.of(0)


def right(topic, action=Action.PUBLISH, owner="/talker", domains=ZERO, partitions=()):
    return CriteriaRight(
        owner=owner, action=action, topics=(topic,), domains=domains, partitions=partitions
    )


def heard(topic, owner="/listener", **more):
    return right(topic, Action.SUBSCRIBE, owner, **more)


def alone(asked, *others):
    return [each.right.topic for each in without_counterpart([asked], [asked, *others])]


OTHER_SIDES = [
    heard("rt/chatter"),
    heard("rt/*"),
    heard("rt/chat?er"),
    heard("*"),
    heard("rt/chatter", domains=DomainSet.parse("0-3")),
    heard("rt/chatter", owner="/talker"),
]
NO_OTHER_SIDES = [
    heard("rt/chatte"),
    heard("rt/image"),
    heard("rq/*"),
    heard("rt/chatter", domains=DomainSet.of(1)),
    heard("rt/chatter", partitions=("floor1",)),
    right("rt/chatter", owner="/other"),
]


def test_a_topic_is_alone_if_nobody_may_use_its_other_side():
    asked = right("rt/chatter")
    assert [each for each in OTHER_SIDES if alone(asked, each)] == []
    assert [each for each in NO_OTHER_SIDES if not alone(asked, each)] == []
    for one, other in product(NO_OTHER_SIDES, OTHER_SIDES):
        assert alone(asked, one, other) == []


def test_partitions_must_meet_too():
    asked = right("rt/chatter", partitions=("floor1",))
    assert alone(asked, heard("rt/chatter", partitions=("floor2", "roof*"))) == ["rt/chatter"]
    for name in ("floor1", "floor*", "*", "f[kl]oor?"):
        assert alone(asked, heard("rt/chatter", partitions=("floor2", name))) == []
    pattern = right("rt/chatter", partitions=("*1",))
    assert alone(pattern, heard("rt/chatter", partitions=("floor?",))) == []


def test_what_governance_or_a_default_opens_to_everyone_has_the_other_side():
    asked = right("rt/chatter")
    open_rule = topic_rule("rt/*", enable_read_access_control=False)
    open_topic = with_rule(topics=(open_rule,))
    assert alone(asked, *open_rights(open_topic)) == []
    assert alone(asked, *open_rights(STRICT)) == ["rt/chatter"]
    grants = document(default=DefaultAction.ALLOW).grants
    assert alone(asked, *rights_of("/boss", grants)) == []


def test_what_every_ros_2_node_has_is_no_news():
    needs = ros.node_minimum("/talker")
    routine = [*needs.publish, "rt/clock", "rt/talker/transition_event", "rt/x/*"]
    routine += ros.action_server("/cook").publish
    assert [topic for topic in routine if alone(right(topic))] == []
    for topics, found in (
        (ros.service_client("/reset").publish, ["rq/resetRequest"]),
        (ros.action_client("/cook").publish, ["rq/cook/_action/send_goalRequest"]),
    ):
        assert [topic for topic in topics if alone(right(topic))] == found


ONE_EDIT = [
    ("rt/chater", "rt/chatter"),
    ("rt/chatter", "rt/chattre"),
    ("rt/chattex", "rt/chatter"),
    ("rt/cmd_vel", "rt/cmd_vl"),
    ("rt/robot1/scam", "rt/robot1/scan"),
]
TWO_TOPICS = [
    ("rt/robot1/odom", "rt/robot2/odom"),
    ("rt/robot1/odom", "rt/robot11/odom"),
    ("rt/arm_l", "rt/arm_r"),
    ("rt/a", "rt/b"),
    ("rt/chatter", "rt/chatter"),
    ("rt/chaxxer", "rt/chatter"),
    ("rt/chatter", "rt/chatter/chatter"),
    ("rt/chat/er", "rt/chatter"),
    ("rt/scan", "rt/scanned"),
]


def test_one_edit_within_a_word_is_a_near_miss_and_a_number_is_not():
    for expected, pairs in ((True, ONE_EDIT), (False, TWO_TOPICS)):
        for one, other in pairs:
            assert is_one_edit(one, other) is expected, (one, other)
            assert is_one_edit(other, one) is expected, (other, one)


@pytest.mark.parametrize(("one", "other"), ONE_EDIT)
def test_a_topic_that_is_spelled_alike_is_told_if_it_has_the_other_side(one, other):
    asked, listener = right(one), heard(other)
    [found] = without_counterpart([asked], [asked, listener])
    assert found.meant == other
    assert str(found).endswith(f"nobody may subscribe to it: did you mean {other}?")
    elsewhere = replace(listener, domains=DomainSet.of(7))
    [found] = without_counterpart([asked], [asked, elsewhere])
    assert found.meant == ""
