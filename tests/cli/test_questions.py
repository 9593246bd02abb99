"""pqsec explain, who-may and diff: questions to a policy, and their answers."""

import os
import re
import shutil
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from threading import Thread

import pytest

from pqsec_pki.access import INTERPRETATIONS
from pqsec_pki.algorithms import load_private_key, profile_named
from pqsec_pki.documents import (
    Criteria,
    DefaultAction,
    DomainRange,
    DomainSet,
    Governance,
    Grant,
    PermissionRule,
    Permissions,
    governance_to_yaml,
    permissions_to_yaml,
    ros,
)
from pqsec_pki.keystore import Keystore, load_certificate
from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.smime import Signer, sign
from tests.cli.conftest import command_of
from tests.crashing import CRASHING, GOVERNANCE, PERMISSIONS

NOW = datetime.now(UTC)
ZERO = DomainSet.of(0)
FILES = "explain --governance g.xml --permissions p.xml"
CYCLONE = ("cyclonedds@0.10", "cyclonedds@11.0")
HOSTILE_TOPICS = ('a"];x&lt;<b>|`_\n', "*[label=\\N")
HOSTILE_SUBJECT = r"CN=a\"];x\N&lt;<b>|`*_"
QUOTED = r'"(?:[^"\\]|\\.)*"'
DOT_LINE = re.compile(
    rf"  (rankdir=LR|(?P<node>[pt]\d+) \[(shape=box, )?label=(?P<label>{QUOTED})\]"
    r"|(?P<tail>[pt]\d+) -> (?P<head>[pt]\d+));"
)


def test_a_topic_where_a_path_belongs_is_told_its_option(pqsec):
    pqsec("who-may /cmd_vel").refused(3, "/cmd_vel: no such file", hint="--topic or --ros-topic")


def test_a_right_ends_with_its_grant_or_before_with_the_certificate(pqsec, keystore, tmp_path):
    keystore(profile="transition")
    ask = "-k k explain /talker --publish rt/chatter"
    found = pqsec(f"{ask} --json").done().json
    ends = pqsec("-k k status /talker --json").json["participants"][0]["not_after"]
    assert (found["until"], found["keys"]) == (ends, "ecdsa-p256 and ml-dsa-65")
    assert re.search(
        r"\n      until       2.* \w+, keys ecdsa-p256 and ml-dsa-65\n", pqsec(ask).out
    )
    assert pqsec("-k k who-may --json").json["until"] == {"/listener": ends, "/talker": ends}
    soon = NOW + timedelta(days=2)
    path = tmp_path / "k/enclaves/talker/permissions.xml"
    text = re.sub("<not_after>[^<]*", f"<not_after>{soon:%Y-%m-%dT%H:%M:%SZ}", path.read_text())
    (tmp_path / "short.xml").write_text(text)
    pqsec("-k k sign-permissions short.xml --force -o k/enclaves/talker/permissions.p7s").done()
    assert pqsec(f"{ask} --json").json["until"] == f"{soon:%Y-%m-%dT%H:%M:%SZ}"
    assert pqsec("-k k who-may --json").json["until"]["/talker"] == f"{soon:%Y-%m-%dT%H:%M:%SZ}"
    no = pqsec("-k k explain /talker --publish rt/other --json").json
    assert (no["allowed"], no["until"]) == (False, None)


def test_a_right_ends_before_with_a_ca(pqsec, keystore, tmp_path):
    """After its end nobody accepts what the permissions CA signed; a later end was told."""
    keystore()
    pqsec("-k k ca rotate --only permissions --validity 20d --apply --yes --no-passphrase").done()
    ca = load_certificate(tmp_path / "k/public/permissions_ca.cert.pem")
    ends = f"{ca.not_after:%Y-%m-%dT%H:%M:%SZ}"
    assert pqsec("-k k explain /talker --publish rt/chatter --json").json["until"] == ends
    assert pqsec("-k k who-may --json").json["until"] == {"/listener": ends, "/talker": ends}


def grant(*rules, subject="CN=/robot", days=300):
    return Grant(
        name="g",
        subject_name=subject,
        not_before=NOW - timedelta(2),
        not_after=NOW + timedelta(days),
        rules=rules,
    )


def rule(*topics, allow=True, domains=ZERO, partitions=(), action="publish"):
    criteria = Criteria(topics=topics, partitions=partitions)
    return PermissionRule(allow=allow, domains=domains, **{action: (criteria,)})


def permissions(*rules, **more):
    return Permissions(grants=(grant(*rules, **more),))


@pytest.fixture
def put(tmp_path):
    """put("p", document) writes p.xml; put("p.yaml", ...) YAML."""

    def write(name, document):
        as_yaml = permissions_to_yaml if isinstance(document, Permissions) else governance_to_yaml
        is_yaml = name.endswith(".yaml")
        path = tmp_path / (name if is_yaml else f"{name}.xml")
        path.write_bytes(as_yaml(document) if is_yaml else document.to_xml())
        return path

    return write


@pytest.fixture
def policy(put):
    """Governance `g` of domain 0, and permissions `p` to publish chatter and rt/*."""
    put("g", Governance.protected(ZERO))
    put("p", permissions(rule("chatter", "rt/*")))


# explain


@pytest.mark.parametrize(
    ("question", "code"),
    [
        ("--publish rt/chatter", 0),
        ("--ros-publish /chatter", 0),
        ("--ros-subscribe /chatter", 0),
        ("--join", 0),
        ("--publish rt/other", 1),
        ("--relay rt/chatter", 1),
        ("--publish rt/chatter --partition A", 1),
        ("--publish rt/chatter --tag a=b", 1),
        ("--join --domain 7", 1),
    ],
)
def test_a_participant_may_or_may_not(pqsec, keystore, question, code):
    keystore()
    said = pqsec(f"-k k explain --participant /talker {question}")
    assert said.code == code
    assert said.out.startswith(("NO    ", "YES   ")[code == 0])
    assert pqsec(f"-k k explain --participant talker {question} --json").json[
        "allowed"
    ] is not bool(code)


@pytest.mark.parametrize("ends", ["\n", "\r\n"], ids=["lf", "crlf"])
def test_the_rule_that_decided_is_told_with_its_line_in_the_signed_file(pqsec, keystore, ends):
    path = keystore() / "enclaves/talker/permissions.p7s"
    text = path.read_text().replace("\n", ends)
    path.write_bytes(text.encode())
    found = pqsec("-k k explain --participant /talker --publish rt/chatter --json").done().json
    lines = text.split(ends)
    assert lines[found["line"] - 1].strip() == "<allow_rule>"
    assert lines[found["criteria_line"] - 1].strip() == "<publish>"
    said = pqsec("-k k explain --participant /talker --publish rt/chatter").done().out
    assert f"k/enclaves/talker/permissions.p7s:{found['line']} " in said


def test_a_decoy_before_the_document_does_not_move_the_line(pqsec, policy, tmp_path, keystore):
    signed = (keystore() / "enclaves/talker/permissions.p7s").read_text()
    document = signed.partition("text/plain\n\n")[2].partition("\n------")[0]
    decoy = signed.replace("This is an S/MIME", f"{document}\nThis is an S/MIME")
    (tmp_path / "p.xml").write_text(decoy)
    line = pqsec(f"{FILES} --publish rt/chatter --json").done().json["line"]
    lines = decoy.split("\n")
    assert lines[line - 1].strip() == "<allow_rule>"
    assert line > lines.index("Content-Type: text/plain")


@pytest.mark.parametrize(
    ("rules", "asked", "line"),
    [
        ([rule("a")], "--publish a", "<allow_rule>"),
        ([rule("a"), rule("b", allow=False)], "--publish b", "<deny_rule>"),
        ([rule("a")], "--publish z", '<grant name="g">'),
        ([rule("a")], "--publish a --domain 3", None),
    ],
)
def test_what_decided_is_told_by_file_and_line(pqsec, put, rules, asked, line):
    put("g", Governance.protected(ZERO))
    lines = put("p", permissions(*rules)).read_text().split("\n")
    found = pqsec(f"{FILES} {asked} --json").json
    assert found["file"] == ("p.xml" if line else None)
    assert (lines[found["line"] - 1].strip() if line else found["line"]) == line


def test_governance_that_opens_a_topic_decides(pqsec, put, tmp_path):
    [domain] = Governance.protected(ZERO).domain_rules
    [topics] = domain.topic_rules
    opened = replace(domain, topic_rules=(replace(topics, enable_write_access_control=False),))
    put("g", Governance(domain_rules=(opened,)))
    put("p", permissions(rule("a")))
    found = pqsec(f"{FILES} --publish z --json").done().json
    assert found["file"] == "g.xml"
    assert "<topic_rule>" in (tmp_path / "g.xml").read_text().split("\n")[found["line"] - 1]


def test_what_governance_adds_is_told(pqsec, policy):
    said = pqsec(f"{FILES} --publish chatter").done().out
    assert "payload: encrypted: only members can read it" in said
    assert "participants without credentials: may not take part" in said
    assert pqsec(f"{FILES} --publish other --json").json["protection"] == []


def test_yaml_is_answered_too(pqsec, put):
    put("g.yaml", Governance.protected(ZERO))
    put("p.yaml", permissions(rule("a")))
    asked = "explain --governance g.yaml --permissions p.yaml --publish"
    found = pqsec(f"{asked} a --json").done().json
    assert (found["file"], found["line"] > 1) == ("p.yaml", True)
    assert pqsec(f"{asked} b").code == 1


