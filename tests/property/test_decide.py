"""Decisions hold together whatever is in the documents, and no text breaks them."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from fnmatch import fnmatchcase

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pqsec_pki.access import INTERPRETATIONS, SPEC, Action, Question, Viewpoint, decide
from pqsec_pki.access import _patterns as patterns
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
from pqsec_pki.errors import PqsecError

NOW = datetime(2026, 6, 1, tzinfo=UTC)
DAY = timedelta(days=1)
SUBJECT = "CN=/robot"
ALL = DomainSet.of(DomainRange(first=0, last=230))
EVERYTHING = (Criteria(topics=("*",), partitions=("*",)),)

GLOBS = st.lists(st.sampled_from(["a", "b", "*", "?", "[ab]", "[!a]", "/"]), max_size=8).map(
    "".join
)
NAMES = st.text("ab/", min_size=1, max_size=8)
PARTITIONS = st.lists(st.sampled_from(["", "P", "Q"]), max_size=2).map(tuple)
CRITERIA = st.builds(
    Criteria,
    topics=st.lists(GLOBS.filter(bool), min_size=1, max_size=2).map(tuple),
    partitions=PARTITIONS,
)
SOME = st.lists(CRITERIA, max_size=2).map(tuple)
RULES = st.builds(
    PermissionRule,
    allow=st.booleans(),
    domains=st.just(ALL),
    publish=SOME,
    subscribe=SOME,
    relay=SOME,
)
GRANTS = st.builds(
    Grant,
    name=st.just("g"),
    subject_name=st.just(SUBJECT),
    not_before=st.just(NOW - DAY),
    not_after=st.just(NOW + DAY),
    rules=st.lists(RULES, max_size=4).map(tuple),
    default=st.sampled_from(DefaultAction),
)
GOVERNANCES = st.builds(
    lambda join, read, write: Governance(
        domain_rules=(
            replace(
                (rule := Governance.protected(ALL).domain_rules[0]),
                enable_join_access_control=join,
                topic_rules=(
                    replace(
                        rule.topic_rules[0],
                        enable_read_access_control=read,
                        enable_write_access_control=write,
                    ),
                ),
            ),
        )
    ),
    *(st.sampled_from([True, True, False]) for _ in range(3)),
)
QUESTIONS = st.builds(
    Question,
    subject=st.just(SUBJECT),
    domain=st.just(0),
    now=st.just(NOW),
    action=st.sampled_from([Action.PUBLISH, Action.SUBSCRIBE, Action.RELAY]),
    topic=NAMES,
    partitions=PARTITIONS,
)
READING = st.sampled_from(INTERPRETATIONS)


def of(*grants):
    return Permissions(grants=grants)


@given(GOVERNANCES, GRANTS, QUESTIONS, READING)
def test_it_comes_to_that_if_both_sides_let_it(governance, grant, question, interpretation):
    both = decide(governance, of(grant), question, interpretation)
    sides = [decide(governance, of(grant), question, interpretation, by=side) for side in Viewpoint]
    assert both.allowed is all(side.allowed for side in sides)


@given(GOVERNANCES, GRANTS, QUESTIONS, READING)
def test_what_decided_is_in_the_documents(governance, grant, question, interpretation):
    decision = decide(governance, of(grant), question, interpretation)
    [rule] = governance.domain_rules
    parts = (grant, *grant.rules, rule, *rule.topic_rules)
    assert any(decision.decided_by is part for part in parts)
    if decision.criteria:
        found = decision.decided_by
        said = (*found.publish, *found.subscribe, *found.relay)
        assert any(decision.criteria is each for each in said)
        assert found.allow is decision.allowed or not decision.allowed


@given(GOVERNANCES, GRANTS, QUESTIONS)
def test_a_deny_rule_for_all_in_front_only_takes_away(governance, grant, question):
    denying = PermissionRule(
        allow=False, domains=ALL, publish=EVERYTHING, subscribe=EVERYTHING, relay=EVERYTHING
    )
    before = decide(governance, of(grant), question)
    after = decide(governance, of(replace(grant, rules=(denying, *grant.rules))), question)
    assert before.allowed or not after.allowed


@given(GOVERNANCES, GRANTS, QUESTIONS)
def test_an_allow_rule_at_the_end_only_adds(governance, grant, question):
    allowing = PermissionRule(
        allow=True, domains=ALL, publish=EVERYTHING, subscribe=EVERYTHING, relay=EVERYTHING
    )
    before = decide(governance, of(grant), question)
    after = decide(governance, of(replace(grant, rules=(*grant.rules, allowing))), question)
    assert after.allowed or not before.allowed


@given(GOVERNANCES, GRANTS, QUESTIONS, READING)
def test_the_order_of_partitions_does_not_count(governance, grant, question, interpretation):
    turned = replace(question, partitions=question.partitions[::-1])
    decisions = [decide(governance, of(grant), each, interpretation) for each in (question, turned)]
    assert decisions[0].allowed is decisions[1].allowed


@given(GOVERNANCES, GRANTS, QUESTIONS)
def test_the_default_partition_has_no_name(governance, grant, question):
    decisions = {
        decide(governance, of(grant), replace(question, partitions=each)).allowed
        for each in ((), ("",))
    }
    assert len(decisions) == 1


@pytest.mark.parametrize("covers", [patterns.posix, patterns.posix_without_escapes])
@given(pattern=GLOBS, name=NAMES)
def test_a_pattern_covers_what_pythons_fnmatch_says(covers, pattern, name):
    assert covers(pattern, name) is fnmatchcase(name, pattern)


ANY_TEXT = st.text(st.characters() | st.sampled_from("*?[]!^-\\:.=ab"), max_size=20)


@given(pattern=ANY_TEXT, name=ANY_TEXT)
def test_any_text_is_a_pattern(pattern, name):
    for interpretation in INTERPRETATIONS:
        assert interpretation.covers(pattern, name) in {True, False}
        assert interpretation.governs(pattern, name) in {True, False}


@given(ANY_TEXT.filter(bool), ANY_TEXT, ANY_TEXT, READING)
def test_no_text_breaks_a_decision(topic, text, subject, interpretation):
    criteria = (Criteria(topics=(text,), partitions=(topic,)),)
    rule = PermissionRule(allow=True, domains=ALL, publish=criteria)
    try:
        grant = Grant(
            name=text,
            subject_name=text,
            not_before=NOW - DAY,
            not_after=NOW + DAY,
            rules=(rule,),
        )
        asked = {"domain": 0, "now": NOW, "action": Action.PUBLISH, "topic": topic}
        question = Question(subject=subject, partitions=(text,), **asked)
        decide(Governance.protected(ALL), of(grant), question, interpretation)
    except PqsecError:
        pass


def test_the_standard_is_the_reading_unless_another_is_asked_for():
    question = Question(subject=SUBJECT, domain=0, action=Action.RELAY, topic="a", now=NOW)
    rule = PermissionRule(allow=True, domains=ALL, relay=EVERYTHING)
    grant = Grant.least(subject_name=SUBJECT, not_before=NOW, not_after=NOW + DAY, domains=ALL)
    permissions = of(replace(grant, rules=(rule,)))
    governance = Governance.protected(ALL)
    standard = decide(governance, permissions, question, SPEC)
    assert decide(governance, permissions, question) == standard
    assert standard.allowed
