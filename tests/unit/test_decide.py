"""Who may do what: each rule of the standard, and where each stack reads otherwise."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone

import pytest

from pqsec_pki.access import (
    CYCLONEDDS,
    CYCLONEDDS_11,
    FASTDDS,
    INTERPRETATIONS,
    OPENDDS,
    SPEC,
    Action,
    InterpretedPolicy,
    Protection,
    Question,
    Viewpoint,
    _subjects,
    decide,
    interpretations_named,
    names_of,
)
from pqsec_pki.access import _patterns as patterns
from pqsec_pki.access._expressions import Budget, meets, within
from pqsec_pki.documents import (
    Criteria,
    DefaultAction,
    DomainRange,
    DomainSet,
    Governance,
    Grant,
    PermissionRule,
    Permissions,
    ProtectionKind,
)
from pqsec_pki.errors import MalformedError, UsageError

NOW = datetime(2026, 6, 1, tzinfo=UTC)
DAY = timedelta(days=1)
SUBJECT = "CN=/robot"
HERE, ELSEWHERE = DomainSet.of(0), DomainSet.of(5)
PUBLISH, SUBSCRIBE, RELAY, JOIN = Action
ALL_NAMES = ("spec", "cyclonedds@0.10", "cyclonedds@11.0", "fastdds", "opendds")


RULES = (PermissionRule(allow=True, domains=HERE, publish=(Criteria(topics=("a",)),)),)


def criteria(*topics, partitions=(), tags=()):
    return (Criteria(topics=topics, partitions=partitions, data_tags=tags),)


def allow(*publish, domains=HERE, **more):
    return PermissionRule(allow=True, domains=domains, publish=publish, **more)


def deny(*publish, domains=HERE, **more):
    return PermissionRule(allow=False, domains=domains, publish=publish, **more)


def grant(*rules, default=DefaultAction.DENY, subject=SUBJECT, start=NOW - DAY, end=NOW + DAY):
    return Grant(
        name="g",
        subject_name=subject,
        not_before=start,
        not_after=end,
        rules=rules,
        default=default,
    )


def governance(*topic_rules, join=True, domains=HERE):
    """Everything is protected, but for a topic named `open`, and `topic_rules` come first."""
    [rule] = Governance.protected(domains).domain_rules
    [last] = rule.topic_rules
    rules = (*topic_rules, topics("open", read=False), last)
    changed = replace(rule, topic_rules=rules, enable_join_access_control=join)
    return Governance(domain_rules=(changed,))


def topics(expression, *, read=True, write=True):
    [rule] = Governance.protected(HERE).domain_rules[0].topic_rules
    return replace(
        rule,
        topic_expression=expression,
        enable_read_access_control=read,
        enable_write_access_control=write,
    )


def question(action=PUBLISH, topic="a", **more):
    asked = {"subject": SUBJECT, "domain": 0, "now": NOW, "action": action} | more
    return Question(topic=None if action is JOIN else topic, **asked)


def ask(*rules, by=None, interpretation=SPEC, governed=None, default=DefaultAction.DENY, **asked):
    permissions = Permissions(grants=(grant(*rules, default=default),))
    return decide(governed or governance(), permissions, question(**asked), interpretation, by=by)


# The standard.


def test_cyclone_knows_grants_for_subjects_of_twenty_parts_and_no_more():
    twenty = ",".join(["CN=r", *(f"OU={each}" for each in range(19))])
    assert _subjects.cyclonedds(twenty, "CN=r")
    assert not _subjects.cyclonedds(f"{twenty},OU=x", "CN=r")


def test_a_question_asked_in_another_time_zone_is_the_same_question():
    there = timezone(timedelta(hours=2))
    assert question(now=NOW.astimezone(there)) == question()
    assert question(now=NOW.astimezone(there)).now.tzinfo is UTC


def test_a_pattern_that_is_the_name_of_a_topic_does_not_allow_that_topic():
    assert ask(allow(*criteria("[ab]")), topic="a").allowed
    assert not ask(allow(*criteria("[ab]")), topic="[ab]").allowed
    assert ask(allow(*criteria("\\[ab]")), topic="[ab]").allowed


def test_a_rule_that_has_the_topic_allows():
    rule = allow(*criteria("b", "a*"))
    decision = ask(rule, topic="ab")
    assert decision.allowed
    assert decision.decided_by is rule
    assert decision.criteria is rule.publish[0]
    assert decision.reason == "an allow_rule of grant 'g' lets it publish 'ab' on domain 0"


@pytest.mark.parametrize(
    "asked", [{"topic": "b"}, {"action": SUBSCRIBE}, {"action": RELAY}, {"partitions": ("P",)}]
)
def test_what_no_rule_has_the_default_decides(asked):
    rule = allow(*criteria("a"))
    denied, allowed = ask(rule, **asked), ask(rule, default=DefaultAction.ALLOW, **asked)
    assert not denied.allowed
    assert allowed.allowed
    assert "its default is DENY" in denied.reason
    assert denied.decided_by.name == "g"


@pytest.mark.parametrize("action", ["publish", "subscribe", "relay"])
def test_each_action_has_its_own_criteria(action):
    rule = PermissionRule(allow=True, domains=HERE, **{action: criteria("a")})
    assert [ask(rule, action=each).allowed for each in (PUBLISH, SUBSCRIBE, RELAY)] == [
        each == action for each in ("publish", "subscribe", "relay")
    ]


def test_the_first_rule_that_has_the_topic_decides():
    yes, no = allow(*criteria("*")), deny(*criteria("a"))
    assert ask(yes, no).allowed
    denied = ask(no, yes)
    assert denied.reason == "a deny_rule of grant 'g' forbids it to publish 'a' on domain 0"
    assert denied.decided_by is no
    assert ask(no, yes, topic="b").allowed


def test_a_rule_for_another_domain_does_not_count():
    assert not ask(allow(*criteria("a"), domains=ELSEWHERE)).allowed
    assert ask(deny(*criteria("a"), domains=ELSEWHERE), allow(*criteria("a"))).allowed


@pytest.mark.parametrize(
    ("named", "used", "allowed", "denied"),
    [
        ((), (), True, True),
        ((), ("",), True, True),
        ((), ("P",), False, True),
        (("P",), (), False, False),
        (("P",), ("P",), True, True),
        (("P",), ("P", "Q"), False, True),
        (("P", "Q"), ("Q", "P"), True, True),
        (("P*",), ("P", "PQ"), True, True),
        (("*",), (), True, True),
        (("?",), ("PQ",), False, False),
    ],
)
def test_partitions_are_all_allowed_or_one_denied(named, used, allowed, denied):
    met = criteria("a", partitions=named)
    assert ask(allow(*met), partitions=used).allowed is allowed
    assert ask(deny(*met), allow(*criteria("*", partitions=("*",))), partitions=used).allowed is (
        not denied
    )


EXPRESSIONS = [  # of the rule, of the endpoint, whether the one allows and denies the other
    (("floor?",), "floor*", False, True),
    (("floor?",), "floor?", True, True),
    (("floor*",), "floor?", True, True),
    (("secret",), "secre?", False, True),
    (("secret",), "s*", False, True),
    (("secret",), "*", False, True),
    (("secret",), "p*", False, False),
    (("*",), "*", True, True),
    (("?*",), "*", False, True),  # the default partition
    (("?*", ""), "*", True, True),
    (("a*", "[!a]*", ""), "*", True, True),
    (("[!a]*",), "a*", False, False),
    (("a*b",), "a*c", False, False),
    (("a*b", "a*[!b]", "a"), "a*", True, True),
    (("[b-a]*",), "*", False, False),  # covers nothing
    ((), "*", False, True),
    (("[ab]",), "[ab]", False, True),  # a name to Cyclone DDS
    (("a", "b"), "[ab]", False, True),
    (("c",), "x[ab]", False, False),
    (("xc",), "x[ab]", False, True),  # in doubt
    (("x*",), "x[ab]", True, True),
    (("x",), "\\x", False, True),
]


def test_partitions_that_are_expressions_are_contained_or_met():
    wrong = []
    for named, used, allowed, denied in EXPRESSIONS:
        met = criteria("a", partitions=named)
        may = ask(allow(*met), partitions=(used,)).allowed
        everything = allow(*criteria("*", partitions=("*",)))
        may_not = not ask(deny(*met), everything, partitions=(used,)).allowed
        if (may, may_not) != (allowed, denied):
            wrong.append((named, used, may, may_not))
    assert not wrong


def test_one_expression_of_several_partitions_is_enough_to_deny_and_not_to_allow():
    everything = allow(*criteria("a", partitions=("*",)))
    denied = ask(deny(*criteria("a", partitions=("secret",))), everything, partitions=("p", "s*"))
    assert denied.reason == (
        "a deny_rule of grant 'g' forbids it to publish 'a' in partitions 'p', 's*' on domain 0"
    )
    rule = allow(*criteria("a", partitions=("p*",)))
    assert ask(rule, partitions=("p?", "pq*")).allowed
    assert not ask(rule, partitions=("p?", "s*")).allowed


def test_of_many_partitions_a_few_are_said():
    decision = ask(allow(*criteria("a")), partitions=tuple("pqrstu"))
    assert "in partitions 'p', 'q', 'r', 's' and 2 more on domain 0" in decision.reason


def test_what_an_expression_with_a_bracket_is_taken_for_is_said():
    decision = ask(allow(*criteria("a", partitions=("[ab]",))), partitions=("[ab]",))
    assert "in partition '[ab]' (taken for '*')" in decision.reason


# A pattern with so many places after a star has more sets of them than can be walked through.
MANY_SETS = "*a" + "?" * 40


def test_what_takes_too_many_steps_to_compare_is_denied_in_doubt():
    rule = allow(*criteria("a", partitions=(MANY_SETS,)))
    decision = ask(rule, partitions=(f"*{MANY_SETS}",))
    assert not decision.allowed
    assert decision.reason.startswith(
        "comparing its partitions with those of the rules takes too many steps"
    )
    other = ask(deny(*criteria("a", partitions=("b",))), rule, partitions=(f"*{MANY_SETS}", "b"))
    assert not other.reason.startswith(
        "comparing its partitions with those of the rules takes too many steps"
    )


def test_wherever_the_steps_end_nothing_is_allowed_that_is_not():
    rules, budget, most = ["a?*", "[!a]*", ""], Budget(), Budget().left
    assert within("*", [*rules, "a"], budget)
    for left in range(most - budget.left):
        assert not within("*", rules, Budget(left))
        spent = Budget(left)
        assert within("*", [*rules, "a"], spent) is not spent.spent


def test_nothing_is_compared_when_no_step_is_left():
    def patterns():
        raise AssertionError("asked for")
        yield

    spent = Budget(-1)
    assert (within("*", patterns(), spent), meets("*", patterns(), spent)) == (False, True)


@pytest.mark.parametrize("compare", [within, meets])
def test_hostile_expressions_share_the_steps_of_one_question(compare):
    budget, rules = Budget(), [f"{each}{'*?[!b]' * 40}" for each in "abcdefgh"]
    for _ in range(1000):
        compare("*?" * 128, rules, budget)
    assert -10 < budget.left < 0


@pytest.mark.parametrize(
    ("named", "used", "allowed", "denied"),
    [
        ("", "", True, True),
        ("", "x", False, True),
        ("x", "", True, False),
        ("x", "x", True, True),
        ("x", "xy", False, True),
        ("xy", "y", True, True),
        ("x", "y", False, False),
    ],
)
def test_data_tags_are_all_allowed_or_one_denied(named, used, allowed, denied):
    tags = tuple(("kind", each) for each in named)
    asked = {"data_tags": tuple(("kind", each) for each in used)}
    assert ask(allow(*criteria("a", tags=tags)), **asked).allowed is allowed
    assert ask(deny(*criteria("a", tags=tags)), default=DefaultAction.ALLOW, **asked).allowed is (
        not denied
    )


def test_a_near_miss_is_told():
    decision = ask(allow(*criteria("a", partitions=("P",))), partitions=("Q",))
    assert "publish 'a' in partition 'Q'" in decision.reason
    assert "allow_rule has the topic, but for other partitions or data tags" in decision.reason


def test_what_governance_opens_needs_no_rule_for_the_topic():
    member, rule = allow(*criteria("other")), topics("a", write=False)
    decision = ask(member, governed=governance(rule))
    assert decision.allowed
    assert decision.decided_by is rule
    assert "lets every participant publish 'a'" in decision.reason
    assert not ask(member, governed=governance(rule), action=SUBSCRIBE).allowed


def test_what_governance_opens_is_closed_to_those_who_may_not_join():
    opened = governance(topics("a", write=False))
    denied = ask(governed=opened)
    assert denied.reason == "grant 'g' has no allow_rule for domain 0"
    assert ask(governed=opened, by=Viewpoint.OWN).allowed
    assert ask(governed=governance(topics("a", write=False), join=False)).allowed
    closed = governance().domain_rules[0]
    [last] = closed.topic_rules[-1:]
    for rules, allowed in (
        ((last,), False),
        ((topics("a", write=False), last), True),
        ((topics("a", read=False), last), True),
    ):
        governed = Governance(domain_rules=(replace(closed, topic_rules=rules),))
        assert ask(governed=governed, action=JOIN, by=Viewpoint.OWN).allowed == allowed


def test_the_first_topic_rule_that_has_the_topic_governs():
    closed, opened = topics("a"), topics("*", write=False)
    member = allow(*criteria("other"))
    assert not ask(member, governed=governance(closed, opened)).allowed
    assert ask(member, governed=governance(opened, closed)).allowed


def test_a_topic_that_no_topic_rule_has_cannot_be_used():
    [rule] = Governance.protected(HERE).domain_rules
    governed = Governance(domain_rules=(replace(rule, topic_rules=(topics("b"),)),))
    decision = ask(allow(*criteria("*")), governed=governed)
    assert decision.reason == "no topic rule of governance covers 'a' on domain 0"


def test_a_decision_knows_the_line_of_what_decided():
    permissions = Permissions(grants=(grant(allow(*criteria("x")), deny(*criteria("a"))),))
    xml = permissions.to_xml()
    decision = decide(governance(), Permissions.from_xml(xml), question())
    lines = xml.decode().splitlines()
    assert "<deny_rule>" in lines[decision.decided_by.line - 1]
    assert "<publish>" in lines[decision.criteria.line - 1]


def test_a_decision_says_how_traffic_is_protected():
    decision = ask(allow(*criteria("a")))
    assert decision.protection == Protection(
        data=ProtectionKind.ENCRYPT,
        metadata=ProtectionKind.ENCRYPT,
        discovery=ProtectionKind.ENCRYPT,
        liveliness=ProtectionKind.ENCRYPT,
        rtps=ProtectionKind.SIGN,
        allow_unauthenticated_participants=False,
    )
    assert decision.protection.words == (
        "payload: encrypted: only members can read it and make it",
        "submessages: encrypted: only members can read it and make it",
        "discovery: encrypted: only members can read it and make it",
        "liveliness: encrypted: only members can read it and make it",
        "whole messages: signed: anyone on the network can read it, only members can make it",
        "participants without credentials: may not take part",
    )


def test_a_topic_may_be_announced_in_the_clear_where_others_are_not():
    rule = replace(topics("a"), enable_discovery_protection=False)
    protection = ask(governed=governance(rule)).protection
    assert protection.discovery is ProtectionKind.NONE
    assert protection.liveliness is ProtectionKind.ENCRYPT
    joining = ask(governed=governance(rule), action=JOIN).protection
    assert joining.discovery is ProtectionKind.ENCRYPT
    assert joining.data is None
    assert not [words for words in joining.words if words.startswith("payload")]


@pytest.mark.parametrize("interpretation", INTERPRETATIONS, ids=lambda each: each.name)
def test_many_questions_of_one_policy_are_answered_as_one_by_one(interpretation):
    permissions = Permissions(grants=(grant(allow(*criteria("a")), deny(*criteria("b"))),))
    policy = InterpretedPolicy(governance(), permissions, interpretation)
    for domain in (0, 5):
        for topic in "abc":
            asked = question(topic=topic, domain=domain)
            assert policy.decide(asked) == decide(governance(), permissions, asked, interpretation)


# The stacks. A case is what is asked of which documents, and who says yes.

CASES = {
    "a deny_rule in another partition": (
        [deny(*criteria("a", partitions=("Q",))), allow(*criteria("a", partitions=("P",)))],
        {"partitions": ("P",)},
        "spec opendds",
    ),
    "a deny_rule without partitions, in a partition": (
        [allow(subscribe=criteria("a")), deny(*criteria("a"))],
        {"partitions": ("P",), "default": DefaultAction.ALLOW},
        "cyclonedds",
    ),
    "a deny_rule for subscribers": (
        [deny(subscribe=criteria("a")), allow(*criteria("a"))],
        {},
        "spec cyclonedds@11.0 fastdds opendds",
    ),
    "a deny_rule for publishers, in a partition, where the default allows subscribing": (
        [deny(*criteria("a"))],
        {"partitions": ("P",), "default": DefaultAction.ALLOW},
        "cyclonedds@11.0",
    ),
    "deny_rules for both, the one for subscribers below an allow_rule": (
        [deny(*criteria("a")), allow(subscribe=criteria("a")), deny(subscribe=criteria("a"))],
        {"action": SUBSCRIBE},
        "spec cyclonedds@11.0 fastdds opendds",
    ),
    "a deny_rule for publishers above an allow_rule for both": (
        [deny(*criteria("a", partitions=("Q",))), allow(*criteria("a"))],
        {},
        "spec opendds",
    ),
    "the topic in one place and its partition in another": (
        [allow(*criteria("a"), *criteria("b", partitions=("P",)))],
        {"partitions": ("P",)},
        "fastdds",
    ),
    "a second rule for the same topic": (
        [allow(*criteria("a")), allow(*criteria("a", partitions=("P",)))],
        {"partitions": ("P",)},
        "spec cyclonedds opendds",
    ),
    "a partition is asked for, and the endpoint has none": (
        [allow(*criteria("a", partitions=("P",)))],
        {},
        "opendds",
    ),
    "only the default": (
        [],
        {"default": DefaultAction.ALLOW},
        "spec cyclonedds opendds",
    ),
    "the default beside a rule": (
        [allow(*criteria("b"))],
        {"default": DefaultAction.ALLOW},
        "spec cyclonedds opendds",
    ),
    "a deny_rule for another domain": (
        [deny(*criteria("a"), domains=ELSEWHERE), allow(*criteria("a"))],
        {},
        "spec cyclonedds opendds",
    ),
    "a range without an end": (
        [allow(*criteria("a"), domains=DomainSet(parts=(DomainRange(first=0),)))],
        {"domain": 5, "governed": governance(domains=ELSEWHERE)},
        "spec opendds",
    ),
    "a range that ends at 0": (
        [allow(*criteria("a"), domains=DomainSet(parts=(DomainRange(first=5, last=0),)))],
        {"domain": 5, "governed": governance(domains=ELSEWHERE)},
        "fastdds",
    ),
    "an endpoint with data tags": (
        [allow(*criteria("a"))],
        {"data_tags": (("kind", "x"),)},
        "cyclonedds fastdds opendds",
    ),
    "relaying": (
        [allow(relay=criteria("a"))],
        {"action": RELAY},
        "spec fastdds",
    ),
    "relaying for one who may subscribe": (
        [allow(subscribe=criteria("a"))],
        {"action": RELAY},
        "fastdds",
    ),
    "a later topic rule that is open": (
        [allow(*criteria("b"))],
        {"governed": governance(topics("a"), topics("*", write=False))},
        "opendds",
    ),
    "a topic rule that is only half open": (
        [allow(*criteria("b"))],
        {"governed": governance(topics("a", read=False))},
        "",
    ),
    "a topic rule that is open to readers": (
        [allow(*criteria("b"))],
        {"governed": governance(topics("a", read=False)), "action": SUBSCRIBE},
        "spec cyclonedds fastdds opendds",
    ),
    "a topic that is a pattern": (
        [allow(*criteria("*"))],
        {"topic": "o*", "governed": governance(), "action": SUBSCRIBE},
        "fastdds",
    ),
    "everything is closed": (
        [allow(*criteria("a"))],
        {"governed": Governance.protected(HERE)},
        "spec cyclonedds fastdds",
    ),
    "everything is closed but joining": (
        [allow(*criteria("a"))],
        {
            "governed": Governance(
                domain_rules=tuple(
                    replace(rule, enable_join_access_control=False)
                    for rule in Governance.protected(HERE).domain_rules
                )
            )
        },
        "spec cyclonedds fastdds opendds",
    ),
    "a deny_rule without partitions": ([deny(*criteria("a")), allow(*criteria("a"))], {}, ""),
    "both denied, the one in a partition that is not asked about": (
        [
            deny(*criteria("a", partitions=("P",)), subscribe=criteria("a")),
            allow(*criteria("a")),
        ],
        {},
        "spec",
    ),
    "a domain that governance does not name": (
        [allow(*criteria("a"), domains=ELSEWHERE)],
        {"action": JOIN, "domain": 5},
        "fastdds",
    ),
    "a domain above 230": (
        [allow(*criteria("a")), allow(*criteria("a"), domains=DomainSet(parts=(231,)))],
        {},
        "spec fastdds opendds",
    ),
    "an empty topic": (
        [allow(*criteria("a")), allow(*criteria(""))],
        {},
        "spec opendds",
    ),
    "a topic with the name of a builtin one": (
        [allow(*criteria("a"))],
        {"topic": "DCPSPublication"},
        "cyclonedds",
    ),
    "an escape": (
        [allow(*criteria("\\*"))],
        {"topic": "*"},
        "spec opendds",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_who_says_yes(case):
    rules, asked, wanted = CASES[case]
    said = [each for each in INTERPRETATIONS if ask(*rules, interpretation=each, **asked).allowed]
    assert names_of(said) == wanted.split()


SUBJECTS = {
    "CN=/robot,O=Lab": "spec cyclonedds fastdds",
    "O=Lab,CN=/robot": "spec cyclonedds opendds",
    "CN=/robot, O=Lab": "spec cyclonedds@11.0 fastdds",
    "/O=Lab/CN=/robot": "spec cyclonedds opendds",
    "CN=/robot/admin,O=Lab": "cyclonedds",
    "CN=/robot": "",
    "cn=/robot,O=Lab": "",
    "gibberish": "",
    "CN=/robot,O=Lab" + ",L=x" * 20: "",
}


@pytest.mark.parametrize("named", SUBJECTS)
def test_whose_grant_it_is(named):
    asked = question(subject="CN=/robot,O=Lab")
    permissions = Permissions(grants=(grant(allow(*criteria("a")), subject=named),))
    found = [
        each for each in INTERPRETATIONS if decide(governance(), permissions, asked, each).allowed
    ]
    assert names_of(found) == SUBJECTS[named].split()


def test_a_grant_whose_subject_cannot_be_read_is_for_nobody_by_the_standard():
    """Both texts have no parts, which made them equal."""
    for named, subject in (("gibberish", "gibberish"), ("gibberish", "CN=x"), ("CN=x", "")):
        assert not SPEC.is_for(named, subject)


def test_a_peer_joins_where_join_access_control_is_off_or_its_grant_says_so():
    for join, rules, allowed in ((True, (), False), (False, (), True), (True, RULES, True)):
        for each in INTERPRETATIONS:
            governed = governance(join=join)
            asked = {"action": JOIN, "by": Viewpoint.PEER, "interpretation": each}
            found = ask(*rules, governed=governed, **asked)
            assert found.allowed == allowed, (each.name, join, rules)


def test_a_subject_that_ends_in_a_separator_is_whole_for_every_stack():
    permissions = Permissions(grants=(grant(allow(*criteria("a")), subject="CN=/robot/"),))
    for interpretation in INTERPRETATIONS:
        assert decide(
            governance(), permissions, question(subject="CN=/robot/"), interpretation
        ).allowed


def test_empty_pieces_of_a_grants_subject_do_not_count_for_cyclone_dds():
    """Of other pieces it takes at most twenty."""
    named = "CN=/robot" + "," * 30
    permissions = Permissions(grants=(grant(allow(*criteria("a")), subject=named),))
    assert decide(governance(), permissions, question(), CYCLONEDDS).allowed


def test_an_empty_piece_of_a_subject_is_in_no_grant_for_cyclone_dds():
    permissions = Permissions(grants=(grant(allow(*criteria("a")), subject="CN=/robot,="),))
    asked = question(subject="CN=/robot//")
    assert not decide(governance(), permissions, asked, CYCLONEDDS).allowed


def test_a_subject_outside_ascii_is_spelled_for_each_stack():
    asked = question(subject="CN=ñ")
    for named, wanted in (("CN=ñ", ["spec", "fastdds"]), ("CN=\\C3\\B1", None)):
        permissions = Permissions(grants=(grant(allow(*criteria("a")), subject=named),))
        found = [
            each
            for each in INTERPRETATIONS
            if decide(governance(), permissions, asked, each).allowed
        ]
        assert names_of(found) == (wanted or ["spec", "cyclonedds", "opendds"])


@pytest.mark.parametrize(
    ("times", "wanted"),
    [
        ((-1, 1), "spec cyclonedds fastdds opendds"),
        ((0, 1), "spec fastdds opendds"),
        ((-1, 0), "spec fastdds opendds"),
        ((1, 2), ""),
        ((-2, -1), ""),
    ],
)
def test_a_grant_in_force(times, wanted):
    start, end = (NOW + DAY * each for each in times)
    permissions = Permissions(grants=(grant(allow(*criteria("a")), start=start, end=end),))
    said = [
        each
        for each in INTERPRETATIONS
        if decide(governance(), permissions, question(), each).allowed
    ]
    assert names_of(said) == wanted.split()


def test_opendds_allows_one_default_partition_and_not_two():
    for partitions, allowed in (((), True), (("",), True), (("", ""), False)):
        found = ask(*RULES, interpretation=OPENDDS, partitions=partitions)
        assert found.allowed == allowed


def test_a_grant_that_starts_now_has_not_ended_for_cyclone():
    late = Permissions(grants=(grant(*RULES, start=NOW),))
    denied = decide(governance(), late, question(), CYCLONEDDS)
    assert denied.reason.startswith("grant 'g' starts at")


def test_a_grant_for_ever_is_over_for_cyclone_dds():
    for year, wanted in ((2262, list(INTERPRETATIONS)), (2263, [SPEC, FASTDDS, OPENDDS])):
        rules = allow(*criteria("a"))
        ends = grant(rules, end=datetime(year, 1, 1, tzinfo=UTC))
        permissions = Permissions(grants=(ends,))
        assert wanted == [
            each
            for each in INTERPRETATIONS
            if decide(governance(), permissions, question(), each).allowed
        ]


def test_of_two_grants_only_fast_dds_takes_the_one_in_force():
    expired = grant(allow(*criteria("a")), end=NOW - DAY / 2)
    permissions = Permissions(grants=(expired, grant(allow(*criteria("a")))))
    decisions = {
        each: decide(governance(), permissions, question(), each) for each in INTERPRETATIONS
    }
    assert [each for each in INTERPRETATIONS if decisions[each].allowed] == [FASTDDS]
    assert decisions[SPEC].reason.startswith("grant 'g' ended at 2026-05-31")


def test_opendds_lets_join_whom_no_time_lets_publish():
    expired = Permissions(grants=(grant(allow(*criteria("a")), end=NOW - DAY / 2),))
    assert decide(governance(), expired, question(JOIN), OPENDDS).allowed
    assert not decide(governance(), expired, question(), OPENDDS).allowed


def test_opendds_looks_at_no_time_where_governance_opens_the_topic():
    days = ((-2, -1), (1, 2))
    times = [{"start": NOW + start * DAY, "end": NOW + end * DAY} for start, end in days]
    opened = topics("open", read=False)
    for rights in ((), (allow(*criteria("open")),)):
        for each in times:
            permissions = Permissions(grants=(grant(*rights, **each),))
            may = {
                action: decide(
                    governance(opened, join=False),
                    permissions,
                    question(action, "open"),
                    OPENDDS,
                )
                for action in (PUBLISH, SUBSCRIBE)
            }
            assert may[SUBSCRIBE].allowed
            assert not may[PUBLISH].allowed
            assert may[PUBLISH].decided_by is permissions.grants[0]


def test_what_opendds_makes_of_an_open_bracket_is_left_to_chance():
    for pattern in ("[P-", "rt/[a", "[!]", "[]", "a[b]["):
        of_partitions = ask(
            allow(*criteria("a", partitions=(pattern, ""))),
            interpretation=OPENDDS,
            by=Viewpoint.PEER,
        )
        of_topics = ask(allow(*criteria("a", pattern)), interpretation=OPENDDS, by=Viewpoint.PEER)
        governed = governance(topics(pattern))
        of_governance = ask(
            allow(*criteria("a")), interpretation=OPENDDS, governed=governed, by=Viewpoint.PEER
        )
        for decision in (of_partitions, of_topics, of_governance):
            assert not decision.allowed
            assert "undefined" in decision.reason
    for pattern in ("[P]", "\\[", "[]]", "]"):
        assert ask(
            allow(*criteria("a", pattern)), interpretation=OPENDDS, by=Viewpoint.PEER
        ).allowed


def test_fast_dds_uses_the_rules_of_other_domains_where_only_itself_judges():
    rule = allow(*criteria("a"), domains=ELSEWHERE)
    assert ask(rule, interpretation=FASTDDS, by=Viewpoint.OWN).allowed
    assert not ask(rule, interpretation=FASTDDS, by=Viewpoint.PEER).allowed


@pytest.mark.parametrize(
    ("documents", "words"),
    [
        ((governance(domains=DomainSet(parts=(231,))), grant()), "above 230"),
        (
            (governance(domains=DomainSet(parts=(DomainRange(first=0, last=231),))), grant()),
            "above 230",
        ),
        ((governance(domains=DomainSet(parts=(DomainRange(first=3, last=1),))), grant()), "empty"),
        (
            (governance(domains=DomainSet(parts=(0, DomainRange(first=3, last=1)))), grant()),
            "empty",
        ),
    ],
)
def test_cyclone_dds_reads_nothing_of_some_documents(documents, words):
    governed, of_robot = documents
    decision = decide(governed, Permissions(grants=(of_robot,)), question(), CYCLONEDDS)
    assert words in decision.reason
    assert decision.decided_by is None


def test_cyclone_dds_reads_a_range_of_one_domain():
    one = governance(domains=DomainSet(parts=(DomainRange(first=0, last=0),)))
    assert ask(allow(*criteria("a")), governed=one, interpretation=CYCLONEDDS).allowed


# Patterns.

COVERED = {  # by first letters: spec, cyclonedds, fastdds, opendds
    ("a", "a"): "scfo",
    ("a", "A"): "",
    ("*", ""): "scfo",
    ("*", ".a/b"): "scfo",
    ("?", "/"): "scfo",
    ("a*bc", "abbc"): "scf",
    ("*ab", "aab"): "scf",
    ("*b", "bb"): "scf",
    ("*ab", "cab"): "scfo",
    ("**a**", "bab"): "scfo",
    ("[ab]", "b"): "scfo",
    ("[ab]", "]"): "c",
    ("[a-c]", "b"): "scfo",
    ("[c-a]", "b"): "",
    ("[!ab]", "c"): "scfo",
    ("[!ab]", "]"): "sfo",
    ("[^a]", "b"): "sf",
    ("[^a]", "^"): "scfo",
    ("[]a]", "]"): "sfo",
    ("[a-]", "-"): "sfo",
    ("[0-9]-f", "0-f"): "sfo",
    ("[0-9]-f", "b"): "c",
    ("[!]", "[!]"): "sf",
    ("[!]x]", "a"): "sfo",
    ("[!]x]", "ax]"): "",
    ("[!]x]", "a]x]"): "c",
    ("[a", "[a"): "sf",
    ("{a,b}", "a"): "",
    ("{a,b}", "{a,b}"): "scfo",
    ("\\*", "*"): "so",
    ("\\*", "\\*"): "cf",
    ("\\a", "a"): "so",
    ("a\\", "a\\"): "cf",
    ("[\\]]", "]"): "s",
    ("[[:digit:]]", "7"): "sf",
    ("[[:digit:]x]", "x"): "sf",
    ("[[:nonsense:]x]", "x"): "",
    ("[[.-.]a]", "-"): "sf",
    ("[[=a=]]", "a"): "sf",
    ("?", "ñ"): "",
    ("??", "ñ"): "scfo",
}


@pytest.mark.parametrize(("pattern", "name"), COVERED)
def test_a_pattern_covers_a_name(pattern, name):
    covered = {
        "s": patterns.posix,
        "c": patterns.cyclonedds,
        "f": patterns.posix_without_escapes,
        "o": patterns.opendds,
    }
    assert (
        "".join(key for key, covers in covered.items() if covers(pattern, name))
        == (COVERED[pattern, name])
    )


@pytest.mark.parametrize("interpretation", INTERPRETATIONS, ids=lambda each: each.name)
@pytest.mark.parametrize("pattern", ["*a" * 100 + "b", "*a?" * 80 + "b", "*[!b]" * 60 + "b"])
@pytest.mark.timeout(120)  # what tries all ways takes years
def test_a_hostile_pattern_costs_little(interpretation, pattern):
    hostile = tuple(f"{pattern}{number}" for number in range(200))
    decision = ask(allow(*criteria(*hostile)), interpretation=interpretation, topic="a" * 256)
    assert not decision.allowed


# What cannot be asked.


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"topic": ""}, "name is empty"),
        ({"topic": "x" * 257}, "longer than 256"),
        ({"partitions": ("x" * 257,)}, "longer than 256"),
        ({"topic": None}, "a topic"),
        ({"now": NOW.replace(tzinfo=None)}, "no time zone"),
    ],
)
def test_a_question_without_sense_is_refused(changed, words):
    with pytest.raises(UsageError, match=words):
        question(**changed)


def test_joining_is_asked_without_a_topic():
    with pytest.raises(UsageError, match="`join` has no topic"):
        Question(subject=SUBJECT, domain=0, action=JOIN, now=NOW, topic="a")


@pytest.mark.parametrize("interpretation", INTERPRETATIONS, ids=lambda each: each.name)
def test_a_subject_that_is_no_name_is_refused(interpretation):
    with pytest.raises(MalformedError):
        ask(allow(*criteria("a")), interpretation=interpretation, subject="gibberish")


def test_a_reading_is_found_by_its_name():
    named = [interpretations_named(name) for name in ALL_NAMES]
    assert named == [(row,) for row in INTERPRETATIONS]
    assert [names_of(rows) for rows in named] == [[name] for name in ALL_NAMES]


@pytest.mark.parametrize(
    ("name", "rows"),
    [
        ("cyclonedds", (CYCLONEDDS, CYCLONEDDS_11)),
        ("cyclonedds@0.10.5", (CYCLONEDDS,)),
        ("cyclonedds@11", (CYCLONEDDS_11,)),
        ("cyclonedds@11.0.1", (CYCLONEDDS_11,)),
        ("fastdds", (FASTDDS,)),
        ("fastdds/C", FASTDDS.locales[:1]),
        ("fastdds/C.UTF-8", FASTDDS.locales[1:]),
        ("spec/C.UTF-8", SPEC.locales[1:]),
    ],
)
def test_a_version_is_within_its_row_and_a_stack_has_all_of_its_rows(name, rows):
    assert interpretations_named(name) == rows


@pytest.mark.parametrize(
    "name",
    [
        *("connext", "cyclonedds@", "cyclonedds@0.9", "cyclonedds@0.1", "cyclonedds@11.1"),
        *("cyclonedds@11.", "cyclonedds@11.0.x", "cyclonedds@1", "@11.0", "spec@", "spec@1.1", ""),
        *("fastdds/", "fastdds/c", "fastdds/en_US.UTF-8", "opendds/C", "cyclonedds@11/C", "/C"),
    ],
)
def test_a_version_without_a_row_is_refused(name):
    with pytest.raises(UsageError) as error:
        interpretations_named(name)
    assert "spec, cyclonedds, cyclonedds@0.10, cyclonedds@11.0, fastdds" in error.value.hint