@pytest.mark.timeout(120)  # what is cubic takes longer than anybody lives
def test_blank_lines_beyond_number_are_refused_at_once(pqsec, tmp_path):
    (tmp_path / "blank.yaml").write_bytes(b"\n" * (7 << 20) + b"x")
    assert pqsec("diff blank.yaml blank.yaml").code in {1, 2, 3}


@pytest.mark.parametrize(
    ("rules", "asked", "otherwise"),
    [
        ([rule("a", partitions=("P",)), rule("a")], "a --partition P", {"opendds"}),
        (
            [rule("a", allow=False, partitions=("P",)), rule("a")],
            "a",
            {*CYCLONE, "fastdds", "opendds"},
        ),
        (
            [rule("a", allow=False, action="subscribe"), rule("a")],
            "a",
            {"cyclonedds@0.10"},
        ),
        ([rule("a")], "a --tag k=v", {*CYCLONE, "fastdds"}),
        ([rule("a", domains=DomainSet(parts=(DomainRange(first=0),)))], "a --domain 1", set()),
        ([rule("[^b]")], "a", {*CYCLONE, "opendds"}),
    ],
)
def test_stacks_that_decide_otherwise_are_told_with_the_reason(pqsec, put, rules, asked, otherwise):
    put("g", Governance.protected(ZERO))
    put("p", permissions(*rules))
    found = pqsec(f"{FILES} --publish {asked} --json").json
    differing = {other["as"] for other in found["others"] if other["differs"]}
    assert differing - {"opendds"} == otherwise - {"opendds"}
    said = pqsec(f"{FILES} --publish {asked}").out
    for interpretation in INTERPRETATIONS[1:]:
        assert (f"{interpretation.title} decides differently" in said) is (
            interpretation.name in differing
        )
    for other in found["others"]:
        assert (other["reason"] in said) or not other["differs"]


@pytest.mark.parametrize("interpretation", INTERPRETATIONS, ids=lambda each: each.name)
def test_one_reading_alone_may_be_asked(pqsec, policy, interpretation):
    found = pqsec(f"{FILES} --publish chatter --partition P --as {interpretation.name} --json").json
    assert (found["as"], found["others"]) == (interpretation.name, [])
    said = pqsec(f"{FILES} --publish chatter --partition P --as {interpretation.name}").out
    assert f"by {interpretation.title}" in said
    assert "otherwise" not in said


@pytest.fixture
def asymmetric(put):
    """The documents of a participant that may publish a topic, but not subscribe to it."""
    put("g", Governance.protected(ZERO))
    put("p", permissions(rule("a", allow=False, action="subscribe"), rule("a"), rule("b")))


@pytest.mark.parametrize(
    ("stack", "code", "by"),
    [
        ("cyclonedds@0.10", 1, "Cyclone DDS 0.10.2"),
        ("cyclonedds@0.10.5", 1, "Cyclone DDS 0.10.2"),
        ("cyclonedds@11.0", 0, "Cyclone DDS 11.0.1"),
        ("cyclonedds@11", 0, "Cyclone DDS 11.0.1"),
        ("cyclonedds@11.0.1", 0, "Cyclone DDS 11.0.1"),
    ],
)
def test_a_version_of_a_stack_is_asked_alone(pqsec, asymmetric, stack, code, by):
    said = pqsec(f"{FILES} --publish a --as {stack}")
    assert (said.code, f"by {by}\n" in said.out) == (code, True)
    assert "differently" not in said.out
    found = pqsec(f"who-may p.xml g.xml --topic a --as {stack} --json").done()
    assert found.json["topics"][0]["publish"] == ([] if code else ["CN=/robot"])
    assert (found.json["others"], "differently" in found.err) == ([], False)


def test_a_stack_without_a_version_is_all_of_them_and_the_one_that_differs_is_told(
    pqsec, asymmetric
):
    said = pqsec(f"{FILES} --publish a --as cyclonedds")
    assert said.code == 1
    assert said.out.startswith("NO    CN=/robot: publish a, domain 0, by Cyclone DDS 0.10.2\n")
    assert "YES   Cyclone DDS 11.0.1 decides differently\n" in said.out
    found = pqsec(f"{FILES} --publish a --as cyclonedds --json").json
    assert (found["allowed"], found["as"]) == (False, "cyclonedds@0.10")
    others = [(each["as"], each["allowed"], each["differs"]) for each in found["others"]]
    assert others == [("cyclonedds@11.0", True, True)]


def test_a_stack_whose_versions_agree_says_so(pqsec, asymmetric):
    said = pqsec(f"{FILES} --publish b --as cyclonedds").done()
    assert "by Cyclone DDS 0.10.2\n" in said.out
    assert "same  Cyclone DDS 11.0.1\n" in said.out
    several = pqsec(f"{FILES} --publish '[ab]' --as cyclonedds")
    assert several.code == 1
    assert "by Cyclone DDS 0.10.2, Cyclone DDS 11.0.1\n" in several.out
    assert "Cyclone DDS 11.0.1: decided differently" in several.out


def test_who_may_tells_the_topics_about_which_versions_of_a_stack_differ(pqsec, asymmetric):
    said = pqsec("who-may p.xml g.xml --as cyclonedds --json").done()
    rows = {each["topic"]: each["publish"] for each in said.json["topics"]}
    assert (said.json["as"], rows) == ("cyclonedds@0.10", {"a": [], "b": ["CN=/robot"]})
    [other] = said.json["others"]
    assert (other["as"], other["differs"]) == ("cyclonedds@11.0", ["a"])
    assert [each["publish"] for each in other["topics"]] == [["CN=/robot"]]
    words = "Cyclone DDS 11.0.1 decides differently about a: ask with --as cyclonedds@11.0"
    for form in ("table", "csv", "md"):
        assert words in pqsec(f"who-may p.xml g.xml --as cyclonedds --format {form}").done().err
    assert words in pqsec("who-may p.xml g.xml --as cyclonedds --matrix").done().err
    assert "differently" not in pqsec("who-may p.xml g.xml --topic b --as cyclonedds").done().err


def test_who_has_a_grant_by_one_version_alone_is_not_left_out(pqsec, keystore):
    """11.0 ignores the spaces in the subject of /talker's documents; 0.10 finds no grant."""
    enclave = keystore() / "enclaves/talker"
    text = (enclave / "permissions.xml").read_text().replace("CN=/talker", "CN = /talker")
    (enclave / "permissions.xml").write_text(text)
    pqsec("-k k sign-permissions k/enclaves/talker/permissions.xml --force").done()
    said = pqsec("-k k who-may --topic rt/chatter --as cyclonedds --json").done().json
    [other] = said["others"]
    assert said["left_out"] == {}
    assert "/talker" not in said["topics"][0]["publish"]
    assert "/talker" in other["topics"][0]["publish"]


def test_a_version_that_no_row_is_for_is_refused_with_those_that_are(pqsec, asymmetric):
    for name in ("cyclonedds@0.9", "cyclonedds@", "fastdds@3.6"):
        said = pqsec(f"who-may p.xml g.xml --as {name}")
        assert (said.code, "'cyclonedds@0.10', 'cyclonedds@11.0'" in said.err) == (2, True)


def test_a_stack_of_which_only_one_side_refuses_is_told_so(pqsec, policy):
    said = pqsec(f"{FILES} --publish chatter --as opendds")
    assert said.code == 1
    assert "its peers would accept it, its own stack refuses" in said.out


def test_a_stack_that_would_let_it_on_its_own_side_is_noted(pqsec, policy):
    said = pqsec(f"{FILES} --join --domain 7")
    assert "same  Cyclone DDS 0.10.2, Cyclone DDS 11.0.1, Fast DDS 2.9.1" in said.out
    assert "note  Fast DDS 2.9.1: its own stack would allow it, its peers refuse" in said.out


@pytest.mark.parametrize(("days", "told"), [(0.3, True), (300, False)])
def test_a_grant_that_ends_soon_is_a_hazard_away_from_utc(pqsec, put, days, told):
    put("g", Governance.protected(ZERO))
    put("p", permissions(rule("a"), days=days))
    assert ("reads the times of a grant as local" in pqsec(f"{FILES} --publish a").out) is told


def test_names_cannot_break_the_output(pqsec, put):
    put("g", Governance.protected(ZERO))
    put("p", permissions(rule("a\x85b")))
    said = pqsec(FILES, "--publish", "a\x1bc").out
    assert "a\\u001bc" in said
    assert "\x1b" not in said


def test_names_of_files_cannot_break_the_output(pqsec, put, tmp_path):
    put("g", Governance.protected(ZERO))
    put("a\x07", permissions(rule("b")))
    (tmp_path / "c\x07.xml").touch()
    asked = "explain --governance g.xml --publish b --permissions"
    assert "a\\u0007.xml:" in pqsec(asked, "a\x07.xml").done().out
    assert "c\\u0007.xml is left out: c\\u0007.xml" in pqsec("who-may .").done().err


# What explain believes


@pytest.mark.parametrize("file", ["permissions.p7s", "governance.p7s"])
def test_a_tampered_document_of_an_enclave_is_not_believed(pqsec, keystore, file):
    path = (keystore() / "enclaves/talker" / file).resolve()
    path.write_bytes(path.read_bytes().replace(b"DENY", b"ALLOW").replace(b">true<", b">false<"))
    asked = "-k k explain --participant /talker --publish rt/secret"
    pqsec(asked).refused(1, file, "changed after signing")
    said = pqsec(f"{asked} --json")
    assert (said.code, said.json["allowed"]) == (1, False)
    assert file in said.json["problems"][0]


