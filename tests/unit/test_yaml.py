"""Policies in YAML: what is meant, and what every mistake is told."""

import re
from datetime import UTC, datetime, timedelta

import pytest
import yaml

from pqsec_pki.documents import (
    PRESETS,
    Criteria,
    DefaultAction,
    DomainRange,
    DomainSet,
    Governance,
    Permissions,
    ProtectionKind,
    _yaml,
    governance_from_yaml,
    governance_to_yaml,
    new_governance,
    new_permissions,
    permissions_from_yaml,
    permissions_to_yaml,
    ros,
)
from pqsec_pki.documents._yaml import MAX_DEPTH, MAX_DOCUMENT, MAX_ITEMS
from pqsec_pki.errors import InvalidDocumentError, UsageError
from tests.json_schemas import schema_of
from tests.longer import LONG

NOW = datetime(2026, 11, 21, 12, tzinfo=UTC)
DAY = timedelta(days=1)


def read_permissions(text):
    data = text if isinstance(text, bytes) else text.encode()
    return permissions_from_yaml(data, now=NOW)


def read_governance(text):
    return governance_from_yaml(text if isinstance(text, bytes) else text.encode())


def grant_of(text):
    """The one grant; `text` is what stands in it, at its own indentation."""
    lines = "\n".join(f"    {line}" for line in text.splitlines())
    [grant] = read_permissions(f"grants:\n  - name: /a\n{lines}\n").grants
    return grant


def problems(read, text):
    with pytest.raises(InvalidDocumentError) as refusal:
        read(text)
    return refusal.value.lines


# Governance


def test_the_shortest_governance_is_what_ca_init_writes():
    assert read_governance("domains: 0-3") == Governance.protected(DomainSet.parse("0-3"))
    assert read_governance("{}") == Governance.protected(DomainSet.of(0))


def test_what_is_said_differs_from_the_preset_and_the_rest_does_not():
    topics = "topics: [rt/a, {topic: '*', data_protection_kind: SIGN}]"
    said = f"preset: authenticated\nrtps_protection_kind: NONE\n{topics}"
    [rule] = read_governance(said).domain_rules
    assert rule.rtps_protection_kind is ProtectionKind.NONE
    assert rule.discovery_protection_kind is ProtectionKind.SIGN
    assert [topic.data_protection_kind for topic in rule.topic_rules] == ["NONE", "SIGN"]
    assert [topic.line for topic in rule.topic_rules] == [3, 3]


def test_rules_take_the_presets_of_the_document_and_their_own():
    said = "preset: migration\nrules:\n- domains: 1\n- {domains: 2, preset: strict}\n"
    first, second = read_governance(said).domain_rules
    assert first.allow_unauthenticated_participants
    assert not second.allow_unauthenticated_participants
    assert (first.line, second.line) == (3, 4)


@pytest.mark.parametrize(
    ("key", "topics"),
    [
        ("topic: 'rt/*'", ["rt/*"]),
        ("ros_topic: /map", ["rt/map"]),
        ("ros_service: /add", ["rq/addRequest", "rr/addReply"]),
    ],
)
def test_a_topic_rule_has_ros_words(key, topics):
    [rule] = read_governance(f"topics: {{{key}}}").domain_rules
    assert [topic.topic_expression for topic in rule.topic_rules] == topics


def test_a_ros_action_is_all_its_topics():
    [rule] = read_governance("topics: {ros_action: /fib}").domain_rules
    expected = ros.action_server("/fib").publish + ros.action_server("/fib").subscribe
    assert {topic.topic_expression for topic in rule.topic_rules} == set(expected)
    assert len(rule.topic_rules) == 8


@pytest.mark.parametrize("preset", PRESETS, ids=lambda preset: preset.name)
def test_a_new_governance_says_what_its_preset_does(preset):
    domains = DomainSet.parse("0,4-7")
    assert read_governance(new_governance(preset, domains)) == preset.governance(domains)


