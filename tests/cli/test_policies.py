"""pqsec governance and pqsec permissions: from YAML to the XML that stacks read, and back."""

import json
import re
from datetime import timedelta
from pathlib import Path

import pytest
import yaml

from pqsec_pki.documents import PRESETS, Governance, Permissions, governance_from_yaml, ros
from tests.json_schemas import validator

EXAMPLES = Path(__file__).parents[2] / "examples"
OF_OTHERS = {"pqsec-alerts.yaml"}
"""YAML in the examples that other programs read."""
CORPUS = Path(__file__).parents[1] / "vectors/corpus/sros2"
SAMPLE = CORPUS / "test/policies/sample.policy.xml"
PRESET_NAMES = [preset.name for preset in PRESETS]
NEW = {"governance": "governance new", "permissions": "permissions new /talker /listener"}
KINDS = {"governance": Governance, "permissions": Permissions}
every_kind = pytest.mark.parametrize("kind", KINDS)


@every_kind
def test_new_render_read_and_render_again(pqsec, tmp_path, kind):
    pqsec(f"{NEW[kind]} --domain 0-3 -o new.yaml").done()
    pqsec(f"{kind} render new.yaml -o one.xml").done()
    pqsec(f"{kind} read one.xml -o read.yaml").done()
    pqsec(f"{kind} render read.yaml -o two.xml").done()
    one, two = ((tmp_path / name).read_bytes() for name in ("one.xml", "two.xml"))
    assert one == two
    assert b"<min>0</min>" in one
    assert pqsec("validate one.xml --json").done().json["files"][0]["kind"] == kind


def test_new_permissions_without_ros(pqsec, tmp_path):
    names = ["robot-1", "a: b", "no", "'é'"]
    (tmp_path / "new.yaml").write_text(pqsec("permissions new --dds", *names).done().out)
    value = Permissions.from_xml(pqsec("permissions render new.yaml").done().out.encode())
    assert [grant.name for grant in value.grants] == names
    assert {rule.allow for grant in value.grants for rule in grant.rules} == {True}
    assert not any(rule.publish or rule.subscribe for g in value.grants for rule in g.rules)
    pqsec("permissions new robot-1").refused(2, "not a full ROS 2 name", hint="use --dds")


@every_kind
def test_without_output_the_document_is_printed(pqsec, tmp_path, kind):
    printed = pqsec(NEW[kind]).done().out
    (tmp_path / "new.yaml").write_text(printed)
    pqsec(f"{NEW[kind]} -o other.yaml").done()
    assert (tmp_path / "other.yaml").read_text() == printed
    rendered = pqsec(f"{kind} render new.yaml").done().out
    assert KINDS[kind].from_xml(rendered.encode())
    again = pqsec(f"{kind} render new.yaml --json").done().json["document"]
    assert without_times(again) == without_times(rendered)  # a new policy begins when it is read


def without_times(document):
    return re.sub(r"(?<=<not_)(before|after)>[^<]*", r"\1>", document)


@pytest.mark.parametrize("preset", PRESET_NAMES)
def test_a_preset_is_written_and_commented(pqsec, preset):
    text = pqsec(f"governance new --preset {preset} --domain 1,5-9").done().out
    [row] = [each for each in PRESETS if each.name == preset]
    value = governance_from_yaml(text.encode())
    assert value == row.governance(value.domain_rules[0].domains)
    assert row.summary in text
    assert text.count("# ") > 15


def test_the_presets_are_explained(pqsec):
    rows = pqsec("governance presets --json").done().json["presets"]
    assert [row["name"] for row in rows] == PRESET_NAMES
    text = " ".join(pqsec("governance presets").done().out.split())
    for row in rows:
        assert (
            f"{row['name']}: {row['summary']} Protects: {row['protects']} Costs: {row['costs']}"
            in text
        )


@every_kind
def test_a_signed_document_is_read(pqsec, keystore, kind):
    k = keystore()
    where = {"governance": "enclaves/governance", "permissions": "enclaves/talker/permissions"}[
        kind
    ]
    signed = pqsec(f"{kind} read", k / f"{where}.p7s").done().out
    assert signed == pqsec(f"{kind} read", k / f"{where}.xml").done().out


def test_yaml_goes_from_new_to_a_signed_handshake(pqsec, keystore):
    keystore()
    pqsec("governance new --preset authenticated --domain 0-5 -o g.yaml").done()
    pqsec("governance render g.yaml -o k/enclaves/governance.xml --force").done()
    pqsec("-k k sign-governance k/enclaves/governance.xml --force").done()
    for name in ("talker", "listener"):
        pqsec(f"permissions new /{name} --domain 5 -o {name}.yaml").done()
        pqsec(f"permissions render {name}.yaml -o k/enclaves/{name}/permissions.xml --force").done()
        pqsec(f"-k k sign-permissions k/enclaves/{name}/permissions.xml --force").done()
    pqsec("-k k verify-handshake /talker /listener --domain 5").done()