def test_a_document_without_signature_is_not_believed(pqsec, keystore):
    enclave = keystore() / "enclaves/talker"
    (enclave / "permissions.p7s").write_bytes((enclave / "permissions.xml").read_bytes())
    pqsec("-k k explain --participant /talker --join").refused(1, "permissions.p7s", "not signed")


def test_a_document_without_its_countersignature_is_not_believed(pqsec, keystore):
    k = keystore("transition")
    pqsec("-k k explain --participant /talker --join").done()
    signer = Signer(
        load_certificate(k / "public/permissions_ca.cert.pem"),
        load_private_key((k / "private/permissions_ca.key.pem").read_bytes(), None),
    )
    enclave = k / "enclaves/talker"
    stripped = sign((enclave / "permissions.xml").read_bytes(), signer, now=NOW)
    (enclave / "permissions.p7s").write_bytes(stripped)
    words = "no post-quantum signature that could be checked"
    pqsec("-k k explain --participant /talker --join").refused(1, "permissions.p7s", words)


def test_the_certificate_of_another_domain_is_not_believed(pqsec, keystore):
    other = keystore(name="other", label="another") / "enclaves/talker/cert.pem"
    (keystore() / "enclaves/talker/cert.pem").write_bytes(other.read_bytes())
    pqsec("-k k explain --participant /talker --join").refused(1, "cert.pem")


def test_a_certificate_with_another_behind_it_is_not_believed(pqsec, keystore):
    k = keystore()
    path, other = (k / f"enclaves/{name}/cert.pem" for name in ("talker", "listener"))
    path.write_bytes(path.read_bytes() + other.read_bytes())
    refused = pqsec("-k k explain --participant /talker --join")
    refused.refused(3, "cert.pem", "2 certificates, not one")


def test_who_was_revoked_may_do_nothing(pqsec, keystore):
    keystore()
    asked = "-k k explain --participant /talker --publish rt/chatter"
    pqsec("-k k ca crl").done()
    pqsec(asked).done()
    pqsec("-k k revoke /talker --yes").done()
    pqsec(asked).refused(1, "enclaves/talker/cert.pem: the certificate of CN=/talker was revoked")
    left = pqsec("-k k who-may --json").done().json
    assert (left["participants"], list(left["left_out"])) == (["/listener"], ["/talker"])


def test_no_private_key_is_needed(pqsec, keystore):
    k = keystore()
    for path in [*k.rglob("*key.pem")]:
        path.unlink()
    pqsec("-k k explain --participant /talker --join").done()
    pqsec("-k k who-may").done()


def test_signed_files_are_unverified_unless_a_ca_is_named(pqsec, keystore):
    k = keystore()
    other = keystore(name="other", label="another")
    asked = (
        f"explain --governance {k}/enclaves/governance.p7s"
        f" --permissions {k}/enclaves/talker/permissions.p7s --join"
    )
    said = pqsec(f"{asked} --json").done()
    assert (said.json["verified"], said.err.count("was not checked")) == (False, 2)
    good = pqsec(f"{asked} --permissions-ca {k}/public/permissions_ca.cert.pem --json").done()
    assert (good.json["verified"], good.err) == (True, "")
    wrong = f"{asked} --permissions-ca {other}/public/permissions_ca.cert.pem"
    pqsec(wrong).refused(1, "permissions.p7s")


# What makes no sense


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (f"{FILES}", "ask exactly one question"),
        (f"{FILES} --join --publish a", "ask exactly one question"),
        (f"{FILES} --publish a --tag x", "not a data tag"),
        (f"{FILES} --publish a --subject nobody", "--subject: 'nobody' is not a subject name"),
        (f"{FILES} --ros-publish chatter", "not a full ROS 2 name"),
        (f"{FILES} --publish a --participant /x", "excludes --governance"),
        (f"{FILES} /x --publish a", "excludes --governance"),
        ("explain /x --participant /x --publish a", "they mean the same"),
        ("explain --governance g.xml --publish a", "no participant named"),
        ("explain --publish a", "no participant named"),
        ("explain --participant /x --publish a", "no keystore"),
        (f"{FILES} --publish a --domain -1", "--domain"),
        (f"{FILES} --publish a --as rti", "--as"),
    ],
)
def test_a_question_that_makes_no_sense_is_refused(pqsec, policy, line, words):
    pqsec(line).refused(2, words)


def test_a_pattern_is_answered_for_what_it_matches(pqsec, policy, put):
    """`--publish 'rt/*'` was once answered with YES, since a rule has just that text."""
    found = pqsec(f"{FILES} --publish '*' --json").done().json["answers"][0]
    told = {each["rule_topic"]: (each["topic"], each["allowed"]) for each in found["topics"]}
    assert told == {"chatter": ("chatter", True), "rt/*": ("rt/x", True)}
    put("p", permissions(rule("rt/a", "rt/b"), rule("rt/c", allow=False)))
    said = pqsec(f"{FILES} --ros-publish '/[abc]'")
    assert said.code == 1
    assert [line.split()[:3] for line in said.out.splitlines() if "  p.xml" in line] == [
        ["yes", "publish", "/a,"],
        ["yes", "publish", "/b,"],
        ["no", "publish", "/c,"],
    ]
    said = pqsec(f"{FILES} --subscribe 'a*'")
    assert (said.code, "a* is a pattern: the answer is for one such topic" in said.err) == (1, True)
    assert pqsec(f"{FILES} --publish 'rt/a]'").out.startswith("NO    CN=/robot: publish rt/a], ")


def test_a_right_in_the_words_of_ros_takes_all_its_topics(pqsec, fleet_of_nodes):
    ask = fleet_of_nodes.replace("who-may", "explain")
    may = [
        ("/bot/server", "--ros-service /reset"),
        ("/desk", "--ros-client /reset"),
        ("/bot/cook", "--ros-action-server /cook"),
        ("/desk", "--ros-action-client /cook"),
        ("/bot/server", "--ros-node /bot/server"),
        ("/bot/cook", "--ros-publish /odom"),
        ("/desk", "--ros-client '/res*'"),
        ("/desk", "--ros-action-client '/c*'"),
    ]
    may_not = [
        ("/desk", "--ros-service /reset"),
        ("/bot/server", "--ros-client /reset"),
        ("/desk", "--ros-action-server /cook"),
        ("/desk", "--ros-parameters /bot/server"),
        ("/desk", "--ros-node /bot/server"),
    ]
    for code, rows in ((0, may), (1, may_not)):
        for name, right in rows:
            said = pqsec(f"{ask} --participant {name} {right}")
            assert (said.code, said.out[:3].strip()) == (code, ("YES", "NO")[code]), (name, right)
    said = pqsec(f"{ask} --participant /desk --ros-client /reset").done().out.splitlines()
    line = r"YES   /desk: call the service /reset, until 2.* \w+, by DDS-Security 1.1"
    assert re.fullmatch(line, said[0])
    assert said[1].startswith("      yes  publish request of /reset, domain 0  ")
    assert said[2].startswith("      yes  subscribe reply of /reset, domain 0  ")
    pqsec(f"{ask} --participant /desk --ros-service reset").refused(2, "not a full ROS 2 name")


def test_explain_and_who_may_have_the_same_options_for_ros_names():
    def options(word: str) -> set[str]:
        given = (each for one in command_of([word]).params for each in one.opts)
        return {each for each in given if each.startswith("--ros-")}

    assert options("explain") == options("who-may")
    assert "--ros-topic" in options("explain")


def test_topics_that_other_rules_deny_keep_their_own_reasons(pqsec, put):
    put("g", Governance.protected(ZERO))
    put("p", permissions(rule("rt/a", "rt/b", allow=False), rule("rt/c")))
    said = pqsec(f"{FILES} --ros-publish '/[a-e]'").out.splitlines()
    denied = "           for these 2: a deny_rule of grant 'g' forbids it to use them on domain 0"
    assert [line.split(",")[0].split()[0] for line in said[1:3]] == ["no", "no"]
    assert said[3] == denied
    assert said[4].startswith("      yes  publish /c, ")


def test_a_right_is_on_one_domain_or_not_at_all(pqsec, put):
    put("g", Governance.protected(DomainSet.parse("0-1")))
    ends = (
        PermissionRule(allow=True, domains=ZERO, publish=(Criteria(topics=("rq/aRequest",)),)),
        PermissionRule(
            allow=True, domains=DomainSet.of(1), subscribe=(Criteria(topics=("rr/aReply",)),)
        ),
    )
    put("p", permissions(*ends))
    assert pqsec(f"{FILES} --ros-client /a").code == 1
    put("p", permissions(*(replace(each, domains=DomainSet.parse("0-1")) for each in ends)))
    pqsec(f"{FILES} --ros-client /a").done()
    pqsec(f"{FILES} --ros-client /a --domain 1").done()
    assert pqsec(f"{FILES} --ros-client /a --domain 2").code == 1


def test_several_participants_are_asked_at_once(pqsec, fleet_of_nodes):
    ask = fleet_of_nodes.replace("who-may", "explain")
    said = pqsec(f"{ask} --participant '/bot/*' --join").done().out
    cook, server = (line for line in said.splitlines() if line[:3] == "YES")
    assert re.fullmatch(r"YES   /bot/cook: join, until 2.* \w+, by DDS-Security 1.1", cook)
    assert server.startswith("YES   /bot/server: join, until ")
    found = pqsec(f"{ask} --participant '/bot/*' --ros-publish /odom --json")
    assert found.code == 1
    told = {each["participant"]: each["allowed"] for each in found.json["answers"]}
    assert (told, found.json["allowed"]) == ({"/bot/cook": True, "/bot/server": False}, False)
    pqsec(f"{ask} --participant '/none/*' --join").refused(3, "no participant matches")
    pqsec(f"{ask} --participant @none --join").refused(3, "there is no group @none")


