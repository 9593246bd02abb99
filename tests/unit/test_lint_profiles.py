"""Profiles of Fast DDS: what counts as one, and what is said of it."""

from datetime import UTC, datetime

import pytest

from pqsec_pki.lint import check
from tests.unit.test_lint_documents import GOVERNANCE

NOW = datetime(2026, 11, 22, tzinfo=UTC)
ALL = {
    "dds.sec.auth.plugin": "builtin.PKI-DH",
    **{f"dds.sec.auth.builtin.PKI-DH.{name}": "file:///k/x.pem"
       for name in ("identity_ca", "identity_certificate", "private_key")},
    "dds.sec.access.plugin": "builtin.Access-Permissions",
    **{f"dds.sec.access.builtin.Access-Permissions.{name}": "file:///k/x.p7s"
       for name in ("permissions_ca", "governance", "permissions")},
    "dds.sec.crypto.plugin": "builtin.AES-GCM-GMAC",
}  # fmt: skip


def profile(properties, name="robot"):
    lines = "\n".join(
        f"<property><name>{each}</name><value>{value}</value></property>"
        for each, value in properties.items()
    )
    return (
        f'<participant profile_name="{name}"><rtps><propertiesPolicy><properties>\n{lines}\n'
        "</properties></propertiesPolicy></rtps></participant>"
    )


@pytest.fixture
def found(tmp_path):
    """found(xml) is (rule, line, message) of all findings."""

    def run(xml):
        (tmp_path / "fastdds.xml").write_text(xml)
        report = check([tmp_path / "fastdds.xml"], now=NOW)
        return [(each.rule.id, each.line, each.message) for each in report.findings]

    return run


@pytest.mark.parametrize(
    "whole",
    [
        "<dds><profiles>{}</profiles></dds>",
        '<dds xmlns="http://www.eprosima.com"><profiles>{}</profiles></dds>',
        "<profiles>{}</profiles>",
    ],
)
def test_a_profile_is_one_in_each_form_that_fast_dds_reads(found, whole):
    assert found(whole.format(profile(ALL))) == []
    changed = profile(ALL | {"dds.sec.auth.plugin": "pqsec"})
    assert [each[:2] for each in found(whole.format(changed))] == [("PQS801", 2)]


def test_each_participant_is_looked_at_by_itself(found):
    half = {name: value for name, value in ALL.items() if not name.startswith("dds.sec.crypto")}
    xml = f"<profiles>{profile(ALL, 'good')}{profile(half, 'half')}</profiles>"
    [(rule, _, message)] = found(xml)
    assert rule == "PQS802"
    assert "'half' has no dds.sec.crypto.plugin" in message


def test_a_participant_without_security_is_no_finding(found):
    assert found(f"<profiles>{profile({'role': 'camera'})}</profiles>") == []


def test_white_space_around_a_plugin_is_part_of_its_name(found):
    spaced = ALL | {"dds.sec.auth.plugin": "\n  builtin.PKI-DH\n"}
    assert [each[0] for each in found(f"<profiles>{profile(spaced)}</profiles>")] == ["PQS801"]


def test_a_misspelt_name_is_told_with_the_one_that_was_meant(found):
    misspelt = ALL | {"dds.sec.auth.builtin.PKI-DH.identity_CRL": "file:///k/crl.pem"}
    [(rule, _, message)] = found(f"<profiles>{profile(misspelt)}</profiles>")
    assert rule == "PQS804"
    assert message.endswith("did you mean dds.sec.auth.builtin.PKI-DH.identity_crl?")


def test_a_document_is_still_a_document(found):
    assert [each[0] for each in found(GOVERNANCE.replace("ENCRYPT", "encrypt", 1))] != []
    assert not [each for each in found(GOVERNANCE) if each[0].startswith("PQS8")]
