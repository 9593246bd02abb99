"""Who may in partitions: no right that is only there is left out, and each row is what decides."""

from datetime import UTC, datetime
from itertools import product

import pytest

from pqsec_pki.access import (
    CYCLONEDDS_11,
    INTERPRETATIONS,
    SPEC,
    Action,
    DocumentOwner,
    Question,
    decide,
    who_may_anywhere,
)
from pqsec_pki.access.deciding import InterpretedPolicy
from pqsec_pki.documents import Criteria, DefaultAction, DomainSet, Governance
from tests.interop.policies import TOPICS, Maker
from tests.unit.test_diff import STRICT, allow, deny, topic_rule, with_rule
from tests.unit.test_matrix_access import NOW, member

EITHER = (Action.PUBLISH, Action.SUBSCRIBE)
PLAIN = [topic for topic in TOPICS if not set(topic) & set("*[")]
PARTITIONS = ("P", "Q", "PQ", "Px", "]", "^", "x", "-", "xyz", "QP")


def reads(*topics, partitions=()):
    """An allow_rule to subscribe."""
    return allow("-", publish=(), subscribe=(Criteria(topics=topics, partitions=partitions),))


def rows(*members, topics=("x",), governance=STRICT, interpretation=SPEC, **more):
    found = who_may_anywhere(
        governance,
        members,
        topics,
        now=NOW,
        interpretation=interpretation,
        asked={topic: topic for topic in topics},
        **more,
    )
    assert found.complete
    return {
        (each.row.topic, str(each.domains), each.row.where): (
            each.row.publishers,
            each.row.subscribers,
        )
        for each in found.rows
    }


@pytest.mark.parametrize("interpretation", INTERPRETATIONS, ids=lambda each: each.name)
@pytest.mark.parametrize("seed", range(40))
def test_no_right_in_a_partition_is_hidden_and_every_row_is_what_decides(interpretation, seed):
    maker, now = Maker(seed), datetime.now(UTC)
    governance = maker.governance()
    members = [
        DocumentOwner(name=name, subject=f"CN={name}", permissions=maker.permissions(f"CN={name}"))
        for name in ("/a", "/b", "/c")
    ]
    asked = {topic: topic for topic in PLAIN}
    found = who_may_anywhere(
        governance,
        members,
        PLAIN,
        domains=DomainSet.of(0),
        now=now,
        interpretation=interpretation,
        asked=asked,
    )
    policies = {
        each.name: InterpretedPolicy(governance, each.permissions, interpretation)
        for each in members
    }

    def allowed(name, action, topic, *partitions):
        question = Question(
            subject=f"CN={name}",
            domain=0,
            action=action,
            topic=topic,
            now=now,
            partitions=partitions,
        )
        return policies[name].decide(question).allowed

    shown, only_there = set(), set()
    for each in found.rows:
        row = each.row
        for action, names in zip(EITHER, (row.publishers, row.subscribers), strict=True):
            decided = [m.name for m in members if allowed(m.name, action, row.topic, *row.asked_in)]
            assert list(names) == decided, (row, action)
            shown |= {(name, action, row.topic) for name in names}
            if row.partitions:
                only_there |= {(name, action, row.topic) for name in names}
    for name, action, topic, partition in product(policies, EITHER, PLAIN, PARTITIONS):
        if allowed(name, action, topic, partition):
            right = name, action, topic
            assert right in shown, (right, partition)
            if not allowed(name, action, topic):
                assert right in only_there, (right, partition)


@pytest.mark.parametrize("interpretation", INTERPRETATIONS, ids=lambda each: each.name)
@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("partitions", [("P",), ("P", "Q"), ("",), ("P*",), ("[PQ]", "x")])
def test_a_question_about_partitions_is_decided_for_an_endpoint_in_all_of_them(
    interpretation, seed, partitions
):
    maker, now = Maker(1000 + seed), datetime.now(UTC)
    governance, permissions = maker.governance(), maker.permissions("CN=/a")
    asked = {topic: topic for topic in PLAIN}
    placed = who_may_anywhere(
        governance,
        [DocumentOwner(name="/a", subject="CN=/a", permissions=permissions)],
        PLAIN,
        domains=DomainSet.of(0),
        partitions=partitions,
        now=now,
        interpretation=interpretation,
        asked=asked,
    )
    for each in placed.rows:
        assert each.row.asked_in == partitions
        for action, names in zip(EITHER, (each.row.publishers, each.row.subscribers), strict=True):
            question = Question(
                subject="CN=/a",
                domain=0,
                action=action,
                topic=each.row.topic,
                now=now,
                partitions=partitions,
            )
            decision = decide(governance, permissions, question, interpretation)
            assert decision.allowed is bool(names), (question, decision)