def test_who_has_a_bad_document_may_not_and_the_others_are_told(pqsec, keystore):
    path = keystore() / "enclaves/talker/permissions.p7s"
    path.write_bytes(path.read_bytes().replace(b"rt/chatter", b"rt/charter"))
    said = pqsec("-k k explain --participant '/*' --join")
    assert said.code == 1
    assert said.out.splitlines()[0].startswith("YES   /listener: join")
    assert "NO    /talker: " in said.out
    assert "permissions.p7s" in said.out
    answers = pqsec("-k k explain --participant '/*' --join --json").json["answers"]
    assert [each["allowed"] for each in answers] == [True, False]


def test_of_several_subjects_one_is_asked(pqsec, put):
    put("g", Governance.protected(ZERO))
    grants = (grant(rule("a")), grant(rule("b"), subject="CN=/other"))
    put("p", Permissions(grants=grants))
    pqsec(f"{FILES} --publish b").refused(2, "grants for 2 subjects", hint="--subject")
    pqsec(f"{FILES} --publish b --subject CN=/other").done()
    assert pqsec(f"{FILES} --publish b --subject CN=/robot").code == 1


def test_a_participant_that_is_not_there_is_an_error(pqsec, keystore):
    keystore()
    pqsec("-k k explain --participant /nobody --join").refused(3, "no participant /nobody")


# who-may


def test_the_matrix_of_a_keystore(pqsec, keystore):
    keystore()
    found = pqsec("-k k who-may --format json").done().json
    both = ["/listener", "/talker"]
    assert found["participants"] == both
    [row] = found["topics"]
    assert row == {
        "topic": "rt/chatter",
        "domains": "0",
        "partitions": [],
        "pattern": False,
        "asked": "rt/chatter",
        "publish": both,
        "subscribe": both,
    }
    assert pqsec("-k k who-may --json").json == found
    said = pqsec("who-may k").done().out
    assert said.splitlines()[1].split() == ["rt/chatter", "0", *["/listener,", "/talker"] * 2]


@pytest.mark.parametrize(
    "option",
    ["--topic rt/chatter", "--ros-topic /chatter", "--topic 'rt/*'", "--ros-topic '/chat*'"],
)
def test_one_topic_alone_may_be_asked(pqsec, keystore, option):
    keystore()
    [row] = pqsec(f"-k k who-may {option} --json").done().json["topics"]
    assert (row["topic"], row["publish"]) == ("rt/chatter", ["/listener", "/talker"])


@pytest.fixture
def apart(pqsec, keystore):
    """Keystore `k` of domains 0-3: /talker and /listener on 0, /one on 1, /two on 1 and 2."""
    keystore()
    _govern(pqsec, "0-3")
    pqsec("-k k issue /one --domain 1 --publish rt/cmd_vel --subscribe rt/scan").done()
    pqsec("-k k issue /two --domain 1-2 --subscribe rt/cmd_vel --publish 'rt/s*'").done()


def _govern(pqsec, domains):
    pqsec(f"governance new --domain {domains} -o g.yaml").done()
    pqsec("-k k sign-governance g.yaml -o k/enclaves/governance.p7s --force").done()


def matrix(pqsec, options=""):
    found = pqsec(f"-k k who-may {options} --json").done().json
    return {
        (row["topic"], row["domains"]): (row["publish"], row["subscribe"])
        for row in found["topics"]
    }


def test_all_domains_are_asked_unless_one_is_named(pqsec, apart):
    both = ["/listener", "/talker"]
    assert matrix(pqsec) == {
        ("rt/chatter", "0"): (both, both),
        ("rt/cmd_vel", "1"): (["/one"], ["/two"]),
        ("rt/cmd_vel", "2"): ([], ["/two"]),
        ("rt/s*", "1-2"): (["/two"], []),
        ("rt/scan", "1"): (["/two"], ["/one"]),
        ("rt/scan", "2"): (["/two"], []),
    }
    assert matrix(pqsec, "--domain 1 --topic rt/cmd_vel") == {
        ("rt/cmd_vel", "1"): (["/one"], ["/two"])
    }
    for form in ("table", "md"):
        lines = pqsec(f"-k k who-may --topic rt/cmd_vel --format {form}").done().out.splitlines()
        assert [line.replace("|", "").split()[1] for line in lines[-2:]] == ["1", "2"]
    labels, _ = graph(pqsec("-k k who-may --topic rt/cmd_vel --format dot").done().out)
    assert {"rt/cmd_vel (domain 1)", "rt/cmd_vel (domain 2)"} <= set(labels.values())


def test_several_domains_may_be_asked(pqsec, apart):
    assert matrix(pqsec, "--domain 0,2-3 --topic rt/c*") == {
        ("rt/chatter", "0"): (["/listener", "/talker"],) * 2,
        ("rt/cmd_vel", "2"): ([], ["/two"]),
    }
    assert matrix(pqsec, "--domain 2-9 --topic rt/chatter") == {("rt/chatter", "2-3"): ([], [])}
    said = pqsec("-k k who-may --domain 3-9 --json").done()
    assert "does not name domains 4-9: no participant can join it" in said.err
    assert said.json["domains"] == "3-9"
    pqsec("-k k who-may --domain 3-").refused(2, "domain")
    pqsec("-k k who-may --domain x").refused(2, "domain")


def test_a_pattern_lists_the_topics_and_patterns_that_it_matches(pqsec, apart):
    assert set(matrix(pqsec, "--topic 'rt/c*'")) == {
        ("rt/chatter", "0"),
        ("rt/cmd_vel", "1"),
        ("rt/cmd_vel", "2"),
    }
    # A pattern that only meets it is asked with a topic of both.
    found = pqsec("-k k who-may --topic '*scan2' --json").done().json["topics"]
    assert [(row["topic"], row["asked"]) for row in found] == [("rt/s*", "rt/scan2")]


def test_a_default_that_allows_shows_beside_what_a_pattern_lists(pqsec, put):
    put("g", Governance.protected(ZERO))
    free = replace(grant(rule("rt/b", allow=False)), default=DefaultAction.ALLOW)
    put("p", Permissions(grants=(free,)))
    found = pqsec("who-may p.xml g.xml --topic 'rt/*' --json").done().json["topics"]
    publishers = {row["topic"]: row["publish"] for row in found}
    assert publishers == {"rt/b": [], "rt/*": ["CN=/robot"]}


@pytest.mark.parametrize(
    ("topic", "words"),
    [
        ("rt/chater", "no rule names rt/chater, so nobody may use it; did you mean 'rt/chatter'?"),
        ("/chatter", "did you mean 'rt/chatter'?"),
        ("tr/scan", "no rule names tr/scan, so nobody may use it; did you mean 'rt/scan'"),
        ("zzz", "no rule names zzz, so nobody may use it\n"),
        ("zz*", "no rule names zz*, so nobody may use it\n"),
    ],
)
def test_a_topic_that_no_rule_names_is_told_with_what_may_be_meant(pqsec, apart, topic, words):
    said = pqsec("-k k who-may --json --topic", topic).done()
    assert words in said.err
    assert list(said.json["unknown_topics"]) == [topic]
    assert pqsec("-k k who-may --topic rt/chatter").done().err == ""


def test_a_topic_that_nobody_may_use_has_its_row_beside_others(pqsec, apart):
    found = pqsec("-k k who-may --json --topic rt/chatter --topic rt/nothing").done().json["topics"]
    assert {row["topic"] for row in found} == {"rt/chatter", "rt/nothing"}


def test_nothing_is_a_slip_where_one_of_several_may_use_all_topics(pqsec, apart):
    pqsec("-k k issue /arm --domain 0 --publish '*'").done()
    said = pqsec("-k k who-may --json --topic rt/chater")
    assert (said.err, said.json["unknown_topics"]) == ("", {})


def test_a_topic_that_a_pattern_covers_is_not_told_as_a_slip(pqsec, apart):
    pqsec("-k k issue /arm --domain 0 --publish 'rt/arm/*'").done()
    asked = ("rt/arm/left", "rt/sca", "rt/arm/l*")
    for topic in asked:
        said = pqsec("-k k who-may --json --topic", topic).done()
        assert (topic, said.err, said.json["unknown_topics"]) == (topic, "", {})
    said = pqsec("-k k explain --participant /arm --subscribe rt/arm/left")
    assert (said.code, said.err) == (1, "")


def test_a_participant_whose_documents_do_not_hold_is_left_out(pqsec, keystore):
    path = keystore() / "enclaves/talker/permissions.p7s"
    path.write_bytes(path.read_bytes().replace(b"DENY", b"ALLOW"))
    said = pqsec("-k k who-may --json").done()
    assert said.json["participants"] == ["/listener"]
    assert "changed after signing" in said.json["left_out"]["/talker"]
    assert "note: /talker is left out" in said.err


@pytest.mark.parametrize(
    ("file", "source", "words"),
    [
        ("cert.pem", None, "k/enclaves/talker lacks cert.pem"),
        ("permissions.p7s", "listener", "no grant is for CN=/talker"),
    ],
)
def test_no_participant_is_left_out_in_silence(pqsec, keystore, file, source, words):
    enclaves = keystore() / "enclaves"
    (enclaves / "talker" / file).unlink()
    if source:
        shutil.copy(enclaves / source / file, enclaves / "talker")
    said = pqsec("-k k who-may --json").done()
    assert said.json["participants"] == ["/listener"]
    assert words in said.json["left_out"]["/talker"]
    assert "note: /talker is left out: k/enclaves/talker" in said.err