# Permissions


def test_one_grant_in_short():
    grant = grant_of("publish: rt/chatter\nsubscribe: [rt/a, 'rt/b*']")
    assert (grant.name, grant.subject_name) == ("/a", "CN=/a")
    assert (grant.not_before, grant.not_after) == (NOW - DAY, NOW + 365 * DAY)
    assert grant.default is DefaultAction.DENY
    [rule] = grant.rules
    assert rule.allow
    assert rule.domains == DomainSet.of(0)
    assert rule.publish == (Criteria(topics=("rt/chatter",)),)
    assert rule.subscribe == (Criteria(topics=("rt/a", "rt/b*")),)


def test_grants_take_domains_and_validity_of_the_document_and_their_own():
    own = "domains: 1-2, validity: {not_after: 2030-01-01T00:00:00+01:00}"
    rules = "rules: [{allow: {publish: x}}, {deny: {domains: 9}}]"
    text = (
        f"domains: 5\nvalidity: 2w\ngrants: [{{name: a, publish: x}}, {{name: b, {own}, {rules}}}]"
    )
    first, second = read_permissions(text).grants
    assert first.rules[0].domains == DomainSet.of(5)
    assert first.not_after == NOW + 14 * DAY
    assert second.not_before == NOW - DAY
    assert second.not_after == datetime(2029, 12, 31, 23, tzinfo=UTC)
    assert [str(rule.domains) for rule in second.rules] == ["1-2", "9"]
    assert [rule.allow for rule in second.rules] == [True, False]


def test_partitions_and_data_tags():
    grant = grant_of(
        "publish:\n- rt/a\n- {topics: [rt/b], partitions: [x, ''], data_tags: {k: v}}\n- rt/c\n"
        "relay: {topics: r, data_tags: [{k: v}, {k: w}]}\nsubject: CN=x,O=y"
    )
    assert grant.subject_name == "CN=x,O=y"
    assert grant.rules[0].publish == (
        Criteria(topics=("rt/a", "rt/c")),
        Criteria(topics=("rt/b",), partitions=("x", ""), data_tags=(("k", "v"),)),
    )
    assert grant.rules[0].relay == (Criteria(topics=("r",), data_tags=(("k", "v"), ("k", "w"))),)


def test_a_node_has_the_minimum_and_its_words_resolved():
    grant = grant_of(
        "nodes:\n- node: /ns/n\n  publish: [out, /abs, ~/own]\n  subscribe: in\n"
        "  services: s\n  clients: /c\n  use_sim_time: true\n"
    )
    [publish], [subscribe] = grant.rules[0].publish, grant.rules[0].subscribe
    minimum = ros.node_minimum("/ns/n")
    own = ("rt/ns/out", "rt/abs", "rt/ns/n/own", "rr/ns/sReply", "rq/cRequest")
    assert publish.topics == minimum.publish + own
    assert set(subscribe.topics) == {
        *minimum.subscribe,
        *("rt/clock", "rt/ns/in", "rq/ns/sRequest", "rr/cReply"),
    }


def topics_of(words):
    [rule] = grant_of(f"nodes: {{node: n, namespace: /ns, minimum: false, {words}}}").rules
    both = [rule.publish, rule.subscribe]
    return tuple({topic for each in criteria for topic in each.topics} for criteria in both)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("action_servers: fib", ros.action_server("/ns/fib")),
        ("action_clients: /fib", ros.action_client("/fib")),
        ("parameters_of: other", ros.parameter_client("/ns/other")),
        ("lifecycle: true", ros.lifecycle_node("/ns/n")),
        ("lifecycle_of: /m", ros.lifecycle_client("/m")),
        ("use_sim_time: true", ros.simulated_time()),
    ],
)
def test_each_ros_word_is_what_a_node_needs(words, expected):
    assert topics_of(words) == (set(expected.publish), set(expected.subscribe))


