"""The domain file: what is meant, and that every mistake is told with its file and line."""

import hashlib
import json
import re
from pathlib import Path

import pytest
import yaml

from pqsec_pki.algorithms import PROFILES
from pqsec_pki.documents import PRESETS, DomainSet
from pqsec_pki.domain import _groups, new_domain, read_domain
from pqsec_pki.domain._listing import MAX_PARTICIPANTS
from pqsec_pki.domain.desired import EDITION
from pqsec_pki.errors import FileError, InvalidDocumentError
from tests.json_schemas import schema_of

HEAD = "roles: {r: {publish: rt/a}}\nparticipants:\n"


@pytest.fixture
def read(tmp_path):
    """read(text, name=content, ...) is the domain that the text, beside these files, wants."""

    def reading(text, **files):
        for name, content in files.items():
            data = content if isinstance(content, bytes) else content.encode()
            (tmp_path / name.replace("_", ".")).write_bytes(data)
        (tmp_path / "domain.yaml").write_text(text)
        return read_domain(tmp_path / "domain.yaml")

    return reading


@pytest.fixture
def problems(read, tmp_path):
    def found(text, **files):
        with pytest.raises(InvalidDocumentError) as refusal:
            read(text, **files)
        return [line.replace(f"{tmp_path}/", "") for line in refusal.value.lines]

    return found


def topics(member, side="publish"):
    """The topics of the one rule of its one grant."""
    [grant] = member.spec().grants
    [rule] = grant.rules
    return [topic for criteria in getattr(rule, side) for topic in criteria.topics]


# What is meant


def test_an_empty_mapping_is_a_domain_with_nobody(read):
    empty = read("{}")
    assert empty.members == {}
    assert empty.governance == PRESETS[0].governance(DomainSet.of(0))
    assert (empty.name, empty.profiles, empty.stock, empty.prune) == ("", (), (), False)
    assert (empty.ca_validity.days, empty.renew_before) == (3650, None)


def test_the_file_that_init_writes_is_read(read):
    found = read(new_domain("Lab").decode())
    assert list(found.members) == [*(f"/fleet/robot00{n}" for n in (1, 2, 3)), "/monitor"]
    assert found.name == "Lab"
    assert topics(found.members["/fleet/robot002"]) == ["rt/fleet/robot002/pose"]


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("/a", ["/a"]),
        ("a/b/", ["/a/b"]),
        ("/r{1..3}", ["/r1", "/r2", "/r3"]),
        ("/r{08..11}", ["/r08", "/r09", "/r10", "/r11"]),
        ("/r{9..11}", ["/r9", "/r10", "/r11"]),
        ("/{left,right}/arm{1..2}", ["/left/arm1", "/left/arm2", "/right/arm1", "/right/arm2"]),
        ("/r{5..5}", ["/r5"]),
        ("/r{a,}", ["/ra", "/r"]),
    ],
)
def test_a_pattern_stands_for_its_names(read, pattern, names):
    assert list(read(f"{HEAD}- name: '{pattern}'\n  role: r").members) == names


def test_names_may_be_a_list_and_in_another_file(read):
    text = f"{HEAD}- {{name: [/a, '/b{{1..2}}'], role: r}}\n- {{list: names.txt, role: r}}\n"
    found = read(text, names_txt="# people\n\n/c   # the third\n/d{1..2}\n")
    assert list(found.members) == ["/a", "/b1", "/b2", "/c", "/d1", "/d2"]


def test_a_csv_file_says_what_differs_from_row_to_row(read):
    found = read(
        "domains: 1\nvalidity: 2y\n"
        "roles:\n  r: {publish: rt/$site/$base, domains: 2, validity: 90d}\n  s: {publish: rt/s}\n"
        "participants:\n- {csv: robots.csv, role: r, values: {site: home}}\n",
        robots_csv='\ufeffname, role,domains,validity,site,note\n/x/a,,,,hall,"no, use"\n'
        "/x/b,s,,1w,lab,\n\n/x/c,,3-4,,lab,\n",
    )
    a, b, c = found.members.values()
    assert [each.name for each in (a, b, c)] == ["/x/a", "/x/b", "/x/c"]
    assert topics(a) == ["rt/hall/a"]
    assert topics(b) == ["rt/s"]
    assert topics(c) == ["rt/lab/c"]
    assert [str(each.domains) for each in (a, b, c)] == ["2", "1", "3-4"]
    assert [each.validity.days for each in (a, b, c)] == [90, 7, 90]


