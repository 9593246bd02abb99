"""Who may publish and subscribe: the matrix says what the engine says."""

from datetime import UTC, datetime
from itertools import product

import pytest

from pqsec_pki.access import CYCLONEDDS, FASTDDS, INTERPRETATIONS, Action, Question, decide
from pqsec_pki.access.deciding import InterpretedPolicy
from pqsec_pki.access.matrix import DocumentOwner, topics_named, who_may
from pqsec_pki.access.question import MAX_NAME
from pqsec_pki.documents import Criteria, DefaultAction, DomainSet, Governance, Permissions
from tests.interop.policies import TOPICS, Maker
from tests.unit.test_diff import STRICT, allow, deny, document, topic_rule, with_rule

NOW = datetime(2026, 6, 1, tzinfo=UTC)
READ_A = (Criteria(topics=("a",)),)


def member(name, *rules, **more):
    subject = f"CN={name}"
    return DocumentOwner(
        name=name, subject=subject, permissions=document(*rules, subject=subject, **more)
    )


TALKER = member("/talker", allow("a", "b"))
LISTENER = member("/listener", allow("rt/*", subscribe=READ_A))
BOSS = member("/boss", deny("b"), default=DefaultAction.ALLOW)


def rows(*members, governance=STRICT, topics=None, domain=0):
    named = topics_named(members) if topics is None else topics
    found = who_may(governance, members, named, domain=domain, now=NOW)
    return {row.topic: (row.publishers, row.subscribers) for row in found}


def test_every_topic_of_a_rule_has_a_row():
    assert rows(TALKER, LISTENER) == {
        "a": (("/talker",), ("/listener",)),
        "b": (("/talker",), ()),
        "rt/*": (("/listener",), ()),
    }


@pytest.mark.parametrize(
    ("topic", "row"),
    [
        ("rt/x", (("/listener",), ())),
        ("nothing", ((), ())),
        ("b", (("/talker",), ())),
        ("*", ((), ())),
    ],
)
def test_a_topic_is_asked_that_no_rule_names(topic, row):
    assert rows(TALKER, LISTENER, topics=[topic]) == {topic: row}


def test_a_pattern_that_covers_nothing_is_nobodys():
    every = member("/every", allow("*", "[b-a]"))
    [row] = who_may(STRICT, [every], ["[b-a]"], domain=0, now=NOW)
    assert (row.asked, row.publishers) == (None, ())


def test_the_longest_topic_that_rtps_has_is_asked_and_no_longer_one():
    every = member("/every", allow("*"))
    longest = "a" * MAX_NAME
    assert rows(every, topics=[longest, f"{longest}a"]) == {
        longest: (("/every",), ()),
        f"{longest}a": ((), ()),
    }


def test_a_pattern_is_asked_with_a_name_that_is_no_row():
    [one, other] = who_may(STRICT, [LISTENER], ["rt/*", "rt/x"], domain=0, now=NOW)
    assert (one.is_pattern, other.is_pattern) == (True, False)
    assert (one.asked, other.asked) == ("rt/xyz", "rt/x")


def test_a_pattern_is_not_asked_with_a_topic_that_some_rule_names():
    other = member("/other", deny("rt/xyz"), allow("rt/x"))
    [row] = who_may(STRICT, [LISTENER, other], ["rt/*"], domain=0, now=NOW)
    assert (row.asked, row.publishers) == ("rt/", ("/listener",))


@pytest.mark.parametrize(
    ("interpretation", "topics", "topic"),
    [
        (CYCLONEDDS, (topic_rule(),), "DCPSParticipant"),
        (FASTDDS, (topic_rule("open", enable_write_access_control=False),), "\\*"),
    ],
    ids=["a builtin topic", "a topic that is a pattern"],
)
def test_a_topic_that_a_stack_opens_is_everybodys(interpretation, topics, topic):
    governance = with_rule(topics=topics)
    [row] = who_may(governance, [TALKER], [topic], domain=0, now=NOW, interpretation=interpretation)
    assert row.publishers == ("/talker",)


def test_a_default_that_allows_counts():
    assert rows(BOSS, topics=["z", "b"]) == {
        "z": (("/boss",), ("/boss",)),
        "b": ((), ("/boss",)),
    }


def test_a_topic_that_governance_opens_is_everybodys():
    opened = with_rule(topics=(topic_rule("o*", enable_read_access_control=False), topic_rule()))
    assert rows(TALKER, LISTENER, governance=opened, topics=["open", "a"]) == {
        "open": ((), ("/talker", "/listener")),
        "a": (("/talker",), ("/listener",)),
    }


@pytest.mark.parametrize("domain", [1, 7])
def test_nobody_may_on_a_domain_that_is_not_named(domain):
    governance = Governance.protected(DomainSet.of(0, 1))
    found = rows(TALKER, LISTENER, governance=governance, domain=domain)
    assert set(found.values()) == {((), ())}