def test_an_enclave_has_several_nodes_and_topics_of_its_own():
    grant = grant_of("publish: [rt/x]\nnodes: [/a, {node: /b, publish: c}]")
    [criteria] = grant.rules[0].publish
    assert criteria.topics[0] == "rt/x"
    assert criteria.topics.count(ros.DISCOVERY) == 1
    assert {"rr/a/get_parametersReply", "rr/b/get_parametersReply", "rt/c"} <= {*criteria.topics}


def test_new_permissions_are_nodes_that_start():
    value = read_permissions(new_permissions(["/talker", "/ns/b"], DomainSet.of(0, 2), "90d"))
    assert [grant.name for grant in value.grants] == ["/talker", "/ns/b"]
    for grant in value.grants:
        assert grant.rules[0].publish[0].topics == ros.node_minimum(grant.name).publish
        assert grant.not_after == NOW + 90 * DAY
        assert str(grant.rules[0].domains) == "0,2"


DOMAINS = [
    ("0", [0]),
    ("'0,2-5'", [0, DomainRange(first=2, last=5)]),
    ("[7, 0-3]", [7, DomainRange(first=0, last=3)]),
    ("{id: 300}", [300]),
    ("{min: 5}", [DomainRange(first=5)]),
    ("{max: 5}", [DomainRange(first=0, last=5)]),
    ("[{min: 9, max: 3}]", [DomainRange(first=9, last=3)]),
]


@pytest.mark.parametrize(("text", "parts"), DOMAINS)
def test_domains_have_short_forms_and_long_ones(text, parts):
    [rule] = read_governance(f"domains: {text}").domain_rules
    assert list(rule.domains.parts) == parts
    assert governance_from_yaml(governance_to_yaml(read_governance(f"domains: {text}"))) == (
        read_governance(f"domains: {text}")
    )


def test_what_is_written_is_short():
    value = read_permissions("grants: [{name: /a, publish: rt/a}]")
    text = permissions_to_yaml(value).decode()
    assert "rules" not in text
    assert "subject" not in text
    assert "not_before: 2026-11-20T12:00:00Z" in text


# What is refused: what is said of it