def test_a_column_that_fills_a_blank_may_be_called_almost_like_one_that_counts(read):
    text = "participants:\n- {csv: d.csv, publish: rt/$domain}"
    assert topics(read(text, d_csv="name,domain\n/a,hall\n").members["/a"]) == ["rt/hall"]


def test_blanks_are_filled_wherever_a_text_stands(read):
    found = read(
        "roles:\n  r:\n    nodes:\n    - {node: $name/driver, publish: [~/out, $parent/map]}\n"
        "    publish: [{topics: 'rt/$$x', partitions: $zone}]\n"
        "participants:\n- {name: /fleet/one, role: r, values: {zone: '7'}}\n"
    )
    [grant] = found.members["/fleet/one"].spec().grants
    [rule] = grant.rules
    nodes, special = sorted(rule.publish, key=lambda each: bool(each.partitions))
    assert {"rt/fleet/one/driver/out", "rt/fleet/map"} < set(nodes.topics)
    assert (special.topics, special.partitions) == (("rt/$x",), ("7",))


def test_a_dollar_is_written_twice_also_where_there_is_no_blank(read):
    text = "roles:\n  r: {publish: a$$b}\nparticipants:\n- {name: /a, role: r}\n"
    assert topics(read(text).members["/a"]) == ["a$b"]


def test_a_participant_may_say_itself_what_it_may_do(read):
    found = read(
        "participants:\n- name: /a\n  subscribe: rt/$name\n  domains: 5\n  default: ALLOW\n"
        "- name: /b\n  rules: [{deny: {relay: x}}, {allow: {domains: 9, publish: y}}]\n"
    )
    assert topics(found.members["/a"], "subscribe") == ["rt//a"]
    assert str(found.members["/a"].domains) == "5"
    [grant] = found.members["/b"].spec().grants
    assert [(rule.allow, str(rule.domains)) for rule in grant.rules] == [(False, "0"), (True, "9")]


@pytest.mark.parametrize(
    "text",
    [
        "governance: authenticated\ndomains: 0-3",
        "governance: {file: g.yaml}",
        "governance: {file: g.xml}",
        "governance: {preset: authenticated}\ndomains: 0-3",
        "governance: {preset: authenticated, rules: [{domains: 0-3}]}",
    ],
)
def test_governance_may_be_a_preset_a_file_or_stand_there(read, text):
    same = PRESETS[1].governance(DomainSet.parse("0-3"))
    files = {"g_yaml": "{preset: authenticated, domains: 0-3}", "g_xml": same.to_xml()}
    found = read(text, **files)
    assert found.governance == same
    assert (
        found.governance_digest == read("governance: authenticated\ndomains: 0-3").governance_digest
    )
    assert found.governance_digest != read("governance: strict\ndomains: 0-3").governance_digest


# Marks


ROLE = (
    "roles:\n  r: {publish: [rt/$name, rt/b], nodes: $name}\nparticipants:\n- {name: /a, role: r}"
)