def test_nobody_may_after_the_end():
    late = datetime(2030, 1, 1, tzinfo=UTC)
    [row] = who_may(STRICT, [TALKER], ["a"], domain=0, now=late)
    assert (row.publishers, row.subscribers) == ((), ())


@pytest.mark.parametrize("interpretation", INTERPRETATIONS, ids=lambda each: each.name)
@pytest.mark.parametrize("seed", range(25))
def test_the_matrix_is_what_the_engine_decides_one_by_one(interpretation, seed):
    maker, now = Maker(seed), datetime.now(UTC)
    governance = maker.governance()
    members = [
        DocumentOwner(name=name, subject=f"CN={name}", permissions=maker.permissions(f"CN={name}"))
        for name in ("/a", "/b")
    ]
    plain = [topic for topic in TOPICS if not set(topic) & set("*[")]
    found = who_may(governance, members, plain, domain=0, now=now, interpretation=interpretation)
    for row, each in product(found, members):
        for action, names in (
            (Action.PUBLISH, row.publishers),
            (Action.SUBSCRIBE, row.subscribers),
        ):
            question = Question(
                subject=each.subject, domain=0, action=action, topic=row.topic, now=now
            )
            decision = decide(governance, each.permissions, question, interpretation)
            assert decision.allowed is (each.name in names), (row, question, decision)


OPEN_JOIN = with_rule(enable_join_access_control=False)
LATE = {
    "not_before": datetime(2030, 1, 1, tzinfo=UTC),
    "not_after": datetime(2031, 1, 1, tzinfo=UTC),
}
VARIANTS = {
    "deny": ([deny("x")], {}),
    "domains": ([allow("x", domains=DomainSet.of(7))], {}),
    "partitions": ([allow("x", partitions=("p",))], {}),
    "tags": ([deny("x", tags=(("k", "v"),)), allow("x")], {}),
    "subscribe": ([allow("x", publish=(), subscribe=(Criteria(topics=("x",)),))], {}),
    "relay": ([allow("x", publish=(), relay=(Criteria(topics=("x",)),))], {}),
    "default": ([allow("x")], {"default": DefaultAction.ALLOW}),
    "ended": ([allow("x")], LATE),
    "two rules": ([deny("x"), allow("x")], {}),
    "another order": ([allow("x"), deny("x")], {}),
    "two criteria": (
        [allow("x", publish=(Criteria(topics=("y",), partitions=("p",)), Criteria(topics=("x",))))],
        {},
    ),
    "an empty topic": ([allow("x", "")], {}),
}


@pytest.mark.parametrize("interpretation", INTERPRETATIONS, ids=lambda each: each.name)
@pytest.mark.parametrize("governance", [STRICT, OPEN_JOIN], ids=["strict", "open join"])
def test_grants_that_differ_in_more_than_topics_are_decided_apart(governance, interpretation):
    """One decision counts for all participants whose grants differ only in topics."""
    members = [
        member(f"/{turn}{name}", *rules, **more)
        for turn in (0, 1)
        for name, (rules, more) in (("plain", ([allow("x")], {})), *VARIANTS.items())
    ]
    for them in (members, members[::-1]):
        found = who_may(
            governance, them, ["x", "y"], domain=0, now=NOW, interpretation=interpretation
        )
        for row, each in product(found, them):
            for action, names in (
                (Action.PUBLISH, row.publishers),
                (Action.SUBSCRIBE, row.subscribers),
            ):
                question = Question(
                    subject=each.subject, domain=0, action=action, topic=row.topic, now=NOW
                )
                decision = decide(governance, each.permissions, question, interpretation)
                assert decision.allowed is (each.name in names), (row.topic, each, decision)


def test_a_fleet_of_alike_participants_is_asked_once(monkeypatch):
    asked = []
    uses = InterpretedPolicy.uses

    def counted(policy, join, topics):
        asked.append(topics)
        return uses(policy, join, topics)

    monkeypatch.setattr(InterpretedPolicy, "uses", counted)
    fleet = [member(f"/r{number}", allow(f"pose{number}", "stop")) for number in range(50)]
    found = rows(*fleet)
    assert found["stop"] == (tuple(each.name for each in fleet), ())
    assert found["pose7"] == (("/r7",), ())
    assert len(asked) == 2  # what its criteria cover, and another topic


def test_a_document_with_several_grants_is_asked_for_its_subject():
    both = Permissions(grants=(*TALKER.permissions.grants, *LISTENER.permissions.grants))
    members = [
        DocumentOwner(name=s, subject=f"CN={s}", permissions=both) for s in ("/talker", "/listener")
    ]
    assert rows(*members) == rows(TALKER, LISTENER)


@pytest.mark.parametrize("topic", ["x" * 257, "rt/" + "?" * 254], ids=["name", "pattern"])
def test_nobody_uses_a_topic_that_is_longer_than_any_of_dds_can_be(topic):
    long = member("/long", allow(topic, "a"))
    found = rows(long, BOSS)
    assert found[topic] == ((), ())
    assert found["a"] == (("/long", "/boss"), ("/boss",))