GOVERNANCE_FAULTS = [
    ("rtps_protection: SIGN", 1, "rtps_protection: no such key here; did you mean rtps_prot"),
    ("\nrtps_protection_kind: sign", 2, "rtps_protection_kind: 'sign' is not allowed; did you"),
    ("topics: [{topic: '*', data_protection_kind: SIGN_WITH_ORIGIN_AUTHENTICATION}]", 1, "data_"),
    ("preset: stric", 1, "preset: 'stric' is not allowed; did you mean strict?"),
    ("enable_join_access_control: yes", 1, "'yes' is not true or false"),
    ("enable_join_access_control: 'true'", 1, "'true' is not true or false"),
    ("domains: 010", 1, "domains: '010' begins with 0"),
    ("domains: {min: 010}", 1, "min: '010' is not a number from 0 on (YAML reads"),
    ("domains: 3-1", 1, "domains: domains 3-1 is an empty range"),
    ("domains: 231", 1, "domains: domain 231 is above 230"),
    ("domains: 5-", 1, "domains: '5-' is not a domain; write 0, or"),
    ("domains: []", 1, "domains: a rule must name at least one"),
    ("domains: {id: 1, max: 2}", 1, "domains: write either {id: 7}, or"),
    ("domains: {id: 9999999999}", 1, "domains: a domain id is between"),
    ("topics: []", 1, "at least one topic rule"),
    ("topics: [{data_protection_kind: NONE}]", 1, "topics: a topic rule has one of the keys"),
    ("topics: [{topic: a, ros_topic: /a}]", 1, "topics: a topic rule has one of the keys"),
    ("topics: [{ros_topic: a}]", 1, "ros_topic: 'a' is not a full ROS 2 name"),
    ("topics: *", 1, "must be in quotes"),
    ("topics: [*rt]", 1, "YAML reads *rt as an alias, which is not allowed"),
    ("rules: []", 1, "at least one domain rule"),
    ("rules: [{preset: strict}]", 1, "rules: the key 'domains' is missing"),
    ("rules: {domains: 0}", 1, "rules: expected a list here, found a mapping"),
    ("rules:\n- domains: 0\ndomains: 0", 3, "domains: no such key here; allowed: preset, rules"),
    ("- domains: 0", 1, "expected `key: value` here, found a list"),
]  # fmt: skip
PERMISSIONS_FAULTS = [
    ("{}", 1, "the key 'grants' is missing"),
    ("grants: []", 1, "at least one grant"),
    ("grant: []", 1, "grant: no such key here; did you mean grants?"),
    ("grants: [{publish: x}]", 1, "grants: a grant needs a name"),
    ("grants: [{name: a}]", 1, "grants: the grant allows nothing"),
    ("grants: [{name: a, publish: x, rules: []}]", 1, "the grant has `rules`: write"),
    ("grants: [{name: a, rules: [{}]}]", 1, "rules: each item of `rules` has"),
    ("grants: [{name: a, rules: [{permit: {}}]}]", 1, "permit: no such key here; allowed: allow,"),
    ("grants: [{name: a, rules: [{deny: {nodes: /a}}]}]", 1, "nodes: no such key here"),
    ("grants: [{name: a, publish: [no]}]", 1, "publish: YAML reads no as true or false; put it in"),
    ("grants: [{name: 010, publish: x}]", 1, "name: YAML reads 010 as a number"),
    ("grants: [{name: 1e3, publish: x}]", 1, "name: YAML reads 1e3 as a number"),
    ("grants: [{name: 2030-01-01, publish: x}]", 1, "name: YAML reads 2030-01-01 as a date"),
    ("grants: [{name: , publish: x}]", 1, "name: no value; for an empty text write ''"),
    ("grants: [{name: a, publish: [[x]]}]", 1, "publish: expected a text here, found"),
    ("grants: [{name: a, publish: {topics: []}}]", 1, "criteria must name at least one topic"),
    ("grants: [{name: a, publish: {topic: a}}]", 1, "topic: no such key here; did you mean"),
    ("validity: 1 year\ngrants: [{name: a, publish: x}]", 1, "validity: '1 year' is not a dur"),
    ("validity: 999999y\ngrants: [{name: a, publish: x}]", 1, "are too long"),
    ("validity: {not_after: 2030-01-01}\ngrants: [{name: a, publish: x}]", 1,
     "not_after: '2030-01-01' is not a time with a zone, such as"),
    ("validity: {not_after: 2030-01-01T00:00:00}\ngrants: [{name: a, publish: x}]", 1, "a time"),
    ("validity: {not_after: 2030-02-30T00:00:00Z}\ngrants: [{name: a, publish: x}]", 1, "a time"),
    ("validity: {not_before: 2030-01-01T00:00:00Z}\ngrants: []", 1, "'not_after' is missing"),
    ("grants: [{name: a, default: deny, publish: x}]", 1, "default: 'deny' is not allowed; did"),
    ("grants: [{name: a, nodes: {publish: x}}]", 1, "nodes: the key 'node' is missing"),
    ("grants: [{name: a, nodes: /b/2}]", 1, "nodes: '/b/2' is not a full ROS 2 name: a part of it"),
    ("grants: [{name: a, nodes: {node: /b, namespace: /c}}]", 1, "remove `namespace`"),
    ("grants: [{name: a, nodes: ~/b}]", 1, "nodes: '~/b' is not a node name"),
    ("grants: [{name: a, nodes: {node: b, publish: 'c*'}}]", 1, "write patterns outside"),
    ("grants: [{name: a, nodes: {node: b, publish: ~c}}]", 1, "only letters"),
]  # fmt: skip
YAML_FAULTS = [
    ("", 1, "is empty"),
    ("# nothing", 1, "is empty"),
    ("a: 1\nb: 2\na: 3", 3, "the key 'a' comes twice"),
    ("a: {b: 1, 'b': 2}", 1, "the key 'b' comes twice"),
    ("a: &x 1", 1, "the anchor &x is not allowed"),
    ("a: !!python/object/apply:os.system ['x']", 1, "the tag tag:yaml.org,2002:python/object"),
    ("a: ! x", 1, "the tag ! is not allowed"),
    ("? [a]\n: b", 1, "a key must be a word"),
    ("{a: {? {b: c} : d}}", 1, "a key must be a word"),
    ("a: 1\n---\nb: 2", 2, "a second document"),
    ("a:\n\t- b", 2, "a tab: indent YAML with spaces only"),
    ("a: [", None, "not well-formed YAML"),
    ("a: 'b", 1, "not well-formed YAML"),
    ("a: b: c", 1, "not well-formed YAML"),
    (b"a: b\nc: \xff", 2, "not UTF-8 text"),
    (b"\xff\xfea", 1, "not UTF-16 text"),
    (b"a: \x00", None, "not well-formed YAML"),
    ("[" * 100_000, 1, f"more than {MAX_DEPTH} nested"),
    ("{a: " * 100_000, 1, f"more than {MAX_DEPTH} nested"),
    (b"a" * (MAX_DOCUMENT + 1), None, f"larger than {MAX_DOCUMENT} bytes"),
    (b"a: *b\n" + b"# " + b"x" * 1_000_000, 1, "YAML reads *b as an alias"),
]
FAULTS = [
    *((read_governance, *fault) for fault in GOVERNANCE_FAULTS),
    *((read_permissions, *fault) for fault in PERMISSIONS_FAULTS),
    *((read, *fault) for fault in YAML_FAULTS for read in (read_governance, read_permissions)),
]