def mark(found, name="/a"):
    return found.members[name].config_digest


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("roles", "# comment\n\nroles"),
        ("{publish: [rt/$name, rt/b], nodes: $name}", "{nodes: $name, publish: [rt/$name, rt/b]}"),
        ("r:", "another:"),
        ("rt/b", "'rt/b'"),
        ("/a, role", "'/{a,b}', role"),
        ("roles", "validity: 5y\nroles"),
        ("roles", "name: Lab\ngovernance: migration\nprune: true\nroles"),
        ("role: r", "role: r, values: {unused: x}"),
        ("roles", "domains: 0\nroles"),
    ],
)
def test_a_mark_stays_where_what_is_allowed_does(read, old, new):
    changed = ROLE.replace(old, new)
    assert changed != ROLE
    changed = changed.replace("role: r}", "role: another}") if "another:" in changed else changed
    assert mark(read(changed)) == mark(read(ROLE))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("rt/b", "rt/c"),
        ("publish", "subscribe"),
        ("[rt/$name, rt/b]", "[rt/b, rt/$name]"),
        ("roles", "domains: 1\nroles"),
        ("role: r", "role: r, domains: 3"),
        ("nodes:", "domains: 4, nodes:"),
        ("nodes:", "default: ALLOW, nodes:"),
    ],
)
def test_a_mark_differs_where_what_is_allowed_does(read, old, new):
    assert mark(read(ROLE.replace(old, new, 1))) != mark(read(ROLE))


def test_a_value_that_a_role_asks_for_is_in_the_mark(read):
    text = "participants:\n- {name: /a, publish: rt/$v, values: {v: x}}"
    assert mark(read(text)) != mark(read(text.replace("v: x", "v: y")))


def test_the_edition_is_that_of_what_roles_mean_today(read):
    """If this fails, the same words mean other rules: count EDITION up, and note the new hash."""
    found = read(
        "roles:\n  r:\n    publish: rt/a\n    nodes: [{node: /n, subscribe: s, services: t, "
        "clients: u, action_servers: v, action_clients: w, parameters_of: /x, lifecycle_of: /y, "
        "lifecycle: true, use_sim_time: true}]\nparticipants: [{name: /a, role: r}]"
    )
    rules = repr(found.members["/a"].spec().grants[0].rules)
    values = rules.replace("PermissionRule(", "Rule(")  # the class had that name in edition 1
    meaning = hashlib.sha256(values.encode()).hexdigest()[:16]
    assert (EDITION, meaning) == (1, "53f0751a64093979")


def test_a_group_has_names_and_patterns_of_participants(read):
    people = "- {name: ['/r{01..03}', /r01/arm, /r02/arm, /z], role: r}\n"
    given = "groups: {one: z, arms: /*/arm, few: ['/r{02..03}', z/, '/r{01,02}/*', /z]}"
    assert read(HEAD + people + given).groups == {
        "arms": ("/r01/arm", "/r02/arm"),
        "few": ("/r01/arm", "/r02", "/r02/arm", "/r03", "/z"),
        "one": ("/z",),
    }
    assert read("groups: {}").groups == read("{}").groups == {}


def test_no_more_names_in_groups_than_anybody_needs(problems, monkeypatch):
    monkeypatch.setattr(_groups, "MAX_GROUPED", 5)
    text = f"{HEAD}- {{name: '/r{{1..3}}', role: r}}\ngroups:\n  a: /*\n  b: /**"
    assert problems(text) == ["domain.yaml: line 5: the groups have more than 5 names"]


# Mistakes

