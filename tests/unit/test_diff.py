"""What a change of policy grants and takes away, in words and with witnesses."""

from dataclasses import replace
from datetime import UTC, datetime

import pytest

from pqsec_pki.access._patterns import posix
from pqsec_pki.access._topics import SampleNames
from pqsec_pki.access._witnesses import sample, witnesses
from pqsec_pki.access.change import Sense
from pqsec_pki.access.diff import permissions_diff
from pqsec_pki.access.governance_diff import governance_diff
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
    preset_named,
)

START = datetime(2026, 1, 1, tzinfo=UTC)
END = datetime(2027, 1, 1, tzinfo=UTC)
ZERO = DomainSet.of(0)
STRICT = Governance.protected(ZERO)
NOTHING = PermissionRule(allow=False, domains=ZERO)


def allow(*topics, domains=ZERO, partitions=(), tags=(), **more):
    criteria = Criteria(topics=topics, partitions=partitions, data_tags=tags)
    return PermissionRule(**({"allow": True, "domains": domains, "publish": (criteria,)} | more))


def deny(*topics, **more):
    return allow(*topics, allow=False, **more)


def grant(*rules, subject="CN=/a", **more):
    times = {"not_before": START, "not_after": END}
    return Grant(**({"name": "g", "subject_name": subject, "rules": rules} | times | more))


def document(*rules, **more):
    return Permissions(grants=(grant(*rules, **more),))


def told(difference):
    """What changes by the standard."""
    assert difference.complete
    standard = (change for change in difference.changes if change.interpretation == "spec")
    return [f"{change.sense}: {change.text}" for change in standard]


def permissions_told(old, new):
    return told(permissions_diff(document(*old), document(*new)))


def governance_told(old, new):
    return told(governance_diff(old, new))


def with_rule(governance=STRICT, topics=None, **settings):
    [rule] = governance.domain_rules
    topics = rule.topic_rules if topics is None else topics
    return Governance(domain_rules=(replace(rule, topic_rules=topics, **settings),))


def topic_rule(expression="*", **settings):
    return replace(STRICT.domain_rules[0].topic_rules[0], topic_expression=expression, **settings)


