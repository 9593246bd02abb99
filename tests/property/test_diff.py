"""The diff and the engine never disagree, whatever the policies."""

import random
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import combinations, product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pqsec_pki.access import Action, Question, decide
from pqsec_pki.access._patterns import posix
from pqsec_pki.access._rights import Dimensions
from pqsec_pki.access._topics import Extent, SampleNames
from pqsec_pki.access._witnesses import is_wildcard, witnesses
from pqsec_pki.access.diff import permissions_diff
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
from tests.interop.policies import PARTITIONS, TOPIC_PATTERNS, Maker
from tests.longer import examples, seeds

EVERYWHERE = Governance.protected(DomainSet(parts=(DomainRange(first=0),)))
SUBJECT = "CN=/robot"
NAMES = st.text("abrt/]-[*", min_size=1, max_size=6)
ACTIONS = (Action.PUBLISH, Action.SUBSCRIBE, Action.RELAY)


@pytest.fixture(scope="module")
def now():
    return datetime.now(UTC)


@settings(max_examples=examples(300))
@given(st.lists(st.sampled_from(TOPIC_PATTERNS), max_size=6), NAMES)
def test_every_name_meets_the_patterns_as_some_witness_does(patterns, name):
    def met(each):
        return {p for p in patterns if (posix(p, each) if is_wildcard(p) else p == each)}

    found = witnesses(patterns)
    assert found.complete
    assert met(name) in [met(witness) for witness in found.names]


@settings(max_examples=examples(300))
@given(st.dictionaries(st.sampled_from(TOPIC_PATTERNS), st.booleans(), max_size=6), NAMES)
def test_what_is_said_of_a_pattern_holds_for_every_name(rules, name):
    def covered(pattern, each):
        return posix(pattern, each) if is_wildcard(pattern) else pattern == each

    def allowed(each):
        return next((allow for pattern, allow in rules.items() if covered(pattern, each)), False)

    samples = SampleNames(rules)
    told = samples.described(frozenset(filter(allowed, samples.names)))
    about = [each for each in told if covered(each.name, name)]
    but = any(covered(pattern, name) for each in about for pattern in each.but)
    if any(each.extent in (Extent.ALL, Extent.ONE) for each in about):
        assert allowed(name)
    assert not (but and allowed(name))
    assert bool(about) >= allowed(name)


@pytest.mark.slow
@pytest.mark.parametrize("seed", seeds(60, 6))
def test_all_topics_at_once_are_decided_as_one_by_one(seed, now):
    [grant, *_] = Maker(seed).permissions(SUBJECT).grants
    grant = in_force(grant)
    dimensions = Dimensions.of([grant])
    rights = dimensions.rights(grant)
    for action, domain, partitions, tags in product(
        ACTIONS, dimensions.domains, dimensions.partition_sets.tried[:6], dimensions.tag_sets.tried
    ):
        if any(map(is_wildcard, partitions)):
            continue  # names that no endpoint can ask for: its partitions are expressions
        for topic in dimensions.topics.names:
            allowed = ask(
                Permissions(grants=(grant,)),
                now,
                action=action,
                domain=domain.first,
                partitions=partitions,
                data_tags=tags,
                topic=topic,
                subject=grant.subject_name,
            )
            here = rights.get((action, domain, partitions, tags), frozenset())
            assert allowed is (topic in here), (grant, action, domain, partitions, tags, topic)


@pytest.mark.parametrize("seed", seeds(60, 2))
def test_where_no_change_is_told_no_question_finds_one(seed, now):
    """Rules are shuffled, which changes something or not."""
    [old, *_] = Maker(seed).permissions(SUBJECT).grants
    old = in_force(old)
    rules = list(old.rules)
    random.Random(seed).shuffle(rules)  # noqa: S311 -- the same order every time
    before = Permissions(grants=(old,))
    after = Permissions(grants=(replace(old, rules=tuple(rules)),))
    difference = permissions_diff(before, after)
    differs = any(
        ask(before, now, subject=old.subject_name, **each)
        is not ask(after, now, subject=old.subject_name, **each)
        for each in questions()
    )
    assert difference.complete
    assert difference.changes or not differs


WORDS = ("P", "Q", "R", "S")
EXPRESSIONS = (("*",), ("?",), ("P*",), ("", "?*"), ("P", "Q?"))
TAGS = tuple(("k", word) for word in WORDS)
RULES = st.lists(
    st.builds(
        lambda allow, partitions, tags: PermissionRule(
            allow=allow,
            domains=DomainSet(parts=(DomainRange(first=0),)),
            publish=(Criteria(topics=("a",), partitions=tuple(partitions), data_tags=tuple(tags)),),
        ),
        st.booleans(),
        st.sets(st.sampled_from(("", "*", *WORDS[:3]))).map(sorted),
        st.sets(st.sampled_from(TAGS[:3]), max_size=2).map(sorted),
    ),
    max_size=4,
)
DEFAULTS = st.sampled_from(list(DefaultAction))


@settings(max_examples=examples(150))
@given(RULES, DEFAULTS, RULES, DEFAULTS)
def test_a_change_is_told_where_any_set_of_partitions_and_tags_finds_one(
    now, old, old_default, new, new_default
):
    before, after = (
        Permissions(grants=(made(rules, default, now),))
        for rules, default in ((old, old_default), (new, new_default))
    )
    difference = permissions_diff(before, after)
    subject = {"subject": SUBJECT, "domain": 0}
    asked = [
        {"action": action, "topic": topic, "partitions": partitions, "data_tags": tags}
        for (action, topic), (partitions, tags) in [
            *product(
                [(Action.PUBLISH, "a")], product([*subsets(WORDS), *EXPRESSIONS], subsets(TAGS))
            ),
            # no rule is about these
            *product([(Action.SUBSCRIBE, "a"), (Action.PUBLISH, "b")], [((), ()), (WORDS, TAGS)]),
        ]
    ]
    differs = any(
        ask(before, now, **subject, **each) is not ask(after, now, **subject, **each)
        for each in [{"action": Action.JOIN}, *asked]
    )
    by_standard = [change for change in difference.changes if change.interpretation == "spec"]
    assert difference.complete
    assert bool(by_standard) is differs


def made(rules, default, now):
    year = timedelta(365)
    return Grant(
        name="g",
        subject_name=SUBJECT,
        not_before=now - year,
        not_after=now + year,
        rules=tuple(rules),
        default=default,
    )


def subsets(items):
    return [some for size in range(len(items) + 1) for some in combinations(items, size)]


def questions():
    topics = ("a", "ab", "aab", "rt/a", "rt/]", "-b", "*", "[a]", "zz")
    for action, domain, topic, partitions in product(
        ACTIONS, (0, 1, 5, 9), topics, (*PARTITIONS, *EXPRESSIONS)
    ):
        if len(partitions) < 3:
            yield {"action": action, "domain": domain, "topic": topic, "partitions": partitions}


def ask(permissions, now, **asked):
    return decide(EVERYWHERE, permissions, Question(now=now, **asked)).allowed


def in_force(grant):
    return replace(
        grant,
        not_before=datetime(2000, 1, 1, tzinfo=UTC),
        not_after=datetime(2200, 1, 1, tzinfo=UTC),
    )