def test_a_right_that_is_only_in_a_partition_has_a_row_there():
    robot = member("/robot", allow("x", partitions=("A",)))
    station = member("/station", reads("x", partitions=("*",)))
    assert rows(robot, station) == {
        ("x", "0", ""): ((), ("/station",)),
        ("x", "0", "A"): (("/robot",), ("/station",)),
    }
    assert rows(robot) == {("x", "0", "A"): (("/robot",), ())}


def test_a_right_that_the_default_partition_has_too_has_no_row_of_a_partition():
    assert rows(member("/robot", allow("x", partitions=("", "A")))) == {
        ("x", "0", ""): (("/robot",), ())
    }


def test_a_pattern_of_partitions_is_asked_where_no_denial_is():
    """A sample of A* could be one that Ax* covers."""
    robot = member(
        "/robot", deny("x", partitions=("Ax*", "Ay")), allow("x", partitions=("A*", "Ayx"))
    )
    [(where, users)] = rows(robot).items()
    assert where[2].startswith("Ayx, A* but not Ax* or Ay (such as A")
    assert users == (("/robot",), ())


def test_partitions_in_which_the_same_may_are_one_row():
    robot = member("/robot", allow("x", partitions=("A", "B")))
    other = member("/other", allow("x", partitions=("C",)))
    assert rows(robot, other) == {
        ("x", "0", "A, B"): (("/robot",), ()),
        ("x", "0", "C"): (("/other",), ()),
    }


def test_who_may_by_governance_is_in_the_row_of_a_partition_too():
    opened = with_rule(topics=(topic_rule("x", enable_write_access_control=False),))
    robot = member("/robot", reads("x", partitions=("A",)))
    talker = member("/talker", allow("y"))
    assert rows(robot, talker, governance=opened) == {
        ("x", "0", ""): (("/robot", "/talker"), ()),
        ("x", "0", "A"): (("/robot", "/talker"), ("/robot",)),
    }


def test_the_rows_of_a_partition_have_their_domains():
    governance = Governance.protected(DomainSet.of(0, 1, 2))
    robot = member(
        "/robot",
        allow("x", domains=DomainSet.of(1), partitions=("A",)),
        allow("x", domains=DomainSet.of(0)),
    )
    assert rows(robot, governance=governance) == {
        ("x", "0", ""): (("/robot",), ()),
        ("x", "1", "A"): (("/robot",), ()),
    }


def test_a_default_that_allows_where_a_denial_is_for_the_default_partition_alone():
    """So Cyclone DDS takes a deny_rule without partitions; no document here names one."""
    boss = member("/boss", deny("y"), default=DefaultAction.ALLOW)
    assert rows(boss, topics=("y",))["y", "0", ""] == ((), ("/boss",))
    denied = member("/boss", deny("y", partitions=("",)), default=DefaultAction.ALLOW)
    others = {
        where: who
        for (_, _, where), who in rows(denied, topics=("y",), interpretation=SPEC).items()
    }
    [elsewhere] = [where for where in others if where]
    assert elsewhere.startswith("others (such as ")
    assert others == {"": ((), ("/boss",)), elsewhere: (("/boss",), ("/boss",))}
    assert rows(boss, topics=("y",), interpretation=CYCLONEDDS_11) == {
        ("y", "0", where): who for where, who in others.items()
    }


@pytest.mark.parametrize("number", [20, 200])
def test_each_robot_with_a_partition_of_its_own_costs_two_decisions(monkeypatch, number):
    decided = []
    uses = InterpretedPolicy.uses

    def counted(policy, join, topics):
        decided.append(join)
        return uses(policy, join, topics)

    monkeypatch.setattr(InterpretedPolicy, "uses", counted)
    fleet = [member(f"/r{n}", allow("x", partitions=(f"r{n}",))) for n in range(number)]
    station = member("/station", reads("x", partitions=("r*",)))
    found = rows(*fleet, station)
    assert len(found) == number + 1
    assert found["x", "0", f"r{number - 1}"] == ((f"/r{number - 1}",), ("/station",))
    assert len(decided) <= 8 * (number + 1)