@pytest.mark.parametrize(
    ("old", "new", "changes"),
    [
        ([allow("a")], [allow("a", "b")], ["granted: publish 'b' on domain 0"]),
        ([allow("a", "b")], [allow("a")], ["taken away: publish 'b' on domain 0"]),
        ([allow("*")], [allow("*"), deny("a")], []),
        ([allow("*")], [deny("a"), allow("*")], ["taken away: publish 'a' on domain 0"]),
        (
            [allow("a")],
            [allow("a", domains=DomainSet.of(0, DomainRange(first=4, last=6)))],
            ["granted: join on domains 4-6", "granted: publish 'a' on domains 4-6"],
        ),
        (
            [allow("rt/s*")],
            [allow("rt/*")],
            [
                "granted: publish some of 'rt/*', such as 'rt/x', but none of 'rt/s*', on domain 0",
                "otherwise: publish: 'rt/*' is wider than 'rt/s*' was",
            ],
        ),
        (
            [allow("rt/*")],
            [allow("rt/s")],
            [
                (
                    "taken away: publish some of 'rt/*', such as 'rt/x', but none of 'rt/s',"
                    " on domain 0"
                ),
                "otherwise: publish: 'rt/s' is narrower than 'rt/*' was",
            ],
        ),
        (
            [allow("a")],
            [allow("a", partitions=("P",))],
            [
                "granted: publish 'a' on domain 0 in partition 'P'",
                "taken away: publish 'a' on domain 0",
            ],
        ),
        (
            [NOTHING],
            [allow("a", partitions=("P*", "Q"))],
            [
                "granted: join on domain 0",
                (
                    "granted: publish 'a' on domain 0 in all of partition 'P*' or partition 'Q',"
                    " alone or together"
                ),
            ],
        ),
        (
            [allow("a", partitions=("P", "Q", "R"))],
            [allow("a", partitions=each) for each in ("PQ", "PR", "QR")],
            [
                (
                    "taken away: publish 'a' on domain 0 in"
                    " partition 'P' and partition 'Q' and partition 'R' together"
                )
            ],
        ),
        (
            [allow("a", partitions=("*",))],
            [allow("a", partitions=("",))],
            [
                (
                    "taken away: publish 'a' on domain 0 in some of partition '*', such as 'x',"
                    " but none of the default partition"
                )
            ],
        ),
        (
            [allow("a", partitions=("?",))],
            [allow("a", partitions=("[ -~]",))],
            [
                (
                    "taken away: publish 'a' on domain 0 in some of partition '?', such as '\\x01',"
                    " but none of partition '[ -~]'"
                )
            ],
        ),
        (
            [deny("a", tags=(("k", "3"),)), allow("a", tags=(("k", "1"), ("k", "2"), ("k", "3")))],
            [allow("a", tags=(("k", "1"),)), allow("a", tags=(("k", "2"),))],
            ["taken away: publish 'a' on domain 0 with data tags k=1, k=2"],
        ),
        (
            [allow("a")],
            [allow("a", tags=(("k", "v"),))],
            ["granted: publish 'a' on domain 0 with data tags k=v"],
        ),
        (
            [allow("a")],
            [allow("a", subscribe=(Criteria(topics=("a",)),))],
            ["granted: subscribe 'a' on domain 0"],
        ),
        (
            [NOTHING],
            [allow("a", subscribe=(Criteria(topics=("a",)),))],
            ["granted: join on domain 0", "granted: publish and subscribe 'a' on domain 0"],
        ),
        (
            [allow("a", publish=(), relay=(Criteria(topics=("a", "b")),))],
            [allow("a", publish=(), relay=(Criteria(topics=("a",)),))],
            ["taken away: relay 'b' on domain 0"],
        ),
        (
            [allow("a*", "q")],
            [allow("a**")],
            ["taken away: publish 'q' on domain 0"],
        ),
    ],
)
def test_a_change_of_rules_is_told_by_what_it_does(old, new, changes):
    assert permissions_told(old, new) == changes


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ([allow("a"), allow("b")], [allow("b"), allow("a")]),
        ([allow("a", "b")], [allow("b"), allow("a")]),
        ([allow("*")], [allow("a"), allow("*"), deny("b")]),
        ([allow("[ab]")], [allow("a"), allow("b")]),
        ([allow("?")], [allow("[!a]", "a")]),
        ([allow("a*"), allow("*")], [allow("*")]),
        ([deny("a"), allow("b")], [allow("b")]),
        ([allow("a", partitions=("?",))], [allow("a", partitions=("[a-z]", "[!a-z]"))]),
        ([allow("a", partitions=("P*", ""))], [allow("a", partitions=("", "P*", "PQ"))]),
        (
            [allow("x", domains=DomainSet.of(0, 1))],
            [allow("x"), allow("x", domains=DomainSet.of(1))],
        ),
    ],
)
def test_a_change_of_form_that_changes_no_right_is_none(old, new):
    difference = permissions_diff(document(*old), document(*new))
    assert told(difference) == []
    assert not difference.same_text


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            [deny("a", partitions=("P",)), allow("a")],
            [allow("a"), deny("a", partitions=("P",))],
            [
                f"granted: in {title}, unlike the standard, for one: publish 'a' on domain 0"
                for title in ("Cyclone DDS 0.10.2 and Cyclone DDS 11.0.1", "Fast DDS 2.9.1")
            ],
        ),
        ([allow("a"), allow("b")], [allow("b", "a")], []),
        (
            [deny("a", partitions=("P",)), allow("a"), allow("b"), deny("b", partitions=("P",))],
            [allow("a"), deny("a", partitions=("P",)), deny("b", partitions=("P",)), allow("b")],
            [
                f"{sense}: in {title}, unlike the standard, for one: publish '{topic}' on domain 0"
                for title in ("Cyclone DDS 0.10.2 and Cyclone DDS 11.0.1", "Fast DDS 2.9.1")
                for sense, topic in (("granted", "a"), ("taken away", "b"))
            ],
        ),
    ],
)
def test_what_changes_for_a_stack_alone_is_told_as_that(old, new, words):
    changes = permissions_diff(document(*old), document(*new)).changes
    alone = [change for change in changes if change.interpretation != "spec"]
    assert [f"{change.sense}: {change.text}" for change in alone] == words


def test_what_changes_for_one_version_of_a_stack_alone_is_told_with_the_version():
    denied = (Criteria(topics=("a",)),)
    rules = [PermissionRule(allow=False, domains=ZERO, subscribe=denied), allow("a")]
    [change] = permissions_diff(document(*rules), document(*rules[::-1])).changes
    assert change.interpretation == "cyclonedds@0.10"
    assert change.text.startswith("in Cyclone DDS 0.10.2, unlike the standard, for one: publish")