@every_kind
def test_yaml_is_signed_as_the_xml_it_means(pqsec, keystore, kind):
    keystore()
    pqsec(f"{NEW[kind]} -o new.yaml").done()
    pqsec(f"-k k sign-{kind} new.yaml").done()
    assert pqsec("validate new.p7s --json").done().json["files"][0]["kind"] == kind
    read, rendered = pqsec(f"{kind} read new.p7s").done().out, pqsec(f"{kind} render new.yaml")
    assert KINDS[kind].from_xml(rendered.done().out.encode())
    assert yaml.safe_load(read)


# What is refused


@every_kind
def test_every_mistake_is_told_and_nothing_is_written(pqsec, tmp_path, kind):
    rest = {"governance": "preset: x\ntopics: 5", "permissions": "validity: x\ngrants: 5"}[kind]
    (tmp_path / "bad.yaml").write_text(f"domain: 0\n{rest}\n")
    said = pqsec(f"{kind} render bad.yaml -o out.xml")
    said.refused(1, "bad.yaml: line 1: domain: no such key here; did you mean domains?", problems=3)
    assert not (tmp_path / "out.xml").exists()


@every_kind
def test_signing_a_mistake_is_refused_in_the_same_words(pqsec, keystore, tmp_path, kind):
    keystore()
    (tmp_path / "bad.yaml").write_text("domain: 0\n")
    pqsec(f"-k k sign-{kind} bad.yaml").refused(
        1, "line 1: domain: no such key here", problems={"governance": 1, "permissions": 2}[kind]
    )
    assert not (tmp_path / "bad.p7s").exists()


@pytest.mark.parametrize(
    ("kind", "command"),
    [
        ("domain", "plan --init new.yaml"),
        ("governance", "governance new -o new.yaml"),
        ("permissions", "permissions new /talker -o new.yaml"),
    ],
)
def test_a_new_file_names_its_schema_for_editors(pqsec, tmp_path, kind, command):
    pqsec(command).done()
    text = (tmp_path / "new.yaml").read_text()
    header, told = text.splitlines()[:2]
    named = header.removeprefix("# yaml-language-server: $schema=")
    pqsec(re.search("`pqsec (.*)`", told)[1]).done()
    schema = json.loads((tmp_path / named).read_text())
    assert schema["$id"] == f"urn:pqsec:schema:{kind}"
    assert not list(validator(schema).iter_errors(yaml.safe_load(text)))


@pytest.mark.parametrize("path", sorted(EXAMPLES.rglob("*.yaml")), ids=str)
def test_the_yaml_files_of_the_examples_keep_to_the_schemas_that_they_name(path):
    header = path.read_text().splitlines()[0]
    if "$schema=" not in header:
        assert path.name in OF_OTHERS
        return
    schema = json.loads((path.parent / header.split("$schema=")[1]).read_text())
    assert not list(validator(schema).iter_errors(yaml.safe_load(path.read_text())))


# SROS2


def test_a_policy_of_sros2_becomes_yaml_and_permissions(pqsec, tmp_path):
    pqsec("permissions import --domain 0,7 --validity 90d -o p.yaml", SAMPLE).done()
    xml = pqsec("permissions render p.yaml").done().out
    value = Permissions.from_xml(xml.encode())
    expected = (CORPUS / "test/policies/permissions/sample/permissions.xml").read_bytes()
    theirs = Permissions.from_xml(expected)
    assert [grant.name for grant in value.grants] == [grant.name for grant in theirs.grants]
    for ours, other in zip(value.grants, theirs.grants, strict=True):
        assert ours.rules[0].publish == other.rules[0].publish
        assert ours.rules[0].subscribe == other.rules[0].subscribe
        assert str(ours.rules[0].domains) == "0,7"


def test_what_jazzy_nodes_lack_is_noted_until_it_is_added(pqsec):
    line = "permissions import --enclave /talker_listener/talker"
    said = pqsec(line, SAMPLE)
    assert said.code == 0
    assert "lacks rr/talker/get_type_descriptionReply and 1 more topic" in said.err
    said = pqsec(f"{line} --complete", SAMPLE)
    assert said.err == ""
    [grant] = yaml.safe_load(said.out)["grants"]
    assert set(ros.node_minimum("/talker").publish) <= set(grant["publish"])


def test_one_enclave_is_imported_by_name(pqsec):
    said = pqsec("permissions import --enclave /talker_listener/talker --complete", SAMPLE).done()
    assert [grant["name"] for grant in yaml.safe_load(said.out)["grants"]] == [
        "/talker_listener/talker"
    ]
    pqsec("permissions import --enclave /none", SAMPLE).refused(
        2, "no enclave /none", hint="it has /talker_listener/talker, "
    )