def test_who_has_only_a_grant_that_a_stack_takes_for_its_own_is_asked_of_that_stack(
    pqsec, keystore
):
    """Cyclone DDS lets CN=/talker use what is granted to CN=/talker/arm."""
    enclaves = keystore() / "enclaves"
    pqsec("-k k issue /talker/arm --publish rt/arm").done()
    shutil.copy(enclaves / "talker/arm/permissions.p7s", enclaves / "talker")
    said = pqsec("-k k who-may --json").done()
    assert "no grant is for CN=/talker" in said.json["left_out"]["/talker"]
    taken = pqsec("-k k who-may --topic rt/arm --as cyclonedds --json").done().json
    assert (taken["left_out"], taken["topics"][0]["publish"]) == ({}, ["/talker", "/talker/arm"])


def test_a_domain_that_governance_does_not_name_is_noted(pqsec, keystore):
    keystore()
    said = pqsec("-k k who-may --domain 9 --json").done()
    assert "does not name domain 9: no participant can join it" in said.err
    assert said.json["topics"] == []
    for form in ("table", "md"):
        assert "rt/" not in pqsec(f"-k k who-may --domain 9 --format {form}").done().out


def test_a_folder_of_documents_is_asked_too(pqsec, tmp_path, keystore):
    (keystore() / "pqsec.json").unlink()
    (tmp_path / "k/enclaves/broken.xml").write_text("<dds/>")
    said = pqsec("who-may k/enclaves --json").done()
    assert said.json["participants"] == ["CN=/listener", "CN=/talker"]
    assert "the signatures of the documents were not checked" in said.err
    assert list(said.json["left_out"]) == ["k/enclaves/broken.xml"]
    pqsec("who-may k/enclaves/broken.xml").refused(1, "broken.xml")


@pytest.mark.parametrize(
    "line",
    ["-k k who-may", "-k k explain --participant /talker --join", "diff k k"],
)
def test_a_keystore_without_its_settings_gets_no_unverified_answer(pqsec, keystore, line):
    (keystore() / "pqsec.json").unlink()
    words = "k is not a pqsec keystore: it has no pqsec.json"
    pqsec(line).refused(3, words, hint="restore pqsec.json from a backup")


def test_a_folder_that_the_environment_names_gets_no_unverified_answer(pqsec, keystore):
    (keystore() / "pqsec.json").unlink()
    pqsec("who-may", PQSEC_KEYSTORE="k").refused(3, "not a pqsec keystore", hint="pqsec adopt k")
    pqsec("who-may", PQSEC_KEYSTORE="no").refused(3, "no does not exist", hint="ca init")


def test_what_cannot_be_read_in_a_folder_does_not_hold_who_may_up(pqsec, policy, tmp_path):
    os.mkfifo(tmp_path / "endless.xml")
    (tmp_path / "folder.yaml").mkdir()
    (tmp_path / "nowhere.xml").symlink_to("gone")
    said = pqsec("who-may . --json").done()
    assert said.json["participants"] == ["CN=/robot"]
    assert list(said.json["left_out"]) == ["nowhere.xml"]


def test_files_without_governance_are_taken_as_controlled(pqsec, policy):
    said = pqsec("who-may p.xml --topic chatter --json").done()
    assert "no governance document" in said.err
    assert said.json["topics"][0]["publish"] == ["CN=/robot"]
    with_it = pqsec("who-may p.xml --governance g.xml --topic chatter --json").done()
    assert (with_it.err, with_it.json) == ("", said.json)
    pqsec("who-may g.xml").refused(3, "no permissions document")


def test_two_governance_documents_are_one_too_many(pqsec, policy, put):
    put("g2", Governance.protected(DomainSet.of(0, 1)))
    pqsec("who-may p.xml g.xml g2.xml").refused(2, "more than one governance", hint="--governance")


def test_a_stack_may_be_asked_for_the_matrix(pqsec, put):
    put("g", Governance.protected(ZERO))
    put("p", permissions(rule("[^b]")))
    for stack, names in {"spec": ["CN=/robot"], "cyclonedds": []}.items():
        found = pqsec(f"who-may p.xml g.xml --topic a --as {stack} --json").done().json
        assert found["topics"][0]["publish"] == names


@pytest.fixture
def wide(put):
    """Patterns that cover é in C.UTF-8 alone: one that allows, one that denies."""
    put("g", Governance.protected(ZERO))
    denies = rule("door[!a]", allow=False)
    put("p", permissions(denies, rule("arm?", "door*"), rule("door*", action="subscribe")))


@pytest.mark.parametrize(
    ("asked", "code", "words"),
    [
        ("armé", 1, ("YES   Fast DDS 2.9.1 in C.UTF-8 decides differently",)),
        (
            "armé --as fastdds",
            1,
            ("by Fast DDS 2.9.1 in C\n", "YES   Fast DDS 2.9.1 in C.UTF-8"),
        ),
        ("armé --as fastdds/C", 1, ("by Fast DDS 2.9.1 in C\n",)),
        ("armé --as fastdds/C.UTF-8", 0, ("by Fast DDS 2.9.1 in C.UTF-8\n",)),
        ("armé --as spec/C.UTF-8", 0, ("by DDS-Security 1.1 in C.UTF-8\n",)),
        ("doorß", 0, ("YES   CN=/robot", "NO    DDS-Security 1.1 in C.UTF-8")),
        (
            "doorß --as fastdds",
            1,
            ("by Fast DDS 2.9.1 in C.UTF-8\n", "YES   Fast DDS 2.9.1 in C "),
        ),
        ("doorß --as fastdds/C.UTF-8", 1, ("by Fast DDS 2.9.1 in C.UTF-8\n",)),
        ("doorß --as cyclonedds", 0, ("by Cyclone DDS 0.10.2\n",)),
        ("armx --as fastdds", 0, ("by Fast DDS 2.9.1\n",)),
    ],
)
def test_explain_says_the_locale_where_the_answer_depends_on_it(pqsec, wide, asked, code, words):
    said = pqsec(f"{FILES} --publish {asked}")
    assert said.code == code
    assert all(each in said.out for each in words), said.out
    assert ("C.UTF-8" in said.out) is any("C.UTF-8" in each for each in words)
    found = pqsec(f"{FILES} --publish {asked} --json").json
    assert found["allowed"] is (code == 0)
    if "/" in asked:
        assert (found["as"], found["others"]) == (asked.split()[-1], [])


def test_who_may_says_the_locale_where_the_answer_depends_on_it(pqsec, wide):
    words = (
        "Fast DDS 2.9.1 in C.UTF-8 decides differently about armé: ask with --as fastdds/C.UTF-8"
    )
    said = pqsec("who-may g.xml p.xml --topic armé --as fastdds").done()
    assert words in said.err
    assert "nobody may use it" not in said.err
    assert said.out.splitlines()[1].split() == ["armé", "0", "-", "-"]
    found = pqsec("who-may g.xml p.xml --topic armé --as fastdds --json").done().json
    [other] = found["others"]
    assert (other["as"], other["differs"]) == ("fastdds/C.UTF-8", ["armé"])
    assert other["topics"][0]["publish"] == ["CN=/robot"]
    said = pqsec("who-may g.xml p.xml --topic armé --as fastdds/C.UTF-8").done()
    assert said.out.splitlines()[1].split() == ["armé", "0", "CN=/robot", "-"]
    assert "in C.UTF-8" in pqsec("who-may g.xml p.xml --topic armé").done().err
    for ask in ("--as fastdds", "--topic armx --as fastdds", "--topic armé --as cyclonedds"):
        assert "C.UTF-8" not in pqsec(f"who-may g.xml p.xml {ask}").done().err


def test_a_stack_whose_matching_follows_no_locale_has_none(pqsec, wide):
    for name in ("cyclonedds/C", "opendds/C.UTF-8", "fastdds/en_US.UTF-8", "fastdds/"):
        pqsec(f"who-may g.xml p.xml --as {name}").refused(2, "is not one of 'spec'")


def test_a_pattern_that_depends_on_the_locale_is_said_when_it_is_signed(
    pqsec, keystore, put, tmp_path
):
    keystore()
    words = "what {} matches in Fast DDS depends on the locale of the process (PQS244)"
    (tmp_path / "p.yaml").write_text(
        "grants: [{name: /talker, domains: 0, rules: [{allow: {publish: ['rt/a?', rt/b]}}]}]"
    )
    said = pqsec("-k k sign-permissions p.yaml -o p.p7s").done()
    assert said.err.count("PQS244") == 1
    assert words.format("rt/a?") in said.err
    said = pqsec("-k k issue /new --publish 'rt/[!a]' --subscribe 'rt/x*'").done()
    assert words.format("rt/[!a]") in said.err
    assert words.format("rt/d?") in pqsec("-k k permit /talker --publish 'rt/d?' --yes").done().err
    governance = Governance.protected(ZERO)
    [domain_rule] = governance.domain_rules
    [topic_rule] = domain_rule.topic_rules
    first = replace(topic_rule, topic_expression="rt/[é]")
    put(
        "g",
        replace(governance, domain_rules=(replace(domain_rule, topic_rules=(first, topic_rule)),)),
    )
    assert words.format("rt/[é]") in pqsec("-k k sign-governance g.xml -o g.p7s").done().err


@pytest.fixture
def partitioned(put):
    """A robot that may publish the map in partition A alone, and a station that hears it in all."""
    put("g", Governance.protected(ZERO))
    put("robot", permissions(rule("map", partitions=("A",)), rule("pose"), subject="CN=/robot"))
    hears = rule("map", partitions=("*",), action="subscribe")
    put("station", permissions(hears, subject="CN=/station"))
    put("alone", permissions(rule("door", partitions=("D",)), subject="CN=/alone"))


