"""pqsec export: what is printed and written, and how refusals are told."""

import shlex
import stat

import pytest

from pqsec_pki.algorithms import load_private_key, private_key_pem
from pqsec_pki.cli import export as command
from pqsec_pki.plugin import LIBRARY
from pqsec_pki.stacks import Stack
from pqsec_pki.tokens import reference_to
from tests.cli.conftest import secret, snapshot

PRINTED = {
    "cyclonedds": "<CycloneDDS",
    "fastdds": "<dds xmlns",
    "connext": "<qos_library",
}


@pytest.fixture
def locked_key(keystore, tmp_path):
    """Keystore k, in which /talker's key is encrypted; the passphrase is in `right`."""
    path = keystore() / "enclaves/talker/key.pem"
    path.write_bytes(private_key_pem(load_private_key(path.read_bytes()), b"open sesame, please"))
    secret(tmp_path / "right", "open sesame, please\n")


@pytest.mark.parametrize("stack", PRINTED)
def test_without_a_folder_the_file_is_printed(pqsec, keystore, tmp_path, stack):
    keystore()
    before = snapshot(tmp_path)
    printed = pqsec(f"-k k export {stack} /talker").done().out
    assert PRINTED[stack] in printed
    assert printed.endswith(">\n")
    assert snapshot(tmp_path) == before


def test_a_reference_to_another_file_is_not_exported_as_the_uri_of_a_key(pqsec, keystore):
    """Fast DDS's own plugin would open what the reference names: another file."""
    path = keystore() / "enclaves/talker/key.pem"
    path.write_bytes(reference_to("file:/home/other.pem"))
    refused = pqsec("-k k export fastdds /talker")
    refused.refused(1, "own plugin is not known to take one")
    path.write_bytes(reference_to("pkcs11:token=lab;object=talker"))
    assert "pkcs11:token=lab" in pqsec("-k k export fastdds /talker").done().out


def test_it_is_written_with_the_commands_that_use_it(pqsec, keystore, tmp_path):
    keystore()
    done = pqsec("-k k export cyclonedds talker --loopback -o 'my conf'").done()
    path = tmp_path / "my conf" / "cyclonedds.xml"
    variable = shlex.quote(f"file://{path}")
    assert done.out.splitlines() == [
        "my conf/cyclonedds.xml",
        "",
        "To use it:",
        f"export CYCLONEDDS_URI={variable}",
    ]
    printed = pqsec("-k k export cyclonedds /talker --loopback").done().out
    assert path.read_text() == printed


def test_what_is_to_be_known_is_noted(pqsec, keystore):
    keystore("transition")
    noted = pqsec("-k k export fastdds /talker").done().err
    assert "too large for some versions of Fast DDS" in noted
    assert "if Fast DDS cannot read fastdds.xml, " in noted
    assert "runs unsecured" in noted
    quiet = pqsec("-k k export fastdds /talker --stack-version 3.6.2").done().err
    assert "too large" not in quiet


def test_json_has_it_all(pqsec, keystore, tmp_path):
    keystore()
    value = pqsec("-k k export fastdds /talker --json").done().json
    assert value["stack"] == "fastdds"
    assert value["participant"] == "/talker"
    assert "<dds xmlns" in value["texts"]["fastdds.xml"]
    written = pqsec("-k k export fastdds /talker --json -o conf").done().json
    variable = "FASTDDS_DEFAULT_PROFILES_FILE"
    assert written["files"] == ["conf/fastdds.xml"]
    assert written["environment"][variable] == str(tmp_path / "conf/fastdds.xml")
    assert f"export {variable}={tmp_path}/conf/fastdds.xml" in written["commands"]


def test_nothing_is_replaced_unless_forced(pqsec, keystore, tmp_path):
    keystore()
    pqsec("-k k export fastdds /talker -o conf").done()
    before = snapshot(tmp_path)
    pqsec("-k k export fastdds /listener -o conf").refused(3, "exists", hint="--force")
    assert snapshot(tmp_path) == before
    pqsec("-k k export fastdds /listener -o conf --force").done()
    assert "/listener/key.pem" in (tmp_path / "conf/fastdds.xml").read_text()


@pytest.mark.parametrize("stack", ["cyclonedds", "fastdds", "opendds", "connext"])
def test_what_no_stock_stack_takes_is_refused(pqsec, keystore, tmp_path, stack):
    keystore("pq")
    before = snapshot(tmp_path)
    refused = pqsec(f"-k k export {stack} /talker -o conf")
    assert refused.code == 1
    assert "for pqsec peers only" in refused.err
    assert "hint: " in refused.err
    assert snapshot(tmp_path) == before


def test_fast_dds_with_the_limit_is_refused_what_is_too_large(pqsec, keystore):
    keystore("transition")
    line = "-k k export fastdds /talker --stack-version 3.1.2"
    pqsec(line).refused(1, "over 8192", hint="classical profile")
    assert "over 8192" in pqsec(f"{line} --anyway").done().err


def test_opendds_is_refused_a_governance_that_it_cannot_join(pqsec, keystore, tmp_path):
    root = keystore()
    pqsec("-k k export opendds /talker").refused(
        1, "OpenDDS creates no participant", hint="enable_read_access_control"
    )
    add_open_rule(pqsec, root, "nobody")
    done = pqsec("-k k export opendds /talker -o conf").done()
    assert "-DCPSConfigFile" in done.out
    assert "not run" in done.err
    assert "DCPSSecurity=1" in (tmp_path / "conf/opendds.ini").read_text()