SHAPE_FAULTS = [
    ("nam: x", "domain.yaml: line 1: nam: no such key here; did you mean name?"),
    ("profile: rsa", "domain.yaml: line 1: profile: 'rsa' is not allowed"),
    ("\nvalidity: 1 year", "domain.yaml: line 2: validity: '1 year' is not a duration"),
    ("governance: stric", "line 1: governance: 'stric' is not allowed; did you mean strict?"),
    ("governance:\n  topcs: a", "line 2: topcs: no such key here; did you mean topics?"),
    ("governance: [strict]", "line 1: governance: expected `key: value`"),
    ("roles: {r: {}}", "line 1: r: allows nothing"),
    ("roles:\n  r:\n    publich: a", "line 3: publich: no such key here; did you mean publish?"),
    ("roles:\n  r:\n    nodes: [7b]", "line 3: nodes: "),
    ("participants: [/a]", "line 1: participants: expected `key: value` here"),
    ("participants: [{role: r}]", "line 1: role: there are no roles in the file"),
    (f"{HEAD}- role: r", "line 3: participants: an item must have exactly one of"),
    (f"{HEAD}- {{name: /a, csv: b, role: r}}", "line 3: participants: an item must have"),
    (f"{HEAD}- name: /a", "line 3: participants: it has no rules"),
    (f"{HEAD}- {{name: /a, role: r, publish: x}}", "line 3: participants: it has a role: put"),
    (f"{HEAD}- {{name: /a, role: r, values: {{base: x}}}}", "line 3: values: $base is a reserved"),
    ("groups: [a]", "line 1: groups: expected `key: value` here"),
    ("approvals: [a]", "line 1: approvals: expected `key: value` here"),
    ("approvals: {required: 2}", "line 1: approvals: "),
    ("approvals: {required: two, of: {a: a.pem}}", "'two' is not a number"),
    ("approvals: {required: 1, of: [a.pem]}", "line 1: of: expected `key: value` here"),
    ("approvals: {required: 1, of: {a: [b]}}", "line 1: "),
    ("approvals: {required: 1, of: {a: a.pem}, for: sing}", "'sing' is not allowed"),
    ("groups:\n  a: []", "line 2: a: the group is empty"),
    ("groups:\n  '@a': /a", "line 2: groups: '@a' cannot be a group's name: write it without @"),
    ("groups:\n  a: {name: /a}", "line 2: a: expected a text here"),
    ("a: &a b", "domain.yaml: line 1: the anchor &a is not allowed"),
]  # fmt: skip
"""What the JSON Schema sees too."""
OTHER_FAULTS = [
    ("\nvalidity: 999999y", "domain.yaml: line 2: validity: certificates end in 2261"),
    (f"renew_before: 999999y\n{HEAD}- {{name: /a, role: r}}", "line 4: /a would be due when"),
    ("domains: {min: 5}", "line 1: domains: domains 5- has no end"),
    ("domains: {id: 231}", "line 1: domains: domain 231 is above 230"),
    ("prune: yes", "line 1: prune: 'yes' is not true or false"),
    ("roles:\n  r:\n    publish: rt/$", "line 3: r: a $ without a name after it; write $$"),
    (f"{HEAD}- {{name: /a, role: s}}", "line 3: role: 's' is not allowed"),
    (f"{HEAD}- name: '/a{{1-3}}'\n  role: r", "line 3: '/a{1-3}': write {001..100}"),
    (f"{HEAD}- name: '/a{{3..1}}'\n  role: r", "line 3: '/a{3..1}': {3..1} ends below"),
    (f"{HEAD}- name: '/a{{1..999999999}}'\n  role: r", "gives 999999999 names"),
    (f"{HEAD}- name: '/a{{1..999}}{{1..999}}'\n  role: r", "gives 998001 names"),
    (f"{HEAD}- name: ../a\n  role: r", "line 3: '../a' cannot be a participant's name"),
    (f"{HEAD}- name: /a.pem\n  role: r", "line 3: '/a.pem' cannot be"),
    (f"{HEAD}- name: /{'a' * 64}\n  role: r", "has 65 characters: at most 64 are allowed"),
    (f"{HEAD}- name: /a\n  role: r\n- {{name: a, role: r}}", "line 5: /a appears twice, first in"),
    (f"renew_before: 1y\n{HEAD}- {{name: /a, role: r}}", "line 4: /a would be due when it is"),
    ("participants:\n- name: /a\n  publish: rt/$x", "line 2: /a: its role (its own) needs $x"),
    ("participants:\n- name: /a-b\n  nodes: $name", "domain.yaml: line 3: nodes: "),
    (f"{HEAD}- {{list: l.txt, role: r}}", "l.txt: line 3: '/b/../c' cannot be"),
    (f"{HEAD}- {{list: twice.txt, role: r}}", "twice.txt: line 2: /a appears twice, first in "),
    (f"{HEAD}- {{csv: short.csv, role: r}}", "short.csv: line 3: 1 values for 2 columns"),
    (f"{HEAD}- {{csv: nameless.csv, role: r}}", "nameless.csv: line 1: the first line must"),
    (f"{HEAD}- {{csv: empty.csv, role: r}}", "empty.csv: line 1: the first line must"),
    (f"{HEAD}- {{csv: again.csv, role: r}}", "again.csv: line 1: the column 'x' appears twice"),
    (f"{HEAD}- {{csv: slip.csv, role: r}}", "slip.csv: line 1: no role has $Domain; is the col"),
    ("participants: [{csv: star.csv, publish: rt/$x}]", "star.csv: line 3: '*' in column 'x' has"),
    ("participants: [{csv: bell.csv, publish: rt/$x}]", "XML cannot contain the character '\\x07'"),
    ('participants: [{name: /a, publish: "\\a"}]', "participants: XML cannot contain"),
    ('participants: [{name: /a, publish: $x, values: {x: "\\a"}}]', "line 1: x: XML cannot"),
    ("name: a, CN=b", "line 1: name: 'a, CN=b Permissions CA' has characters that DDS stacks"),
    (f"\nname: {'x' * 60}", "line 2: name: a common name has 1 to 64 characters"),
    (f"{HEAD}- {{name: /a, role: r, request: ''}}", "line 3: request: the file name is empty"),
    (f"{HEAD}- name: '/{'{a,b}' * 17}'\n  role: r", "has more than 16 pairs of braces"),
    (f"{HEAD}- {{csv: quote.csv, role: r}}", "quote.csv: line 2: not CSV: "),
    (f"{HEAD}- {{csv: latin.csv, role: r}}", "latin.csv: line 2: not UTF-8 text"),
    (f"{HEAD}- csv: roles.csv", "roles.csv: line 3: /b has no role"),
    (f"{HEAD}- csv: unknown.csv", "unknown.csv: line 2: 's' is not allowed"),
    (f"{HEAD}- {{csv: when.csv, role: r}}", "when.csv: line 3: '1 day' is not a duration"),
    (f"{HEAD}- {{name: /robot1, role: r}}\ngroups:\n  a: /robot2", "; did you mean '/robot1'?"),
    (f"{HEAD}- {{name: /a, role: r}}\ngroups:\n  a: /b/*", "line 5: no participant of the file"),
    (f"{HEAD}- {{name: /a, role: r}}\ngroups:\n  a: ['/a{{1-3}}']", "line 5: '/a{1-3}': write {0"),
    (f"{HEAD}- {{name: /a, role: r}}\ngroups:\n  a: '@a'", "line 5: '@a' cannot be a participant'"),
    ("governance: {file: bad.yaml}", "bad.yaml: line 2: topcs: no such key here"),
]  # fmt: skip
FILES = {
    "l_txt": "/a\n\n/b/../c\n",
    "twice_txt": "/a\n/a\n",
    "short_csv": "name,x\n/a,1\n/b\n",
    "nameless_csv": "nom,x\n/a,1\n",
    "empty_csv": "",
    "star_csv": "name,x\n/a,b\n/b,*\n",
    "bell_csv": "name,x\n/a,\a\n",
    "again_csv": "name,x,x\n/a,1,2\n",
    "slip_csv": "name,Domain\n/a,1\n",
    "quote_csv": 'name\n"/a\n',
    "latin_csv": b"name\n/\xe9\n",
    "roles_csv": "name,role\n/a,r\n/b,\n",
    "unknown_csv": "name,role\n/a,s\n",
    "when_csv": "name,validity\n/a,1d\n/b,1 day\n",
    "bad_yaml": "domains: 0\ntopcs: a\n",
}