def test_a_right_that_is_only_in_partitions_was_shown_as_nobodys(pqsec, partitioned):
    said = pqsec("who-may g.xml alone.xml").done().out.splitlines()
    assert [line.split("  ") for line in map(str.strip, said)][1][0] == "door"
    assert said[0].split() == ["topic", "domain", "partition", "may", "publish", "may", "subscribe"]
    assert said[1].split() == ["door", "0", "D", "CN=/alone", "-"]
    assert len(said) == 2
    [row] = pqsec("who-may g.xml alone.xml --json").done().json["topics"]
    d = {"name": "D", "extent": "one", "such_as": None, "but": []}
    assert (row["publish"], row["partitions"]) == (["CN=/alone"], [d])


def test_every_form_of_who_may_has_the_partitions(pqsec, partitioned):
    ask = "who-may g.xml robot.xml station.xml"
    table = [line.split() for line in pqsec(ask).done().out.splitlines()]
    assert table[1:] == [
        ["map", "0", "(default)", "-", "CN=/station"],
        ["map", "0", "A", "CN=/robot", "CN=/station"],
        ["pose", "0", "(default)", "CN=/robot", "-"],
    ]
    assert pqsec(f"{ask} --format csv").done().out.splitlines() == [
        "topic,domains,pattern,asked,publish,subscribe,partitions",
        "map,0,false,map,,CN=/station,",
        "map,0,false,map,CN=/robot,CN=/station,A",
        "pose,0,false,pose,CN=/robot,,",
    ]
    assert "| map | 0 | A | CN=/robot | CN=/station |" in pqsec(f"{ask} --format md").done().out
    _, edges = graph(pqsec(f"{ask} --format dot").done().out)
    assert ("CN=/robot", "map (domain 0, partition A)") in edges
    flow = pqsec(f"{ask} --matrix").done().out.splitlines()
    assert flow[1].split() == ["CN=/robot", "CN=/station", "0", "A", "map"]
    [sent] = pqsec(f"{ask} --matrix --json").done().json["flows"]
    assert [each["name"] for each in sent["partitions"]] == ["A"]
    rows = pqsec(f"{ask} --matrix --format csv").done().out.splitlines()
    assert rows[1] == "CN=/robot,CN=/station,0,map,map,A"
    only = pqsec(f"{ask} --participant CN=/robot --json").done().json["topics"]
    assert [len(each["partitions"]) for each in only] == [1, 0]


@pytest.mark.parametrize(
    ("options", "publishers", "where"),
    [
        ("--partition A", ["CN=/robot"], "A"),
        ("--partition B", [], "B"),
        ("--partition A --partition B", [], "A and B"),
        ("--partition ''", [], "(default)"),
        ("--partition 'A*'", [], "A*"),
        ("--partition A --domain 0 --topic map", ["CN=/robot"], "A"),
    ],
)
def test_who_may_is_asked_about_an_endpoint_in_partitions(
    pqsec, partitioned, options, publishers, where
):
    ask = f"who-may g.xml robot.xml station.xml {options}"
    found = pqsec(f"{ask} --json").done().json
    first = found["topics"][0]
    assert (first["topic"], first["publish"]) == ("map", publishers)
    assert found["partitions"] == [each["name"] for each in first["partitions"]]
    assert where in pqsec(ask).done().out.splitlines()[1]
    for option in options.split()[1:2]:
        explained = pqsec(
            f"explain --governance g.xml --permissions robot.xml --publish map --partition {option}"
        )
        assert explained.code == (option != "A")


def test_a_partition_longer_than_any_of_dds_is_refused(pqsec, partitioned):
    pqsec(f"who-may g.xml robot.xml --partition {'x' * 300}").refused(2, "256 characters")


def graph(text):
    """(labels by node, edges) of a graph in the few forms of dot that are used."""
    first, *lines, last = text.splitlines()
    assert (first, last) == ("digraph who_may {", "}")
    found = [DOT_LINE.fullmatch(line) for line in lines]
    assert all(found), lines
    labels = {each["node"]: each["label"][1:-1] for each in found if each["node"]}
    edges = {(each["tail"], each["head"]) for each in found if each["tail"]}
    assert labels.keys() >= {node for edge in edges for node in edge}
    return labels, {(labels[one], labels[other]) for one, other in edges}


def test_the_graph_goes_from_publishers_to_subscribers(pqsec, keystore):
    keystore()
    pqsec("-k k issue /eye --publish rt/image --subscribe rt/chatter").done()
    _, edges = graph(pqsec("-k k who-may --format dot").done().out)
    assert ("/eye", "rt/image (domain 0)") in edges
    assert ("rt/image (domain 0)", "/eye") not in edges
    assert ("rt/chatter (domain 0)", "/eye") in edges
    assert len(edges) == 6


@pytest.fixture
def hostile(put):
    put("g", Governance.protected(ZERO))
    put("p", permissions(rule(*HOSTILE_TOPICS), subject=HOSTILE_SUBJECT))


def test_hostile_names_cannot_break_the_graph(pqsec, hostile):
    labels, edges = graph(pqsec("who-may p.xml g.xml --format dot").done().out)
    assert (len(labels), len(edges)) == (3, 2)
    for label in labels.values():
        assert re.search(r"&(?!amp;)", label) is None
        assert set(re.findall(r"\\(.)", label)) <= set('\\"')


def test_hostile_names_cannot_break_the_markdown_table(pqsec, hostile):
    asked = pqsec("who-may p.xml g.xml --format md --topic", HOSTILE_TOPICS[0]).done()
    *_, row = asked.out.splitlines()
    assert len(re.findall(r"(?<!\\)\|", row)) == 5
    assert re.search(r"(?<!\\)[<>`*\[&]", row) is None


def test_a_grant_for_no_possible_subject_is_left_out(pqsec, policy, put):
    put("q", permissions(rule("a"), subject="nobody at all"))
    found = pqsec("who-may p.xml q.xml g.xml --json").done().json
    assert found["participants"] == ["CN=/robot"]
    assert "not a subject name" in found["left_out"]["nobody at all"]


def test_a_subject_of_several_documents_is_asked_with_each(pqsec, policy, put):
    put("q", permissions(rule("other")))
    found = pqsec("who-may p.xml q.xml g.xml --json").done().json
    assert found["participants"] == ["CN=/robot (p.xml)", "CN=/robot (q.xml)"]
    publishers = {row["topic"]: row["publish"] for row in found["topics"]}
    assert publishers["other"] == ["CN=/robot (q.xml)"]


def test_the_table_is_short_where_names_are_many(pqsec, put):
    put("g", Governance.protected(ZERO))
    every = [grant(rule("all", f"own{n}"), subject=f"CN=/p{n}") for n in range(20)]
    some = [grant(rule("some"), subject=f"CN=/q{n}") for n in range(10)]
    put("p", Permissions(grants=tuple(every)))
    assert "all 20" in pqsec("who-may p.xml g.xml --topic all").done().out
    put("p", Permissions(grants=tuple(every + some)))
    assert "CN=/p5 and 14 more" in pqsec("who-may p.xml g.xml --topic all").done().out


# diff


@pytest.fixture
def broken(tmp_path, keystore):
    """A keystore `k`, and a document that breaks its schema."""
    keystore()
    (tmp_path / "broken.xml").write_text("<dds><permissions/></dds>")


@pytest.mark.parametrize(
    ("rules", "code", "words"),
    [
        ([rule("chatter", "rt/*")], 0, "no change of rights"),
        ([rule("rt/*"), rule("chatter")], 0, "the documents differ in form or order only"),
        ([rule("chatter", "rt/*", "new")], 1, "granted:\n  CN=/robot: publish 'new' on domain 0"),
        ([rule("rt/*")], 1, "taken away:\n  CN=/robot: publish 'chatter' on domain 0"),
    ],
)
def test_permissions_are_compared_by_meaning(pqsec, put, rules, code, words):
    put("p", permissions(rule("chatter", "rt/*")))
    for name in ("new", "new.yaml"):
        path = put(name, permissions(*rules))
        said = pqsec("diff p.xml", path.name)
        assert (said.code, said.err) == (code, "")
        assert words in said.out
        found = pqsec("diff p.xml --json", path.name).json
        assert (found["same"], found["complete"]) == (code == 0, True)


def test_a_change_of_order_that_only_stacks_see_is_told(pqsec, put):
    rules = [rule("a", allow=False, partitions=("P",)), rule("a")]
    put("p", permissions(*rules))
    put("q", permissions(*rules[::-1]))
    said = pqsec("diff p.xml q.xml")
    assert said.code == 1
    assert said.out.startswith("no change by the standard, but in stacks")
    versions = "Cyclone DDS 0.10.2 and Cyclone DDS 11.0.1"
    assert f"in {versions}, unlike the standard, for one: publish 'a'" in said.out
    found = pqsec("diff p.xml q.xml --json").json
    assert {change["as"] for change in found["changes"]} == {"cyclonedds", "fastdds"}


def test_a_signed_document_is_compared_with_its_xml(pqsec, keystore):
    keystore()
    said = pqsec("diff k/enclaves/governance.xml k/enclaves/governance.p7s").done()
    assert said.out == "no change of rights or protection\n"


def test_governance_is_compared_by_strength(pqsec):
    for preset in ("strict", "open-discovery"):
        pqsec(f"governance new --preset {preset} -o {preset}.yaml").done()
    there = pqsec("diff strict.yaml open-discovery.yaml --json")
    back = pqsec("diff open-discovery.yaml strict.yaml --json")
    assert (there.code, back.code) == (1, 1)
    senses = [[each["sense"] for each in said.json["changes"]] for said in (there, back)]
    assert len(senses[0]) == len(senses[1])
    assert senses[0].count("weaker") == senses[1].count("stronger") > 0


