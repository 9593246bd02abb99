"""Where a stack answers otherwise than the standard, a rule has said so before.

Policies are made up at random, small enough that many of them break no rule at all.
"""

import random
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import product

import pytest

from pqsec_pki.access import INTERPRETATIONS, SPEC, Action, InterpretedPolicy, Question
from pqsec_pki.documents import (
    Criteria,
    DefaultAction,
    DomainRange,
    DomainSet,
    Governance,
    Grant,
    PermissionRule,
    Permissions,
)
from pqsec_pki.lint import check
from pqsec_pki.stacks import Stack
from tests.docs.stack_differences import HABITS
from tests.longer import LONG

NOW = datetime(2026, 6, 1, tzinfo=UTC)
YEAR = timedelta(days=365)
SUBJECT = "CN=/lab/alice"
TOPICS = ("a", "ab", "rt/a")
PATTERNS = (*TOPICS, "a*", "rt/*", "[ab]", "r?/a")
DOMAINS = (DomainSet.of(0), DomainSet.of(DomainRange(first=0, last=9)))
PARTITIONS = ((), ("P",), ("Q",), ("P*",), ("*",))
POLICIES, ENOUGH = (150, 20) if LONG else (60, 5)
[MODEL] = Governance.protected(DOMAINS[1]).domain_rules
[CLOSED] = MODEL.topic_rules


def chosen(chance, low, high, make):
    return tuple(make() for _ in range(chance.randint(low, high)))


def governance(chance):
    def opened():
        return replace(
            CLOSED,
            topic_expression=chance.choice(PATTERNS),
            enable_read_access_control=chance.random() < 0.5,
        )

    rules = (*chosen(chance, 0, 1, opened), CLOSED)
    joining = chance.random() < 0.5
    rule = replace(MODEL, topic_rules=rules, enable_join_access_control=joining)
    return Governance(domain_rules=(rule,))


def permissions(chance):
    def criteria():
        partitions = chance.choice(((), (), (), ("P",), ("P?", "P")))
        return Criteria(topics=chosen(chance, 1, 2, pattern), partitions=partitions)

    def pattern():
        return chance.choice(PATTERNS)

    def rule():
        return PermissionRule(
            allow=chance.random() < 0.6,
            domains=chance.choice(DOMAINS),
            publish=chosen(chance, 0, 1, criteria),
            subscribe=chosen(chance, 0, 1, criteria),
        )

    grant = Grant(
        name="g",
        subject_name=SUBJECT,
        not_before=NOW - YEAR,
        not_after=NOW + YEAR,
        rules=chosen(chance, 1, 3, rule),
        default=chance.choice(list(DefaultAction)),
    )
    return Permissions(grants=(grant,))


QUESTIONS = [
    Question(subject=SUBJECT, now=NOW, domain=domain, action=Action.JOIN) for domain in (0, 5)
] + [
    Question(
        subject=SUBJECT, now=NOW, domain=domain, action=action, topic=topic, partitions=partitions
    )
    for domain, action, topic, partitions in product(
        (0, 5), (Action.PUBLISH, Action.SUBSCRIBE), TOPICS, PARTITIONS
    )
]


@pytest.mark.slow(but=1)
@pytest.mark.parametrize(
    "interpretation", INTERPRETATIONS[1:], ids=lambda interpretation: interpretation.name
)
def test_a_stack_that_reads_otherwise_is_told_of(interpretation, tmp_path):
    chance = random.Random(interpretation.name)  # noqa: S311 -- the same policies every time
    ours = {
        id_
        for habit in HABITS
        if habit.stack in {interpretation.stack, "all"}
        for id_ in habit.rules
    }
    quiet = loud = 0
    for _ in range(POLICIES):
        policy = governance(chance), permissions(chance)
        for name, document in zip(("governance.xml", "permissions.xml"), policy, strict=True):
            (tmp_path / name).write_bytes(document.to_xml())
        findings = check([tmp_path], now=NOW, targets=[Stack(interpretation.stack)]).findings
        if ours & {each.rule.id for each in findings}:
            loud += differs(policy, interpretation)
        else:
            quiet += 1
            assert not differs(policy, interpretation), policy
    assert quiet > ENOUGH
    assert loud > ENOUGH


def differs(policy, interpretation):
    """Whether the stack gives another answer than the standard to some question."""
    one, other = InterpretedPolicy(*policy, SPEC), InterpretedPolicy(*policy, interpretation)
    return any(
        one.decide(question).allowed != other.decide(question).allowed for question in QUESTIONS
    )


def test_what_pqs230_advises_lets_opendds_make_participants():
    opendds = INTERPRETATIONS[-1]
    grant = Grant.least(
        subject_name=SUBJECT, not_before=NOW - YEAR, not_after=NOW + YEAR, domains=DOMAINS[0],
        publish=("a",),
    )  # fmt: skip
    unused = replace(CLOSED, topic_expression="nobody/uses/it", enable_read_access_control=False)
    advised = replace(MODEL, topic_rules=(unused, CLOSED))
    join = Question(subject=SUBJECT, now=NOW, domain=0, action=Action.JOIN)
    for rule, is_let_in in ((MODEL, False), (advised, True)):
        policy = Governance(domain_rules=(rule,)), Permissions(grants=(grant,))
        assert InterpretedPolicy(*policy, opendds).decide(join).allowed is is_let_in
        others = [InterpretedPolicy(*policy, each) for each in INTERPRETATIONS[:-1]]
        assert all(each.decide(join).allowed for each in others)