@pytest.mark.parametrize(
    ("read", "text", "line", "words"), FAULTS, ids=[str(fault[1][:50]) for fault in FAULTS]
)
def test_a_mistake_is_told_with_its_line_its_key_and_what_is_right(read, text, line, words):
    said = problems(read, text)
    place = "" if line is None else f"line {line}: "
    assert [each for each in said if each.startswith(place) and words in each], said


@pytest.mark.parametrize("read", [read_governance, read_permissions])
def test_more_values_than_any_policy_has_are_refused(read, monkeypatch):
    most = MAX_ITEMS if LONG else 1000
    monkeypatch.setattr(_yaml, "MAX_ITEMS", most)
    said = problems(read, "- a\n" * (most + 1))
    assert said == (f"line {most}: more than {most} values, so not a policy",)


def test_all_mistakes_are_told_at_once():
    text = "domains: 300\nrtps_protection_kind: X\ntopics:\n- topic: no\n- tpic: a\n"
    said = problems(read_governance, text)
    assert [each.split(":")[0] for each in said] == ["line 1", "line 2", "line 4", "line 5"]


def test_a_million_mistakes_are_told_by_the_first():
    said = problems(read_permissions, "grants:\n" + "- x\n" * 1000)
    assert len(said) == 101
    assert said[-1] == "and 900 more"


@pytest.mark.parametrize("codec", ["utf-8-sig", "utf-16", "utf-16-be"])
def test_a_byte_order_mark_says_the_encoding(codec):
    text = ("\ufeff" if codec == "utf-16-be" else "") + "grants: [{name: é, publish: x}]"
    assert read_permissions(text.encode(codec)).grants[0].name == "é"