@pytest.mark.parametrize("form", ["old", "old.yaml"])
def test_a_document_may_come_through_a_pipe(process, put, form, tmp_path):
    """As in `pqsec diff <(git show HEAD:policy.yaml) policy.yaml`."""
    put("new", permissions(rule("a", "b")))
    os.mkfifo(tmp_path / "pipe")
    data = put(form, permissions(rule("a"))).read_bytes()
    writer = Thread(target=(tmp_path / "pipe").write_bytes, args=(data,), daemon=True)
    writer.start()
    said = process("diff pipe new.xml")
    assert (said.code, said.err) == (1, "")
    assert "publish 'b'" in said.out


def test_keystores_are_compared_participant_by_participant(pqsec, keystore):
    keystore()
    keystore(name="new")
    assert pqsec("diff k new").done().out.startswith("no change")
    pqsec("-k new issue /eye --publish rt/image").done()
    said = pqsec("diff k new --json")
    assert said.code == 1
    assert {(each["document"], each["sense"]) for each in said.json["changes"]} == {
        ("permissions of /eye", "granted")
    }
    assert {each["sense"] for each in pqsec("diff new k --json").json["changes"]} == {"taken away"}


def test_governance_of_one_participant_alone_is_not_hidden(pqsec, keystore, tmp_path):
    keystore()
    shutil.copytree(tmp_path / "k", tmp_path / "new", symlinks=True)
    own = tmp_path / "new/enclaves/talker/governance.p7s"
    own.unlink()
    shutil.copyfile(tmp_path / "k/enclaves/governance.p7s", own)
    assert "no change" in pqsec("diff k new").done().out  # a copy is what all share, too
    pqsec("governance new --preset open-discovery -o weak.yaml").done()
    pqsec("-k new sign-governance weak.yaml --force -o", own).done()
    said = pqsec("diff k new")
    assert (said.code, said.out.splitlines()[0]) == (1, "weaker:")
    assert "  /talker: domain 0: discovery: in the clear" in said.out
    assert "/listener" not in said.out
    changes = pqsec("diff k new --json").json["changes"]
    assert {each["document"] for each in changes} == {"governance of /talker"}
    left = pqsec("-k new who-may --json").done().json["left_out"]
    assert left == {"/talker": "its governance differs from the governance of the others"}


@pytest.mark.parametrize(
    ("line", "code", "words"),
    [
        ("diff p.xml g.xml", 2, "a governance document"),
        ("diff p.xml k", 2, "is a folder, and the other a file"),
        ("diff p.xml nothing.xml", 3, "nothing.xml"),
        ("diff p.xml broken.xml", 1, "broken.xml"),
        ("diff p.xml", 2, "NEW"),
    ],
)
@pytest.mark.usefixtures("policy", "broken")
def test_what_cannot_be_compared_is_refused(pqsec, line, code, words):
    pqsec(line).refused(code, words)


# Domains that nobody named, and names that are not known


def test_explain_answers_for_all_domains_that_the_documents_name(pqsec, apart):
    ask = "-k k explain --participant /two --subscribe rt/cmd_vel"
    said = pqsec(ask).done()
    titles = [line for line in said.out.splitlines() if ": subscribe rt/cmd_vel, " in line]
    assert titles == [
        "YES   /two: subscribe rt/cmd_vel, domains 1-2, by DDS-Security 1.1",
        "NO    /two: subscribe rt/cmd_vel, domains 0,3, by DDS-Security 1.1",
    ]
    found = pqsec(f"{ask} --json").done().json
    assert (found["allowed"], found["domain"], found["domains"]) == (True, 1, "1-2")
    [other] = found["elsewhere"]
    assert (other["allowed"], other["domain"], other["domains"]) == (False, 0, "0,3")
    named = pqsec(f"{ask} --domain 0 --json").json
    assert (named["allowed"], named["domains"], named["elsewhere"]) == (False, "0", [])


def test_explain_tells_what_differs_from_one_domain_to_another(pqsec, put):
    [zero] = Governance.protected(ZERO).domain_rules
    [one] = Governance.protected(DomainSet.of(1)).domain_rules
    open_ = replace(one, allow_unauthenticated_participants=True)
    put("g", Governance(domain_rules=(zero, open_)))
    put("p", permissions(rule("a", domains=DomainSet.of(0, 1))))
    found = pqsec(f"{FILES} --publish a --json").done().json
    both = [found, *found["elsewhere"]]
    assert [each["domains"] for each in both] == ["0", "1"]
    assert both[0]["protection"] != both[1]["protection"]


@pytest.mark.parametrize(
    ("line", "instead"),
    [
        ("explain --participant /talkr --join", "did you mean '/talker'?"),
        ("verify-handshake /talker /listner", "did you mean '/listener'?"),
        ("export cyclonedds /taker", "did you mean '/talker'?"),
        ("renew /listner", "did you mean '/listener'?"),
        ("explain --participant /zzz --join", "`pqsec ca show` lists the participants"),
    ],
)
def test_a_participant_that_is_not_there_may_be_another(pqsec, keystore, line, instead):
    keystore()
    pqsec(f"-k k {line}").refused(3, "no participant", hint=instead)


@pytest.mark.parametrize(
    ("line", "instead"),
    [
        ("statsu", "'status'?"),
        ("who_may", "'who-may'?"),
        ("verify-handshak", "'verify-handshake'"),
        ("ca shwo", "'show'?"),
        ("zzz", ""),
    ],
)
def test_an_unknown_command_may_be_another(pqsec, line, instead):
    said = pqsec(line)
    said.refused(2, "No such command", instead)
    assert ("Did you mean" in said.err) is bool(instead)


def test_how_to_complete_commands_is_told(pqsec):
    pqsec("completion").refused(2, "No such command", "_PQSEC_COMPLETE=bash_source pqsec")


@pytest.mark.parametrize(
    ("topic", "words"),
    [
        ("rt/chater", "no rule of /talker names rt/chater; did you mean 'rt/chatter'?"),
        ("/chatter", "/chatter is the ROS 2 name of rt/chatter: ask with --ros-publish /chatter"),
        ("/some/other", "ask with --ros-publish /some/other"),
        ("/not a name", ""),
        ("other", ""),
    ],
)
def test_explain_tells_of_a_topic_that_looks_like_a_slip(pqsec, keystore, topic, words):
    keystore()
    said = pqsec("-k k explain --participant /talker --publish", topic)
    assert said.code == 1
    assert words in said.err
    assert bool(said.err) is bool(words)


def test_a_ros_name_that_is_asked_as_a_dds_topic_is_told_the_option(pqsec, keystore):
    keystore()
    asked = "-k k explain --participant /talker"
    assert "--ros-subscribe /odom" in pqsec(f"{asked} --subscribe /odom").err
    assert pqsec(f"{asked} --relay /odom").err == ""  # of ROS names none can be relayed


def test_an_expired_participant_is_told_how_to_renew(pqsec, tmp_path):
    then, domains = datetime.now(UTC) - timedelta(days=90), DomainSet.of(0)
    k = Keystore.create(
        tmp_path / "k",
        profile_named("classical"),
        name="",
        domains=domains,
        validity=timedelta(days=900),
        passphrase=None,
        now=then,
    )
    spec = ParticipantSpec(
        name="/late", domains=domains, publish=("x",), validity=timedelta(days=30)
    )
    issue(k, k.unlock(None), [spec], now=then)
    said = pqsec("-k k explain --participant /late --publish x")
    said.refused(1, "CN=/late expired on", hint="`pqsec renew /late` issues it again")


def test_a_misspelled_topic_is_noted_beside_a_participant_without_rights(pqsec, keystore):
    keystore("classical")
    pqsec("-k k issue /camera --publish rt/chatter").done()
    pqsec("-k k issue /idle").done()
    done = pqsec("-k k who-may --topic rt/chater").done()
    assert "no rule names rt/chater, so nobody may use it; did you mean 'rt/chatter'" in done.err


# ROS 2 words, and what each participant can send to which others


@pytest.fixture
def fleet_of_nodes(pqsec):
    pqsec("-k k ca init --no-passphrase --profile classical").done()
    pqsec("-k k issue /bot/server --ros-node /bot/server --ros-service /reset").done()
    pqsec("-k k issue /bot/cook --ros-action-server /cook --ros-publish /odom").done()
    pqsec("-k k issue /desk --ros-client /reset --ros-action-client /cook").done()
    pqsec("-k k permit /desk --ros-subscribe /odom --yes").done()
    return "-k k who-may"


def test_services_actions_and_nodes_are_asked_by_their_names(pqsec, fleet_of_nodes):
    def users(options):
        rows = pqsec(f"{fleet_of_nodes} {options} --json").done().json["topics"]
        return {each["topic"]: (each["publish"], each["subscribe"]) for each in rows}

    service = {
        "rq/resetRequest": (["/desk"], ["/bot/server"]),
        "rr/resetReply": (["/bot/server"], ["/desk"]),
    }
    assert users("--ros-service /reset") == service
    assert users("--ros-service '/res*'") == service
    action = users("--ros-action /cook")
    assert set(action) == set(ros.action_topics("/cook"))
    assert action["rt/cook/_action/feedback"] == (["/bot/cook"], ["/desk"])
    assert set(users("--ros-action '/c*'")) == set(action)
    parameters = users("--ros-parameters /bot/server")
    assert parameters["rq/bot/server/set_parametersRequest"] == ([], ["/bot/server"])
    assert len(parameters) == 12
    pqsec(f"{fleet_of_nodes} --ros-service reset").refused(2, "not a full ROS 2 name")