@pytest.mark.parametrize(("text", "told"), SHAPE_FAULTS + OTHER_FAULTS)
def test_a_mistake_is_told_with_its_file_and_line(problems, text, told):
    found = problems(text, **FILES)
    assert any(told in line for line in found), found
    assert all(re.match(r"[a-z]+\.(yaml|csv|txt): line [0-9]+: ", line) for line in found), found


def test_all_mistakes_are_told_at_once(problems):
    text = "validity: x\nroles: {r: {publich: a}}\nparticipants: [{name: /a}, {list: l}]\n"
    assert len(problems(text)) == 4
    many = "".join(f"/a{n}.pem\n" for n in range(500))
    assert len(problems(f"{HEAD}- {{list: l.txt, role: r}}", l_txt=many)) == 20


@pytest.mark.parametrize("key", ["csv", "list"])
def test_a_list_that_is_not_there_is_a_file_error(read, key):
    with pytest.raises(FileError, match="nowhere"):
        read(f"{HEAD}- {{{key}: nowhere, role: r}}")


def test_no_more_participants_than_anybody_has(problems):
    half = MAX_PARTICIPANTS // 2
    text = "".join(f"- {{name: '/{x}{{0..{half}}}', role: r}}\n" for x in "ab")
    told, *_ = problems(HEAD + text)
    assert f"domain.yaml: line 4: more than {MAX_PARTICIPANTS} participants" in told
    bombs = [
        "/" + "{a,b}" * 1_000_000 + "\n",
        "/{1..99999}\n" * 500_000,
        "/{a,b}{1..999999999}\n" * 300_000,
        "/.\n" * 2_000_000,
    ]
    for bomb in bombs:
        assert problems(f"{HEAD}- {{list: l.txt, role: r}}", l_txt=bomb)


