"""Rights added to a grant and removed from it, and the changes that are refused."""

from datetime import UTC, datetime, timedelta

import pytest

from pqsec_pki.access import (
    Action,
    Question,
    TopicRights,
    add_grant,
    add_rights,
    decide,
    granted_topics,
    remove_rights,
)
from pqsec_pki.documents import (
    Criteria,
    DefaultAction,
    DomainSet,
    Governance,
    Grant,
    PermissionRule,
    Permissions,
)
from pqsec_pki.errors import UsageError

NOW = datetime(2026, 1, 1, tzinfo=UTC)
ZERO, ONE = DomainSet.of(0), DomainSet.of(1)
SUBJECT = "CN=/talker"


def grant(*rules, default=DefaultAction.DENY):
    return Grant(
        name="/talker",
        subject_name=SUBJECT,
        not_before=NOW,
        not_after=NOW + timedelta(days=1),
        rules=rules,
        default=default,
    )


def rule(*topics, allow=True, domains=ZERO, **limits):
    return PermissionRule(
        allow=allow, domains=domains, publish=(Criteria(topics=topics, **limits),)
    )


def may_publish(found, topic, domain=0):
    question = Question(subject=SUBJECT, domain=domain, action=Action.PUBLISH, topic=topic, now=NOW)
    governance = Governance.protected(DomainSet.of(0, 1))
    return decide(governance, Permissions(grants=(found,)), question).allowed


def rights(*topics):
    return TopicRights(publish=topics)


def test_what_a_grant_allows_is_all_that_its_allow_rules_have_or_what_meets_a_topic():
    found = grant(rule("a", "b*"), rule("c", allow=False))
    assert granted_topics(found, Action.PUBLISH) == ["a", "b*"]
    assert granted_topics(found, Action.PUBLISH, "bc") == ["b*"]
    assert granted_topics(found, Action.PUBLISH, "c") == []
    assert granted_topics(found, Action.SUBSCRIBE) == []


def test_a_right_is_added_to_the_rule_of_its_domains():
    found = add_rights(grant(rule("a")), TopicRights(publish=("b",), subscribe=("c",)), ZERO)
    assert found.rules == (
        PermissionRule(
            allow=True,
            domains=ZERO,
            publish=(Criteria(topics=("a", "b")),),
            subscribe=(Criteria(topics=("c",)),),
        ),
    )
    assert may_publish(found, "b")


def test_a_right_on_another_domain_gets_a_rule_of_its_own():
    found = add_rights(grant(rule("a")), rights("b"), ONE)
    assert found.rules == (rule("a"), rule("b", domains=ONE))
    assert [may_publish(found, "b", domain) for domain in (0, 1)] == [False, True]


def test_what_is_allowed_already_is_not_added_again():
    for allowed, topic in (("a", "a"), ("rt/*", "rt/a"), ("rt/*", "rt/[ab]*")):
        before = grant(rule(allowed))
        assert add_rights(before, rights(topic), ZERO) == before
    wider = DomainSet.of(0, 1)
    assert may_publish(add_rights(grant(rule("a")), rights("a"), wider), "a", 1)


LIMITS = ({"partitions": ("p",)}, {"data_tags": (("k", "v"),)})


def test_a_limited_right_does_not_count_as_allowed_and_stays_limited():
    for limits in LIMITS:
        found = add_rights(grant(rule("a", **limits)), rights("a", "b"), ZERO)
        assert may_publish(found, "a")
        limited, plain = found.rules[0].publish
        assert limited == Criteria(topics=("a",), **limits)
        assert plain == Criteria(topics=("a", "b"))


def test_a_participant_without_topics_gets_its_first():
    empty = Grant.least(
        subject_name=SUBJECT, not_before=NOW, not_after=NOW + timedelta(days=1), domains=ZERO
    )
    assert not may_publish(empty, "a")
    found = add_rights(empty, rights("a"), ZERO)
    assert may_publish(found, "a")
    assert remove_rights(found, rights("a")).rules == empty.rules


def test_a_denied_topic_is_not_added():
    denies = rule("secret*", allow=False)
    for rules in ((denies, rule("a")), (rule("a"), denies)):
        for topic in ("secret/x", "s*"):
            with pytest.raises(UsageError, match=r"may not publish .*: the deny rule denies it"):
                add_rights(grant(*rules), rights(topic), ZERO)


def test_a_deny_rule_of_another_domain_hides_nothing():
    found = add_rights(grant(rule("a", allow=False, domains=ONE), rule("b")), rights("a"), ZERO)
    assert may_publish(found, "a")
    assert not may_publish(found, "a", domain=1)


def test_a_deny_rule_that_hides_rules_below_it_stays():
    """Without it, the rule below would allow again."""
    everything = PermissionRule.deny_all(ZERO)
    with pytest.raises(UsageError, match="denies it"):
        add_rights(grant(everything, rule("a")), rights("b"), ZERO)
    with pytest.raises(UsageError, match="denies it"):
        add_rights(grant(everything, default=DefaultAction.ALLOW), rights("b"), ZERO)


