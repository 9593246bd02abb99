"""A finding holds for stacks and versions: it is an error for those alone, and names them.

RTI Connext was not run. The documents here have the features of RTI's public examples: elements
that the User's Manual and the Migration Guide of RTI describe.
"""

from datetime import UTC, datetime
from xml.sax.saxutils import quoteattr

import pytest

from pqsec_pki.documents import DomainSet, Governance
from pqsec_pki.lint import RULES, Severity, check, to_code_quality, to_sarif
from pqsec_pki.lint.documents._extensions import ROWS
from pqsec_pki.stacks import Stack
from tests.unit.linting import Lab

NOW = datetime(2026, 6, 1, tzinfo=UTC)
GOVERNANCE = Governance.protected(DomainSet.of(0)).to_xml().decode()
OTHERS = {Stack.CYCLONEDDS, Stack.FASTDDS, Stack.OPENDDS, Stack.ROS2}
OPEN_RANGE = "<id_range>\n<min>0</min>\n</id_range>"
PSK = "<rtps_psk_protection_kind>ENCRYPT</rtps_psk_protection_kind>"
METRICS = "<monitoring_metrics_protection_kind>SIGN</monitoring_metrics_protection_kind>"
REVISION = "<enable_key_revision>true</enable_key_revision>"


def governance(*edits):
    text = GOVERNANCE
    for old, new in edits:
        assert old in text, old
        text = text.replace(old, new, 1)
    return text


OBSERVED = governance(
    ("<id>0</id>", f"{OPEN_RANGE}\n<tag>RTI_o11y</tag>\n<tag></tag>"),
    ("<discovery_p", f"{REVISION}\n<discovery_p"),
    ("<rtps_p", f"{METRICS}\n{METRICS.replace('metrics', 'logging')}\n<rtps_p"),
    ("<topic_access_rules>", f"{PSK}\n<topic_access_rules>"),
)
MONITOR = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
    xsi:noNamespaceSchemaLocation="http://community.rti.com/schema/7.7.0/dds_security_permissions.xsd">
    <permissions>
        <grant name="monitor">
            <subject_name>CN=/monitor</subject_name>
            <validity>
                <!-- in GMT -->
                <not_before>2021-01-20T00:00:00</not_before>
                <not_after>2031-01-20T00:00:00</not_after>
            </validity>
            <allow_rule>
                <domains>
                    <id_range>
                        <min>0</min>
                    </id_range>
                    <tag>RTI_o11y</tag>
                </domains>
                <subscribe_monitoring>ALL</subscribe_monitoring>
            </allow_rule>
            <default>DENY</default>
        </grant>
    </permissions>