@pytest.mark.timeout(120)  # what is quadratic takes hours
def test_hostile_documents_are_refused_quickly():
    bomb = "a: &a [x]\n" + "".join(f"b{i}: &b{i} [*a, *a]\n" for i in range(1000))
    for text in ("[" * 5_000_000, "{" * 5_000_000, "? " * 1_000_000, "- " * 1_000_000, bomb):
        problems(read_governance, text)
    problems(read_governance, b" " * (100 << 20))


def test_times_are_written_with_their_zone_and_beyond_the_stacks_reach():
    text = "grants: [{name: a, validity: {not_after: 9999-12-31T23:59:59Z}, publish: x}]"
    value = read_permissions(text)
    assert read_permissions(permissions_to_yaml(value)) == value
    with pytest.raises(UsageError, match="to Cyclone DDS, any time after 2261 is expired"):
        value.to_xml()
    assert Permissions.from_xml(read_permissions(text.replace("9999", "2261")).to_xml())


# The JSON Schema, for editors


class _EditorLoader(yaml.SafeLoader):
    """YAML as editors read it: times are text."""

    yaml_implicit_resolvers = {  # noqa: RUF012 - yaml's
        first: [(tag, pattern) for tag, pattern in pairs if "timestamp" not in tag]
        for first, pairs in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }


SCHEMAS = {read_governance: "governance", read_permissions: "permissions"}
GOOD = [
    (read_governance, "{}"),
    *((read_governance, f"domains: {text}") for text, _ in DOMAINS),
    *((read_governance, new_governance(preset, DomainSet.of(0)).decode()) for preset in PRESETS),
    (read_governance, "preset: strict\nrules:\n- {domains: 1-2, topics: rt/a}\n"),
    (read_governance, "topics: [a, {ros_action: /a/b, enable_read_access_control: false}]"),
    (read_permissions, new_permissions(["/a"], DomainSet.of(0), "1y").decode()),
    (read_permissions, "grants: [{subject: 'CN=a', rules: []}]"),
    (read_permissions, "grants: [{name: '', publish: {topics: x, data_tags: [{a: b}]}}]"),
    (read_permissions, "grants: [{name: a, default: ALLOW, rules: [{deny: {relay: x}}]}]"),
    (read_permissions, "grants: [{name: a, nodes: [b, {node: /c, publish: [d, ~/e, '~']}]}]"),
    (read_permissions, "validity: 1w\ngrants: [{name: a, relay: {topics: [x], partitions: p}}]"),
]  # fmt: skip
UNSEEN = re.compile(
    "empty range|too long|02-30|remove .namespace|quotes|alias|010|yes|1e3|as a date"
)
"""What needs arithmetic, or is gone when an editor's YAML 1.1 has read it."""


@pytest.mark.parametrize(("read", "text"), GOOD)
def test_the_json_schema_takes_what_is_read(read, text):
    read(text)
    assert not list(schema_of(SCHEMAS[read]).iter_errors(yaml.load(text, _EditorLoader)))  # noqa: S506 - safe


@pytest.mark.parametrize(
    ("read", "text"),
    [
        (read, text)
        for read, text, _, words in FAULTS[: len(GOVERNANCE_FAULTS + PERMISSIONS_FAULTS)]
        if not UNSEEN.search(f"{text} {words}")
    ],
)  # fmt: skip
def test_the_json_schema_refuses_what_is_refused(read, text):
    assert list(schema_of(SCHEMAS[read]).iter_errors(yaml.load(text, _EditorLoader)))  # noqa: S506 - safe


def test_the_json_schemas_know_every_preset_and_protection():
    presets = schema_of("governance").schema["$defs"]["preset"]["enum"]
    assert presets == [preset.name for preset in PRESETS]
    assert schema_of("governance").schema["$defs"]["protection"]["enum"] == list(ProtectionKind)


def test_an_hour_24_is_refused_in_every_python():
    with pytest.raises(InvalidDocumentError, match="not a time with a zone"):
        read_permissions(
            "validity: {not_after: 2030-01-30T24:00:00Z}\ngrants: [{name: a, publish: x}]"
        )