def test_a_default_that_allows_is_told_as_topics_that_no_rule_names():
    open_ = document(allow("a"), default=DefaultAction.ALLOW)
    words = told(permissions_diff(document(allow("a")), open_))
    assert words[0] == "granted: publish topics that no rule names, such as 'x', on domain 0"
    assert "granted: join on domains 1 and up" in words
    back = told(permissions_diff(open_, document(allow("a"))))
    assert [word.replace("taken away", "granted") for word in back] == words


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"not_after": datetime(2028, 1, 1, tzinfo=UTC)}, "granted: validity ends 2028-01-01"),
        ({"not_after": datetime(2026, 6, 1, tzinfo=UTC)}, "taken away: validity ends 2026-06-01"),
        ({"not_before": datetime(2025, 1, 1, tzinfo=UTC)}, "granted: validity begins 2025-01-01"),
        ({"not_before": datetime(2026, 6, 1, tzinfo=UTC)}, "taken away: validity begins 2026-06"),
    ],
)
def test_another_validity_is_told_apart_from_the_rules(change, word):
    [text] = told(permissions_diff(document(allow("a")), document(allow("a"), **change)))
    assert text.startswith(word)


def test_expired_documents_are_compared_by_their_rules():
    old = {
        "not_before": datetime(2001, 1, 1, tzinfo=UTC),
        "not_after": datetime(2002, 1, 1, tzinfo=UTC),
    }
    difference = permissions_diff(document(allow("a"), **old), document(allow("b"), **old))
    assert told(difference) == [
        "granted: publish 'b' on domain 0",
        "taken away: publish 'a' on domain 0",
    ]


def test_a_subject_is_the_same_however_it_is_spelled():
    old, new = (document(allow("a"), subject=text) for text in ("CN=/a,O=Lab", "/O=Lab/CN=/a"))
    assert told(permissions_diff(old, new)) == []


def test_of_two_grants_for_a_subject_the_first_counts():
    old = Permissions(grants=(grant(allow("a")), grant(allow("b"))))
    new = Permissions(grants=(grant(allow("a")), grant(allow("c"))))
    assert told(permissions_diff(old, new)) == []


SECOND = "that the standard never uses: a grant above it is used"
NAMELESS = "that the standard never uses: its subject is not a name"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (["CN=/a"], ["/CN=/a"], ["written 'CN=/a' before"]),
        (["CN=/a,O=Lab"], ["O=Lab,CN=/a"], ["written 'CN=/a,O=Lab' before"]),
        (["CN=/a"], ["CN=/a", "CN=/a"], [f"a grant is added {SECOND}"]),
        (["CN=/a,O=b", "O=b,CN=/a"], ["CN=/a,O=b"], [f"a grant is removed {SECOND}"]),
        (["CN=/a"], ["a|CN=", "CN=/a"], [f"a grant is added {NAMELESS}"]),
        (["CN=/a", "nobody"], ["CN=/a"], [f"a grant is removed {NAMELESS}"]),
        (["CN=/a", "nobody"], ["nobody", "CN=/a"], []),
    ],
)
def test_a_grant_that_only_stacks_may_find_an_owner_for_is_not_hidden(old, new, words):
    documents = (
        Permissions(grants=tuple(grant(allow("a"), subject=subject) for subject in subjects))
        for subjects in (old, new)
    )
    changes = permissions_diff(*documents).changes
    assert {(change.sense, change.interpretation) for change in changes} <= {
        (Sense.OTHER, "stacks")
    }
    assert len(changes) == len(words)
    assert all(map(str.startswith, (change.text for change in changes), words))


@pytest.mark.parametrize("sense", [Sense.GRANTED, Sense.TAKEN])
def test_a_whole_grant_comes_or_goes(sense):
    documents = [
        document(allow("a")),
        Permissions(grants=(grant(allow("a")), grant(allow("b"), subject="CN=/b"))),
    ]
    changes = permissions_diff(*documents[:: 1 if sense is Sense.GRANTED else -1]).changes
    assert [change.sense for change in changes] == [sense, sense]
    assert {change.subject for change in changes} == {"CN=/b"}


def test_a_document_that_is_not_there_gives_nothing():
    assert told(permissions_diff(None, document(allow("a"))))[0] == "granted: join on domain 0"
    assert told(permissions_diff(document(allow("a")), None))[0] == "taken away: join on domain 0"