</dds>
"""


def found_in(folder, text, *targets):
    (folder / "document.xml").write_text(text)
    return check([folder / "document.xml"], now=NOW, targets=targets).findings


def errors_in(folder, text, *targets):
    return errors_of(found_in(folder, text, *targets))


def errors_of(findings):
    return [each for each in findings if each.severity is Severity.ERROR]


@pytest.mark.parametrize("text", [OBSERVED, MONITOR], ids=["governance", "permissions"])
@pytest.mark.parametrize("target", Stack)
def test_a_document_that_connext_takes_is_an_error_for_the_others_alone(target, text, tmp_path):
    found = found_in(tmp_path, text, target)
    worst = {each.severity for each in found}
    assert worst <= {Severity.INFO} if target is Stack.CONNEXT else Severity.ERROR in worst
    assert all(target in each.stacks for each in found if each.stacks)


def test_without_a_target_each_finding_says_for_which_stacks_it_holds(tmp_path):
    found = found_in(tmp_path, OBSERVED)
    line = OBSERVED.splitlines().index("<tag>RTI_o11y</tag>") + 1
    refused, taken = (each for each in found if each.line == line)
    assert (refused.severity, set(refused.stacks)) == (Severity.ERROR, OTHERS)
    assert (taken.severity, set(taken.stacks)) == (Severity.INFO, {Stack.CONNEXT})
    assert str(taken).endswith("[RTI Connext 7.4.0 and later]")
    [open_range] = [each for each in found if each.rule.id == "PQS231"]
    assert set(open_range.stacks) == {Stack.CYCLONEDDS, Stack.FASTDDS, Stack.ROS2}
    assert "Cyclone DDS 0.10.2, 0.10.5, 11.0.1; Fast DDS 2.9.1" in str(open_range)
    assert open_range.to_json()["stacks"][Stack.FASTDDS] == "2.9.1, 3.1.2, 3.6.2"


@pytest.mark.parametrize(
    ("parent", "tag"),
    [
        pytest.param(parent, row.tag, id=f"{parent}-{row.tag}")
        for row in ROWS[Stack.CONNEXT]
        for parent in row.parents
        if not row.replaces
    ],
)
def test_each_element_of_connext_is_taken_where_it_is_documented(parent, tag, tmp_path):
    text = GOVERNANCE if parent in {"domain_rule", "domains"} else MONITOR
    text = text.replace("allow_rule", parent) if parent == "deny_rule" else text
    if f"<{tag}>" not in text:
        text = text.replace(f"</{parent}>", f"<{tag}>x</{tag}></{parent}>", 1)
    assert not errors_in(tmp_path, text, Stack.CONNEXT)
    elsewhere = GOVERNANCE.replace("</topic_rule>", f"<{tag}>x</{tag}></topic_rule>")
    assert errors_in(tmp_path, elsewhere, Stack.CONNEXT)


def test_what_connext_does_not_take_either_is_an_error_for_connext_too(tmp_path):
    for edit in (
        ("<domains>", "<domains><priority>1</priority>"),
        ("<tag>RTI_o11y</tag>", "<tag_>RTI_o11y</tag_>"),
        (">ENCRYPT</data", ">CRYPT</data"),
        ("<rtps_protection_kind>SIGN</rtps_protection_kind>\n", ""),
        (PSK, f"{PSK}\n<rtps>x</rtps>"),
    ):
        text = OBSERVED.replace(*edit, 1)
        assert text != OBSERVED, edit
        found = errors_in(tmp_path, text)
        assert any(not each.stacks or Stack.CONNEXT in each.stacks for each in found), edit
        assert errors_in(tmp_path, text, Stack.CONNEXT), edit


def test_an_expression_in_place_of_the_subject_is_taken_by_connext_alone(tmp_path):
    text = MONITOR.replace("subject_name>", "subject_name_expression>")
    assert not errors_in(tmp_path, text, Stack.CONNEXT)
    refused = {each.rule.id for each in errors_in(tmp_path, text, Stack.FASTDDS)}
    assert {"PQS209", "PQS219"} <= refused
    without = MONITOR.replace("<subject_name>CN=/monitor</subject_name>", "")
    assert "PQS219" in {each.rule.id for each in errors_in(tmp_path, without, Stack.CONNEXT)}


def test_an_element_that_need_not_be_interpreted_is_taken_by_connext_alone(tmp_path):
    optional = '<anything must_interpret="false">x</anything>'
    text = governance(("<discovery_p", f"{optional}<discovery_p"))
    assert not errors_in(tmp_path, text, Stack.CONNEXT)
    assert errors_in(tmp_path, text.replace('"false"', '"true"'), Stack.CONNEXT)
    for target in OTHERS:
        assert errors_in(tmp_path, text, target)
    marked = governance(("<rtps_protection_kind", '<rtps_protection_kind must_interpret="true"'))
    assert not errors_in(tmp_path, marked, Stack.CONNEXT)
    assert errors_in(tmp_path, marked, Stack.CYCLONEDDS)


def test_a_keystore_of_connext_is_judged_as_connext_documents_it(tmp_path):
    lab = Lab(tmp_path)
    before = errors_of(lab.report(Stack.CONNEXT).findings)
    lab.put("enclaves/governance.p7s", lab.authorities().sign(OBSERVED.encode(), now=NOW))
    lab.put("enclaves/governance.xml", OBSERVED.encode())
    assert errors_of(lab.report(Stack.CONNEXT).findings) == before
    assert {each.rule.id for each in errors_of(lab.report(Stack.FASTDDS).findings)} >= {
        "PQS209",
        "PQS210",
    }


def test_an_attribute_twice_in_a_subject_is_an_error_for_the_versions_that_refuse_it(tmp_path):
    rule = RULES["PQS419"]
    assert rule.stacks == {
        Stack.CYCLONEDDS: "0.10.2, 0.10.5, 11.0.1",
        Stack.FASTDDS: "3.1.2, 3.6.2",
        Stack.ROS2: "",
    }
    text = MONITOR.replace("CN=/monitor", "CN=x,OU=a,OU=b")
    assert "PQS419" not in {each.rule.id for each in found_in(tmp_path, text, Stack.CONNEXT)}


def test_every_rule_with_stacks_has_versions_that_were_run_or_says_its_source():
    for rule in RULES.values():
        if rule.stacks:
            assert rule.measured, rule.id
            assert set(rule.to_json()["versions"]) == set(rule.stacks)


def test_a_namespace_that_fast_dds_ignores_is_no_error_for_it(tmp_path):
    text = GOVERNANCE.replace("<dds ", f"<dds xmlns={quoteattr('urn:x')} ")
    assert {each.severity for each in found_in(tmp_path, text, Stack.FASTDDS)} == {Severity.WARNING}
    assert errors_in(tmp_path, text, Stack.CYCLONEDDS)
    assert errors_in(tmp_path, text, Stack.CONNEXT)


def test_reports_for_other_programs_name_the_stacks_too(tmp_path):
    (tmp_path / "document.xml").write_text(OBSERVED)
    report = check([tmp_path / "document.xml"], now=NOW, targets=[Stack.FASTDDS])
    holds = "Cyclone DDS 0.10.2, 0.10.5, 11.0.1; Fast DDS 2.9.1, 3.1.2, 3.6.2; ROS 2"
    [issue] = [each for each in to_code_quality(report) if each["check_name"] == "PQS231"]
    assert issue["description"].endswith(f"[{holds}]")
    [run] = to_sarif(report)["runs"]
    [result] = [each for each in run["results"] if each["ruleId"] == "PQS231"]
    assert result["properties"] == {"stacks": holds}
