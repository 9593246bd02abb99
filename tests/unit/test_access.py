"""May a participant join? Each answer, and what decided."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from pqsec_pki.access import may_join
from pqsec_pki.documents import DefaultAction, DomainSet, Governance, Grant, Permissions
from pqsec_pki.errors import MalformedError, UsageError

START = datetime(2026, 1, 1, tzinfo=UTC)
END = datetime(2027, 1, 1, tzinfo=UTC)
NOW = datetime(2026, 6, 1, tzinfo=UTC)
GOVERNANCE = Governance.protected(DomainSet.of(0, 1))
GRANT = Grant.least(
    subject_name="CN=/robot,O=Lab",
    not_before=START,
    not_after=END,
    domains=DomainSet.of(0),
    publish=["rt/chatter"],
)


def ask(*grants, governance=GOVERNANCE, subject="CN=/robot,O=Lab", domain=0, now=NOW):
    return may_join(governance, Permissions(grants=grants or (GRANT,)), subject, domain, now)


def without_join_control():
    return Governance(
        domain_rules=tuple(
            replace(rule, enable_join_access_control=False) for rule in GOVERNANCE.domain_rules
        )
    )


def with_open_topics():
    [rule] = GOVERNANCE.domain_rules
    [topics] = rule.topic_rules
    opened = replace(rule, topic_rules=(replace(topics, enable_read_access_control=False),))
    return Governance(domain_rules=(opened,))


def test_an_allow_rule_for_the_domain_lets_in():
    decision = ask()
    assert decision.allowed
    assert decision.decided_by == GRANT.rules[0]
    assert "allow_rule for domain 0" in decision.reason


@pytest.mark.parametrize("subject", ["O=Lab,CN=/robot", "/O=Lab/CN=/robot", "CN = /robot, O = Lab"])
def test_the_subject_may_be_spelled_in_another_way(subject):
    assert ask(subject=subject).allowed


@pytest.mark.parametrize("subject", ["CN=/robot", "CN=/robot/admin,O=Lab", "CN=/robot,O=Lab,C=ES"])
def test_a_subject_that_shares_only_parts_of_the_name_has_no_grant(subject):
    decision = ask(subject=subject)
    assert not decision.allowed
    assert decision.reason == f"no grant is for {subject}"


def test_a_domain_without_governance_is_closed_whatever_the_grant():
    grant = replace(GRANT, default=DefaultAction.ALLOW)
    assert ask(grant, domain=7).reason == "no governance rule names domain 7"
    assert not ask(grant, domain=7).allowed


def test_the_first_governance_rule_that_names_the_domain_governs():
    closed, opened = GOVERNANCE.domain_rules[0], without_join_control().domain_rules[0]
    assert not ask(governance=Governance(domain_rules=(closed, opened)), domain=1).allowed
    assert ask(governance=Governance(domain_rules=(opened, closed)), domain=1).allowed


def test_a_grant_is_in_force_from_its_first_to_its_last_second():
    assert ask(now=START).allowed
    assert ask(now=END).allowed
    early, late = ask(now=START - timedelta(seconds=1)), ask(now=END + timedelta(seconds=1))
    assert not early.allowed
    assert "starts at 2026-01-01" in early.reason
    assert not late.allowed
    assert "ended at 2027-01-01" in late.reason
    assert late.decided_by == GRANT


def test_without_join_control_a_grant_in_force_suffices():
    governance = without_join_control()
    assert ask(governance=governance, domain=1).allowed
    assert not ask(governance=governance, domain=1, now=END + timedelta(days=1)).allowed
    assert not ask(governance=governance, domain=1, subject="CN=/stranger").allowed


def test_an_allow_rule_for_another_domain_does_not_let_in():
    decision = ask(domain=1)
    assert not decision.allowed
    assert decision.decided_by == GRANT


def test_open_topics_do_not_let_in_since_the_peers_refuse():
    assert not ask(governance=with_open_topics(), domain=1).allowed


def test_a_grant_that_denies_all_does_not_let_in():
    assert not ask(replace(GRANT, rules=(replace(GRANT.rules[0], allow=False),))).allowed


def test_a_deny_rule_before_an_allow_rule_does_not_keep_out():
    [allow] = GRANT.rules
    assert ask(replace(GRANT, rules=(replace(allow, allow=False), allow))).allowed


def test_a_default_of_allow_lets_in_where_no_rule_does():
    decision = ask(replace(GRANT, rules=(), default=DefaultAction.ALLOW), domain=1)
    assert decision.allowed
    assert "default" in decision.reason


def test_of_two_grants_for_a_subject_the_first_decides_even_if_expired():
    expired = replace(GRANT, not_after=START)
    assert not ask(expired, GRANT).allowed
    assert ask(GRANT, expired).allowed


def test_a_second_grant_may_carry_the_second_spelling():
    assert ask(replace(GRANT, subject_name="CN=/other"), GRANT).allowed


def test_a_grant_for_gibberish_is_for_nobody():
    assert not ask(replace(GRANT, subject_name="gibberish")).allowed
    with pytest.raises(MalformedError):
        ask(replace(GRANT, subject_name="gibberish"), subject="gibberish")


def test_a_time_without_a_zone_is_no_time():
    with pytest.raises(UsageError, match="no time zone"):
        ask(now=datetime(2026, 6, 1))  # noqa: DTZ001 - the flaw under test