def test_a_right_is_removed_from_all_rules():
    before = grant(
        rule("a", "b"), rule("a", domains=ONE), rule("a", partitions=("p",)), rule("x", allow=False)
    )
    found = remove_rights(before, rights("a"))
    assert found.rules == (rule("b"), rule("x", allow=False))
    assert not may_publish(found, "a")
    assert remove_rights(found, rights("a")) == found


def test_a_right_that_a_pattern_still_allows_is_not_removed():
    with pytest.raises(UsageError, match=r"may still publish rt/a: the allow rule allows rt/\*"):
        remove_rights(grant(rule("rt/a", "rt/*", "x")), rights("rt/a"))
    with pytest.raises(UsageError, match="may still publish"):
        remove_rights(grant(rule("rt/a"), rule("*", partitions=("p",))), rights("rt/a"))
    with pytest.raises(UsageError, match="its grant allows by default"):
        remove_rights(grant(rule("a"), default=DefaultAction.ALLOW), rights("a"))


def test_a_right_that_a_deny_rule_also_names_can_be_removed():
    denied = rule("a", allow=False)
    found = remove_rights(grant(denied, rule("a", "b")), rights("a"))
    assert found.rules == (denied, rule("b"))


def test_criteria_without_topics_are_removed_with_their_last():
    """A document with an empty list of topics is not valid."""
    limited = Criteria(topics=("b",), data_tags=(("k", "v"),))
    both = PermissionRule(allow=True, domains=ZERO, publish=(Criteria(topics=("a",)), limited))
    (left,) = remove_rights(grant(both), rights("a")).rules
    assert left.publish == (limited,)


def test_only_the_named_action_is_removed():
    both = PermissionRule(
        allow=True,
        domains=ZERO,
        publish=(Criteria(topics=("a",)),),
        subscribe=(Criteria(topics=("a",)),),
    )
    found = remove_rights(grant(both), rights("a"))
    assert found.rules == (
        PermissionRule(allow=True, domains=ZERO, subscribe=(Criteria(topics=("a",)),)),
    )


def test_an_empty_topic_is_not_added_and_can_be_removed():
    with pytest.raises(UsageError, match="crashes Cyclone DDS"):
        add_rights(grant(rule("a")), rights(""), ZERO)
    assert remove_rights(grant(rule("a", "")), rights("")).rules == (rule("a"),)


def test_a_grant_without_rules_has_nothing_to_remove():
    assert remove_rights(grant(), rights("a")) == grant()


def test_a_topic_that_is_listed_twice_is_removed():
    found = remove_rights(grant(rule("a", "a"), rule("b")), rights("a"))
    assert found.rules == (rule("b"),)


def test_a_grant_is_added_with_its_limits_and_domains():
    limited = Criteria(topics=("m",), partitions=("p", "q"))
    more = grant(
        PermissionRule(
            allow=True,
            domains=ONE,
            publish=(Criteria(topics=("b", "c")), limited),
            subscribe=(Criteria(topics=("d",)),),
            relay=(Criteria(topics=("e",)),),
        )
    )
    found = add_grant(grant(rule("a"), rule("b", domains=ONE)), more)
    assert found.rules == (
        rule("a"),
        PermissionRule(
            allow=True,
            domains=ONE,
            publish=(Criteria(topics=("b", "c")), limited),
            subscribe=(Criteria(topics=("d",)),),
            relay=(Criteria(topics=("e",)),),
        ),
    )
    assert add_grant(found, more) == found
    turned = grant(rule("m", domains=ONE, partitions=("q", "p")))
    assert add_grant(found, turned) == found
    assert add_grant(grant(), grant()) == grant()


def test_a_right_without_limits_does_not_count_for_one_with_them():
    for limits in LIMITS:
        found = add_grant(grant(rule("a")), grant(rule("a", **limits)))
        assert found.rules[0].publish == (
            Criteria(topics=("a",)),
            Criteria(topics=("a",), **limits),
        )


def test_a_grant_that_denies_or_allows_by_default_is_not_added():
    for more in (grant(rule("x", allow=False), rule("*")), grant(default=DefaultAction.ALLOW)):
        with pytest.raises(UsageError, match="denies, or allows by default"):
            add_grant(grant(rule("a")), more)
    nothing = grant(PermissionRule.deny_all(ZERO))
    assert add_grant(grant(rule("a")), nothing) == grant(rule("a"))


def test_what_is_denied_is_not_added_by_a_grant():
    denies = rule("secret*", allow=False)
    for limits in ({}, *LIMITS):
        with pytest.raises(UsageError, match="may not publish secret/x"):
            add_grant(grant(denies, rule("a")), grant(rule("secret/x", **limits)))