def test_a_grant_for_no_possible_subject_gives_nothing():
    assert told(permissions_diff(None, document(allow("a"), subject="nobody"))) == []


def test_patterns_that_meet_in_too_many_ways_are_said_not_to_be_all_tried():
    many = [f"*{c}*" for c in "abcdefghijklmnop"]
    difference = permissions_diff(document(allow(*many)), document(allow(*many, "q")))
    assert not difference.complete
    assert [change.text for change in difference.changes] == ["publish 'q' on domain 0"]
    wider = permissions_diff(document(allow(*many)), document(allow(*many, "*z*")))
    [change] = wider.changes
    assert change.text == "publish some of '*z*', such as 'xzx', on domain 0"


def test_ways_to_deny_partitions_beyond_number_are_said_not_to_be_all_tried():
    names = "ABCDEFGHIJKL"
    rules = [deny(f"{name}*", partitions=(name,)) for name in names]
    old = document(*rules, allow("*", partitions=tuple(names)))
    assert not permissions_diff(old, document(allow("*", partitions=tuple(names)))).complete


def test_of_many_exceptions_a_few_are_named():
    new = document(deny(*(f"a{number}" for number in range(9))), allow("a*"))
    change, *_ = permissions_diff(document(NOTHING), new).changes[1:]
    assert change.text.endswith("'a4' and 4 more, on domain 0")
    [topics] = change.topics
    assert len(topics.but) == 9


def test_of_sets_of_partitions_that_are_taken_together_the_largest_is_said():
    old = document(deny("a", partitions=tuple("PQR")), allow("a", partitions=tuple("RP")))
    [words] = told(permissions_diff(old, document(allow("a", partitions=tuple("PQR")))))
    assert words.endswith("in partition 'P' or partition 'Q' or partition 'R', alone or together")


def test_partitions_may_be_taken_together_where_one_of_the_two_defaults_allows():
    new = document(deny("a", partitions=("Q",)), default=DefaultAction.ALLOW)
    assert (
        "granted: publish 'a'; topics that no rule names, such as 'x', on every domain in the"
        " default partition or partitions that no rule names, such as 'x', alone or together"
        " whatever its data tags"
    ) in told(permissions_diff(document(deny("a")), new))


def test_data_tags_may_be_taken_together_where_one_of_the_two_defaults_allows():
    one, two = (("k", "1"),), (("k", "2"),)
    old = document(allow("a"), allow("a", tags=one), allow("a", tags=two))
    new = document(deny("b", tags=one), default=DefaultAction.ALLOW)
    found, unnamed = told(permissions_diff(old, new)), "topics that no rule names, such as 'x'"
    assert (
        f"granted: publish 'b'; {unnamed}, on domain 0 with no data tags or data tags k=2"
    ) in found
    assert (
        f"granted: publish 'a'; {unnamed}, on domain 0 in any partition with data tags k=1, k=2"
        " and a tag that no rule names"
    ) in found


def test_a_pattern_that_reaches_beyond_another_is_not_its_exception():
    new = document(deny("*b"), allow("a*"))
    assert told(permissions_diff(document(NOTHING), new))[1:] == [
        "granted: publish some of 'a*', such as 'a', on domain 0"
    ]


@pytest.mark.parametrize("count", [200, 2000])
def test_a_policy_of_a_namespace_for_each_robot_is_told_whole(count):
    old = document(*(allow(f"rt/robot{number}/*") for number in range(count)))
    new = document(*(allow(f"rt/robot{number}/*") for number in range(1, count)))
    assert told(permissions_diff(old, new)) == [
        "taken away: publish all of 'rt/robot0/*' on domain 0"
    ]


# Governance


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (
            {"rtps_protection_kind": ProtectionKind.ENCRYPT},
            "stronger: domain 0: whole messages: encrypted, before: signed",
        ),
        (
            {"rtps_protection_kind": ProtectionKind.NONE},
            "weaker: domain 0: whole messages: in the clear, before: signed",
        ),
        (
            {"discovery_protection_kind": ProtectionKind.SIGN_WITH_ORIGIN_AUTHENTICATION},
            "otherwise: domain 0: discovery: signed by its origin, before: encrypted",
        ),
        (
            {"enable_join_access_control": False},
            (
                "weaker: domain 0: joining: needs only a certificate, before: needs a grant for the"
                " domain"
            ),
        ),
        (
            {"allow_unauthenticated_participants": True},
            (
                "weaker: domain 0: participants without credentials: may use what is not"
                " protected, before: may not take part"
            ),
        ),
    ],
)
def test_a_setting_of_a_domain_is_stronger_or_weaker(settings, words):
    assert governance_told(STRICT, with_rule(**settings)) == [words]