# The JSON Schema, for editors


GOOD = [
    "{}",
    new_domain("Lab").decode(),
    ROLE,
    "governance: authenticated\nprofile: pq\nca_validity: 5y\nrenew_before: 30d\nprune: true",
    "governance: {file: g.yaml}",
    "governance: {preset: migration, domains: 0-3, topics: [a, '*']}",
    "governance: {rules: [{domains: 1}]}",
    f"{HEAD}- {{name: [/a, '/b{{1..2}}'], role: r, domains: '0-3', validity: 90d}}",
    f"{HEAD}- {{list: good.txt, role: r, request: inbox/, values: {{site: x}}}}\n- csv: good.csv",
    "participants: [{name: /a, nodes: [$name, {node: $base, publish: ~/x}], publish: []}]",
    f"{HEAD}- {{name: [/a, /b], role: r}}\ngroups: {{hall-1: /a, x: [/a, '/*']}}",
    "participants: [{name: /a, rules: [{deny: {relay: x}}], default: ALLOW}]",
]


@pytest.mark.parametrize("text", GOOD)
def test_the_json_schema_takes_what_is_read(read, text):
    files = {"g_yaml": "{}", "good_txt": "/t", "good_csv": "name,role\n/u,r\n"}
    read(text, **files)
    assert not list(schema_of("domain").iter_errors(yaml.safe_load(text)))


@pytest.mark.parametrize("text", [text for text, _ in SHAPE_FAULTS])
def test_the_json_schema_refuses_what_is_refused(text):
    assert list(schema_of("domain").iter_errors(yaml.safe_load(text)))


def test_the_example_is_as_the_schema_and_the_reader_want_it():
    example = Path(__file__).parents[2] / "examples/fleet/domain.yaml"
    assert len(read_domain(example).members) == 8
    assert not list(schema_of("domain").iter_errors(yaml.safe_load(example.read_text())))


def test_the_json_schema_has_the_parts_of_those_of_governance_and_permissions():
    parts = dict(schema_of("domain").schema["$defs"])
    text = json.dumps(parts.pop("governance")).replace("#/$defs/governance/$defs/", "#/$defs/")
    head = ("$schema", "$id", "title", "description")
    assert json.loads(text) == {
        k: v for k, v in schema_of("governance").schema.items() if k not in head
    }
    for own in ("role", "participants", "duration", "stack", "covered", "name"):
        parts.pop(own)
    without_blanks = json.dumps(parts).replace("A-Za-z_$]", "A-Za-z_]")
    without_blanks = without_blanks.replace("A-Za-z0-9_$]", "A-Za-z0-9_]")
    whole = schema_of("permissions").schema["$defs"]
    assert json.loads(without_blanks) == {key: whole[key] for key in parts}
    assert whole.keys() - parts.keys() == {"grant", "time", "validity"}