def test_the_matrix_shows_who_can_send_what_to_whom(pqsec, fleet_of_nodes):
    found = pqsec(f"{fleet_of_nodes} --matrix --json").done().json["flows"]
    told = {(each["from"], *each["to"]): each for each in found}
    assert set(told) == {
        ("/bot/cook", "/desk"),
        ("/bot/server", "/desk"),
        ("/desk", "/bot/cook"),
        ("/desk", "/bot/server"),
    }
    assert told["/desk", "/bot/server"]["ros"] == ["request of /reset"]
    assert "/odom" in told["/bot/cook", "/desk"]["ros"]
    lines = pqsec(f"{fleet_of_nodes} --matrix --topic rt/odom").done().out.splitlines()
    assert [line.split() for line in lines[1:]] == [["/bot/cook", "/desk", "0", "/odom"]]
    pqsec(f"{fleet_of_nodes} --matrix --format dot").refused(2, "--matrix")
    rows = pqsec(f"{fleet_of_nodes} --matrix --topic rt/odom --format csv").done().out.splitlines()
    assert rows == [
        "from,to,domains,topics,ros,partitions",
        "/bot/cook,/desk,0,rt/odom,/odom,",
    ]
    rows = pqsec(f"{fleet_of_nodes} --topic rt/odom --format csv").done().out.splitlines()
    assert rows == [
        "topic,domains,pattern,asked,publish,subscribe,partitions",
        "rt/odom,0,false,rt/odom,/bot/cook,/desk,",
    ]
    pqsec(f"{fleet_of_nodes} --json --format csv").refused(2, "exclude each other")


def test_participants_are_chosen_by_name_or_pattern(pqsec, fleet_of_nodes):
    rows = pqsec(f"{fleet_of_nodes} --participant '/bot/*' --topic 'rt/*' --json").json["topics"]
    assert all(
        {*each["publish"], *each["subscribe"]} & {"/bot/server", "/bot/cook"} for each in rows
    )
    flows = pqsec(f"{fleet_of_nodes} --matrix --participant /bot/server --json").json["flows"]
    assert {each["from"] for each in flows} == {"/bot/server", "/desk"}
    pqsec(f"{fleet_of_nodes} --participant /dusk").refused(2, "/dusk", hint="/desk")
    pqsec(f"{fleet_of_nodes} --participant '/none/*'").refused(3, "no participant matches")


def test_a_topic_that_is_too_long_for_rtps_is_named(pqsec):
    pqsec("-k k ca init --no-passphrase --profile classical").done()
    long = f"rt/{'x' * 254}"
    pqsec(f"-k k issue /a --publish {long} --publish rt/y").done()
    done = pqsec("-k k who-may --json").done()
    assert "RTPS allows a topic 256 characters: no answer for rt/xxxx" in done.err
    assert {each["topic"]: each["publish"] for each in done.json["topics"]} == {
        long: [],
        "rt/y": ["/a"],
    }
    asked = pqsec(f"-k k explain /a --publish {long}")
    asked.refused(2, "longer than 256 characters", hint="RTPS allows no longer topic")
    assert "a name is longer" not in pqsec("-k k report -o report.html").done().err


# What is neither yes nor no


@pytest.fixture
def crashing(tmp_path):
    """put(case) writes g.xml and p.xml, one of which crashes stacks, and returns its case."""

    def put(case):
        found = CRASHING[case]
        documents = {Governance: GOVERNANCE, Permissions: PERMISSIONS} | {found.kind: found.xml}
        (tmp_path / "g.xml").write_bytes(documents[Governance])
        (tmp_path / "p.xml").write_bytes(documents[Permissions])
        return found

    return put


@pytest.mark.parametrize("case", ["a range without min", "an empty topic", "an empty expression"])
def test_what_crashes_a_stack_is_neither_yes_nor_no(pqsec, keystore, crashing, case):
    found = crashing(case)
    keystore()
    file, kind = ("g.xml", "governance") if found.kind is Governance else ("p.xml", "permissions")
    pqsec(f"-k k sign-{kind} {file} -o new.p7s").refused(1, f"{file}: line {found.line}", "crashes")
    for stack in ("cyclonedds", "cyclonedds@11.0"):
        said = pqsec(f"{FILES} --publish rt/chatter --as {stack}")
        assert said.code == 1
        assert said.out.startswith("CRASHES  CN=/lab/alice")
        assert re.search(rf"{file}:(\d+ \(its topics from line )?{found.line}\b", said.out)
    json = pqsec(f"{FILES} --publish rt/chatter --as cyclonedds --json").json
    assert (json["allowed"], json["answer"]) == (None, "crashes")
    assert (json["own_stack"], json["peers"], json["until"]) == (None, None, None)
    assert [each["answer"] for each in json["others"]] == ["crashes"]
    who = pqsec("who-may g.xml p.xml --as cyclonedds --json").done()
    assert file in who.json["unanswered"]["CN=/lab/alice"]
    assert "no answer by Cyclone DDS 0.10.2 for CN=/lab/alice" in who.err
    assert who.json["crashes"] == {}
    by_standard = pqsec("who-may g.xml p.xml --json").done()
    assert by_standard.json["unanswered"] == {}
    [(whose, words)] = by_standard.json["crashes"].items()
    assert whose == ("governance" if found.kind is Governance else "CN=/lab/alice")
    assert words.startswith(f"line {found.line}: ")
    assert "crashes Cyclone DDS 0.10.2" in words
    assert f"note: {whose}: {words}" in by_standard.err


def test_a_right_of_several_topics_is_not_known_if_one_is_not(pqsec, crashing):
    crashing("an empty topic")
    json = pqsec(f"{FILES} --ros-service /reset --as cyclonedds --json")
    assert (json.code, json.json["allowed"], json.json["answer"]) == (1, None, "crashes")
    said = pqsec(f"{FILES} --ros-service /reset --as cyclonedds").out
    assert said.startswith("CRASHES")


@pytest.mark.parametrize("spoiled", ["permissions", "governance"])
def test_readers_differ_is_the_answer_about_a_keystore_with_markup_in_a_value(
    pqsec, keystore, tmp_path, spoiled
):
    """As other tools sign it; pqsec neither signs nor installs it."""
    keystore(profile="classical")
    ca = load_private_key((tmp_path / "k/private/permissions_ca.key.pem").read_bytes())
    certificate = load_certificate(tmp_path / "k/public/permissions_ca.cert.pem")
    enclaves = tmp_path / "k/enclaves"
    name, old = (
        ("talker/permissions", b">rt/chatter<")
        if spoiled == "permissions"
        else ("governance", b">*<")
    )
    xml = (enclaves / f"{name}.xml").read_bytes()
    marked = xml.replace(old, old[:-1] + b"<!-- x -->_x<", 1)
    (enclaves / f"{name}.p7s").write_bytes(sign(marked, Signer(certificate, ca), now=NOW))
    for stack in ("", " --as fastdds", " --as cyclonedds"):
        said = pqsec(f"-k k explain /talker --publish rt/chatter{stack}")
        assert (said.code, said.out.splitlines()[0][:23]) == (1, "READERS DIFFER  /talker")
        assert re.search(rf"/{name}.p7s:\d+\n", said.out)
    json = pqsec("-k k explain /talker --publish rt/chatter --json").json
    assert (json["allowed"], json["answer"]) == (None, "readers differ")
    text = (enclaves / f"{name}.p7s").read_bytes()
    assert json["line"] == text[: text.index(b"<!-- x")].count(b"\n") + 1


def test_readers_differ_is_said_of_files_with_their_line(pqsec, crashing, tmp_path):
    crashing("a range without min")
    marked = PERMISSIONS.replace(b">rt/p<", b">rt/p<!-- x --><")
    (tmp_path / "p.xml").write_bytes(marked)
    said = pqsec(f"{FILES} --publish rt/chatter")
    assert (said.code, said.out[:14]) == (1, "READERS DIFFER")
    assert "p.xml:7" in said.out
    assert "\nsame  " not in said.out  # readers that differ are not the same
    assert "p.xml:7" in pqsec("who-may g.xml p.xml --json").json["unanswered"]["CN=/lab/alice"]
    (tmp_path / "old.xml").write_bytes(PERMISSIONS)
    pqsec("diff old.xml p.xml").refused(1, "p.xml: line 7", "readers differ")
    pqsec("diff p.xml old.xml").refused(1, "p.xml: line 7", "readers differ")


def test_a_handshake_fails_where_the_permissions_crash_a_stack(pqsec, keystore, tmp_path):
    keystore(profile="classical")
    ca = load_private_key((tmp_path / "k/private/permissions_ca.key.pem").read_bytes())
    certificate = load_certificate(tmp_path / "k/public/permissions_ca.cert.pem")
    talker = tmp_path / "k/enclaves/talker"
    xml = (talker / "permissions.xml").read_bytes()
    crashing = xml.replace(b"<id>0</id>", b"<id_range><max>3</max></id_range>")
    assert crashing != xml
    (talker / "permissions.p7s").write_bytes(sign(crashing, Signer(certificate, ca), now=NOW))
    pqsec("-k k verify-handshake /talker /listener --as fastdds --as fastdds").done()
    for stacks in ("cyclonedds --as pqsec", "pqsec --as cyclonedds"):  # its own, and its peer's
        failed = pqsec(f"-k k verify-handshake /talker /listener --as {stacks}")
        assert failed.code == 1
        assert "crashes Cyclone DDS" in failed.out