@pytest.mark.parametrize(
    ("topics", "words"),
    [
        (
            [topic_rule("map", data_protection_kind=ProtectionKind.NONE), topic_rule()],
            ["weaker: domain 0, 'map': payload: in the clear, before: encrypted"],
        ),
        (
            [topic_rule(enable_write_access_control=False)],
            [
                (
                    "weaker: domain 0, every topic: who may publish: every participant that has"
                    " joined, before: those with a grant for it"
                )
            ],
        ),
        (
            [topic_rule("rt/*")],
            [
                (
                    "taken away: domain 0, some of '*', such as 'x', but none of 'rt/*':"
                    " no longer governed: no participant can use it"
                )
            ],
        ),
        ([topic_rule(), topic_rule("map", data_protection_kind=ProtectionKind.NONE)], []),
    ],
)
def test_a_topic_rule_is_told_by_the_topics_it_governs(topics, words):
    assert governance_told(STRICT, with_rule(topics=tuple(topics))) == words


def test_a_topic_comes_under_governance():
    [words] = governance_told(with_rule(topics=(topic_rule("rt/*"),)), STRICT)
    assert words.startswith("granted: domain 0, some of '*', such as 'x', but none of 'rt/*'")
    assert words.endswith(": governed, so that it can be used")


def test_a_domain_comes_and_goes():
    wide = Governance.protected(DomainSet.of(0, 1))
    assert governance_told(STRICT, wide) == [
        "granted: domain 1: governed, so that participants can join"
    ]
    assert governance_told(wide, STRICT) == [
        "taken away: domain 1: no longer governed: no participant can join"
    ]


def test_a_topic_that_only_another_domain_governs_is_not_told_as_a_change():
    elsewhere = with_rule(Governance.protected(DomainSet.of(1)), (topic_rule("b"),)).domain_rules
    old, new = (
        Governance(domain_rules=(*with_rule(topics=topics).domain_rules, *elsewhere))
        for topics in ((topic_rule("a"),), (topic_rule("a", enable_write_access_control=False),))
    )
    (told,) = governance_told(old, new)
    assert told.startswith("weaker: domain 0, 'a': who may publish")


def test_a_rule_that_never_governs_changes_nothing():
    hidden = with_rule(rtps_protection_kind=ProtectionKind.NONE).domain_rules
    both = Governance(domain_rules=(*STRICT.domain_rules, *hidden))
    assert governance_told(STRICT, both) == []
    assert governance_told(both, Governance(domain_rules=both.domain_rules[::-1])) != []


def test_presets_differ_and_are_the_same_as_themselves():
    strict, other = (preset_named(name).governance(ZERO) for name in ("strict", "open-discovery"))
    assert governance_told(strict, strict) == []
    assert {change.sense for change in governance_diff(strict, other).changes} >= {Sense.WEAKER}


# Witnesses


@pytest.mark.parametrize(
    "pattern", ["rt/*", "?", "[!a]", "[[:digit:]]*", "\\*", "*é?", "a[x-z]b", "**"]
)
def test_a_sample_is_covered_by_its_pattern_alone(pattern):
    name = sample(pattern)
    assert posix(pattern, name)
    assert sample("*", {"x"}) == "xyz"


@pytest.mark.parametrize("pattern", ["[!]", "[[:nonsense:]]"])
def test_a_pattern_that_covers_nothing_has_no_sample(pattern):
    assert sample(pattern) in (None, pattern)


def test_the_names_of_a_pattern_that_literals_use_up_are_the_literals():
    assert set(witnesses(["[ab]", "a", "b"]).names) - {"a", "b"} == {"x"}
    assert set(witnesses(["[abc]", "a", "b"]).names) - {"a", "b"} == {"x", "c"}
    assert witnesses(f"*{c}*" for c in "abcdefghijklmnop").complete is False


def test_a_pattern_of_which_something_is_chosen_is_not_told_as_left_out():
    patterns = SampleNames(["rt/*", "rt/a*", "rt/ab"])
    [*_, widest] = patterns.described(patterns.covered["rt/*"] - {"rt/ab"})
    assert (widest.name, widest.but) == ("rt/*", ("rt/ab",))