def test_an_include_out_of_the_folder_is_refused(pqsec, tmp_path):
    (tmp_path / "d").mkdir()
    (tmp_path / "d/p.xml").write_text(SAMPLE.read_text().replace("talker_listener.policy", "../x"))
    (tmp_path / "x.xml").write_text("<policy/>")
    pqsec("permissions import d/p.xml").refused(
        1, "d/p.xml: line 6: <xi:include>: ", "outside the policy's folder"
    )


# Issuing

POLICY = """
validity: 1w
domains: 0
grants:
  - {name: /a, nodes: /a, publish: [rt/x]}
  - {name: /b, rules: [{deny: {publish: rt/y}}, {allow: {domains: [0, 5], publish: "*"}}]}
"""


def grants_of(folder, name):
    return Permissions.from_xml((folder / f"k/enclaves/{name}/permissions.xml").read_bytes()).grants


def test_participants_are_issued_with_the_grants_of_a_policy(pqsec, keystore, tmp_path):
    keystore()
    (tmp_path / "p.yaml").write_text(POLICY)
    said = pqsec("-k k issue /a /b --policy p.yaml --validity 90d").done()
    assert "the governance does not name domain 5" in said.err
    [a], [b] = (grants_of(tmp_path, name) for name in "ab")
    assert (a.name, a.subject_name) == ("/a", "CN=/a")
    assert a.rules[0].publish[0].topics == ("rt/x", *ros.node_minimum("/a").publish)
    assert [rule.allow for rule in b.rules] == [False, True]
    assert round((a.not_after - a.not_before) / timedelta(days=1)) == 8  # of two seconds
    pqsec("-k k verify-handshake /a /b --domain 0").done()


def test_a_grant_ends_with_its_certificate(pqsec, keystore, tmp_path):
    keystore()
    (tmp_path / "p.yaml").write_text(POLICY)
    pqsec("-k k issue /a --policy p.yaml --validity 12h").done()
    [grant] = grants_of(tmp_path, "a")
    assert (grant.not_after - grant.not_before).total_seconds() == 36 * 3600


def test_participants_are_issued_from_a_policy_of_sros2(pqsec, keystore, tmp_path):
    keystore()
    done = pqsec("-k k issue /talker_listener/talker --domain 3 --policy", SAMPLE).done()
    assert "/talker_listener/talker: also allowed what ROS 2 nodes need to start" in done.err
    assert "rr/talker/get_type_descriptionReply and 1 more" in done.err
    [grant] = grants_of(tmp_path, "talker_listener/talker")
    assert str(grant.rules[0].domains) == "3"
    assert "rt/chatter" in grant.rules[0].publish[0].topics
    [rule] = grant.rules
    assert set(ros.node_minimum("/talker").publish) <= set(rule.publish[0].topics)
    assert set(ros.node_minimum("/talker").subscribe) <= set(rule.subscribe[0].topics)


def test_without_names_all_of_a_policy_are_issued(pqsec, keystore, tmp_path):
    k = keystore()
    (tmp_path / "p.yaml").write_text(POLICY)
    named = [each["name"] for each in pqsec("-k k issue --policy p.yaml --json").json["issued"]]
    assert named == ["/a", "/b"]
    pqsec("-k k issue --policy p.yaml").refused(3, "already issued: /a, /b")
    pqsec("-k k issue --policy", SAMPLE).done()
    assert sorted(path.name for path in (k / "enclaves/talker_listener").iterdir()) == [
        "listener",
        "talker",
    ]


ROOT = """<policy version="0.2.0"><enclaves>
<enclave path="/"><profiles>
<profile ns="/" node="talker"><topics publish="ALLOW"><topic>chatter</topic></topics></profile>
</profiles></enclave>{more}
</enclaves></policy>"""
MORE = """
<enclave path="/rover"><profiles>
<profile ns="/" node="rover"><topics publish="ALLOW"><topic>odom</topic></topics></profile>
</profiles></enclave>"""


@pytest.mark.parametrize("name", ["", "/talker"])
def test_nodes_that_ran_without_enclave_are_nobodys(pqsec, keystore, tmp_path, name):
    k = keystore()
    (tmp_path / "p.xml").write_text(ROOT.format(more=""))
    pqsec(f"-k k issue {name} --policy p.xml").refused(2, "p.xml has", hint="--enclave /NAME")
    (tmp_path / "p.xml").write_text(ROOT.format(more=MORE))
    assert "--enclave /NAME" in pqsec("-k k issue --policy p.xml").done().err
    found = {path.name for path in (k / "enclaves").iterdir() if path.is_dir()}
    assert found == {"listener", "rover", "talker"}