def test_the_json_schema_knows_every_profile_and_key(read):
    one, several = schema_of("domain").schema["properties"]["profile"]["anyOf"]
    assert one["enum"] == [each.name for each in PROFILES]
    assert several["items"]["enum"] == one["enum"][1:]
    told = re.search("allowed: (.*)", _refusal(read, "x: y"))[1]
    assert set(schema_of("domain").schema["properties"]) == set(told.split(", "))
    for part, text in (("role", "roles: {r: {x: y}}"), ("participants", "participants: [{x: y}]")):
        told = re.search("allowed: (.*?)(;|$)", _refusal(read, text))[1]
        assert set(schema_of("domain").schema["$defs"][part]["properties"]) == set(told.split(", "))


def _refusal(read, text):
    with pytest.raises(InvalidDocumentError) as refusal:
        read(text)
    return refusal.value.lines[0]


@pytest.mark.parametrize("end", ["\x85", "\u2028", "\u2029", "\r"])
def test_a_comment_does_not_go_on_as_a_line(read, end):
    """Who reviewed the file saw one line with a comment, and pqsec a participant more."""
    hidden = f"# the first{end}"
    code = f"line [23]: U\\+{ord(end):04X} ends a line"
    with pytest.raises(InvalidDocumentError, match=code):
        read(f"{HEAD}- {{name: /a, role: r}} {hidden}- {{name: /b, role: r}}\n")
    with pytest.raises(InvalidDocumentError, match=f"l.txt: {code}"):
        read(f"{HEAD}- {{list: l.txt, role: r}}\n", l_txt=f"/a\n/c {hidden}/b\n")
    with pytest.raises(InvalidDocumentError, match=f"c.csv: {code}"):
        read(f"{HEAD}- {{csv: c.csv, role: r}}\n", c_csv=f"name,note\n/a,{hidden}/b,x\n")


def test_only_line_feeds_end_the_lines_of_a_list(read):
    text = f"{HEAD}- {{list: l.txt, role: r}}\n"
    assert list(read(text, l_txt="/a # x\x0c/b\x1e/c\r\n/d\r\n").members) == ["/a", "/d"]


@pytest.mark.timeout(60)
def test_a_table_with_many_columns_takes_no_long_time(read):
    columns = ",".join(f"c{number}" for number in range(100_000))
    with pytest.raises(InvalidDocumentError, match="appears twice"):
        read(f"{HEAD}- {{csv: c.csv, role: r}}\n", c_csv=f"name,{columns},c7\n")


@pytest.mark.parametrize("topic", ["''", "' '", "$which"])
def test_a_topic_that_crashes_a_stack_is_refused_before_anything_is_issued(problems, topic):
    text = f"participants:\n- name: /x\n  publish: [{topic}]\n"
    if topic == "$which":
        text = f"roles: {{r: {{publish: [{topic}]}}}}\nparticipants:\n"
        text += "- {name: /x, role: r, values: {which: ' '}}\n"
    [found] = problems(text)
    assert re.match(r"domain\.yaml: line \d: an empty <topic> .* crashes Cyclone DDS", found)


def test_governance_that_crashes_a_stack_is_refused_before_anything_is_issued(problems):
    rules = "{rules: [{domains: 0, topics: [{topic: ' '}]}]}"
    xml = PRESETS[1].governance(DomainSet.of(0)).to_xml().replace(b">*<", b"> <")
    for text, where in ((rules, "domain"), ("{file: g.yaml}", "g"), ("{file: g.xml}", "g")):
        [found] = problems(f"governance: {text}", g_yaml=rules, g_xml=xml)
        assert re.match(rf"{where}\.\w+: line \d+: ", found)
        assert "an empty <topic_expression> crashes Cyclone DDS" in found