def add_open_rule(pqsec, root, expression):
    """Let everyone read topics that the expression covers."""
    governance = root / "enclaves/governance.xml"
    text = governance.read_text()
    [start, rule, end] = text.partition("<topic_rule>")
    rule += end.partition("</topic_rule>")[0] + "</topic_rule>"
    open_rule = rule.replace(">*<", f">{expression}<").replace(
        "read_access_control>true", "read_access_control>false"
    )
    governance.write_text(start + open_rule + rule + end.partition("</topic_rule>")[2])
    pqsec(f"-k k sign-governance {governance} --force").done()


def test_opendds_is_refused_a_pattern_that_it_reads_beyond(pqsec, keystore):
    add_open_rule(pqsec, keystore(), "[P-")
    pqsec("-k k export opendds /talker").refused(
        1, "reads beyond the pattern", hint="Close the bracket"
    )
    pqsec("-k k export cyclonedds /talker -o conf").done()


@pytest.mark.usefixtures("locked_key")
def test_a_passphrase_is_written_for_its_owner_only(pqsec, tmp_path):
    noted = pqsec("-k k export cyclonedds /talker").done()
    assert "PQSEC_KEY_PASSWORD" in noted.out
    assert "set PQSEC_KEY_PASSWORD" in noted.err
    line = "-k k export cyclonedds /talker --password-file right"
    pqsec(line).refused(2, "is not printed", hint="-o DIR")
    pqsec(f"{line} -o conf").done()
    path = tmp_path / "conf" / "cyclonedds.xml"
    assert "<Password>open sesame, please</Password>" in path.read_text()
    assert [stat.S_IMODE(each.stat().st_mode) for each in (path, path.parent)] == [0o600, 0o700]


@pytest.mark.usefixtures("locked_key")
def test_a_passphrase_that_is_no_text_is_refused(pqsec, tmp_path):
    secret(tmp_path / "bytes", b"\xff\n")
    pqsec("-k k export cyclonedds /talker --password-file bytes -o c").refused(3, "not UTF-8")


def test_paths_can_be_those_of_another_machine(pqsec, keystore):
    keystore()
    printed = pqsec("-k k export fastdds /talker --at /etc/robot").done().out
    assert "<value>file:///etc/robot/key.pem</value>" in printed
    pqsec("-k k export fastdds /talker --at robot").refused(2, "not an absolute path")


def test_a_participant_that_is_not_there_is_named(pqsec, keystore):
    keystore()
    pqsec("-k k export cyclonedds /nobody").refused(3, "no participant /nobody", hint="issue")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("zenoh /talker", "zenoh"),
        ("cyclonedds", "NAME"),
        ("cyclonedds /talker --stack-version new", "not a version"),
        ("cyclonedds /talker --stack-version 0.9", "does not know the configuration of"),
        ("opendds /talker --stack-version 4", "does not know the configuration of OpenDDS 4"),
        ("connext /talker --stack-version 6.1", "exports are for 7.x"),
        ("ros2 /talker --stack-version jazzy", "versions of ROS 2 have no numbers"),
        ("ros2 /talker --stack-version 2", "exports are for Jazzy"),
        ("cyclonedds /talker -o ''", "empty"),
    ],
)
def test_what_makes_no_sense_is_a_usage_error(pqsec, keystore, options, words):
    keystore()
    done = pqsec(f"-k k export {options}")
    assert done.code == 2
    assert words in done.err


def test_the_help_names_all_stacks(pqsec):
    text = " ".join(pqsec("export --help").done().out.split())
    assert all(stack in text for stack in Stack)
    assert command.export.help


def test_plugins_of_another_cyclone_are_refused_with_the_way_out(
    pqsec, keystore, library, tmp_path
):
    keystore()
    older = library.cyclone(tmp_path / "older", "0.10.2", "libddsc.so.0debian")
    newer = library.cyclone(tmp_path / "newer", "11.0.1", "libddsc.so.11")
    line = "-k k export cyclonedds /talker --stack-version 11.0.1"
    pqsec(f"{line} --plugins {older}").refused(1, "0.10.2", hint="--plugins DIR")
    crypto = f"{older}/libdds_security_crypto.so"
    pqsec(f"{line} --plugins {newer} --crypto {crypto}").refused(1, "0.10.2", hint="--crypto FILE")
    assert str(newer) in pqsec(f"{line} --plugins {newer}").done().out


def test_with_our_plugin_both_its_folder_and_cyclones_encryption_can_be_said(
    pqsec, keystore, library, tmp_path
):
    keystore("pq")
    newer = library.cyclone(tmp_path / "newer", "11.0.1", "libddsc.so.11")
    (tmp_path / "ours").mkdir()
    (tmp_path / "ours" / LIBRARY).touch()
    crypto = newer / "libdds_security_crypto.so"
    line = f"-k k export cyclonedds /talker --plugin --plugins ours --crypto {crypto}"
    printed = pqsec(line).done().out
    assert f'path="{tmp_path}/ours/{LIBRARY}"' in printed
    assert f'path="{crypto}"' in printed
