"""The package in examples/extension: pip installs it, and pqsec uses all that it adds.

test_signers.py uses its signer.
"""

import json
from functools import partial
from pathlib import Path

import pytest

from pqsec_pki.algorithms import load_private_key, private_key_pem
from pqsec_pki.vendors import foreign
from tests.cli.conftest import secret

WARNING = "written by code of the package pqsec-lab 1.0, not of pqsec, which did not run it"


@pytest.fixture
def lab(extension, tmp_path):
    """A command in a process of its own, which loads all that the package adds."""
    return partial(extension, tmp_path)


@pytest.fixture
def here(extension_site, pqsec, monkeypatch):
    """A command in this process, which finds the stack."""
    monkeypatch.syspath_prepend(extension_site)
    foreign.exporter_of.cache_clear()
    yield pqsec
    foreign.exporter_of.cache_clear()


def test_its_rule_finds_what_it_is_for(lab):
    lab("demo robots").done()
    found = (
        lab("check robots --ignore PQS707=demo --ignore PQS320=x --json").done().json["findings"]
    )
    of_lab = [each["path"] for each in found if each["rule"] == "LAB001"]
    assert {Path(each).parent.name for each in of_lab} == {"talker", "listener"}
    assert lab("check robots --ignore PQS707=demo --strict").code == 1
    lab("check robots --ignore PQS707=demo --ignore LAB001=demo --strict").done()
    explained = lab("check --explain LAB001", measured=True).done().out
    assert explained.startswith("LAB001 (warning, lab): a participant's")
    [log] = json.loads(lab("check robots --sarif").out)["runs"]
    assert "LAB001" in {each["id"] for each in log["tool"]["driver"]["rules"]}


def test_its_stack_is_exported_for(lab, here, keystore, tmp_path):
    folder = keystore() / "enclaves/talker"
    made = lab("-k k export labdds talker -o conf --json").done().json
    assert (made["stack"], made["participant"]) == ("labdds", "/talker")
    assert WARNING in made["warnings"]
    assert made["commands"] == [f"lab_node --security {tmp_path}/conf/participant.properties"]
    text = (tmp_path / "conf/participant.properties").read_text()
    assert f"dds.sec.auth.private_key=file://{folder}/key.pem\n" in text
    printed = here("-k k export LabDDS talker --at /etc/dds --stack-version 2.1").done()
    assert "dds.sec.access.governance=file:///etc/dds/governance.p7s" in printed.out
    assert f"pqsec: note: {WARNING}" in printed.err
    several = here("-k k export labdds talker listener -o all --json").done().json["exports"]
    assert [each["participant"] for each in several] == ["/talker", "/listener"]


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        ("--stack-version 3.0", 2, "pqsec does not know the configuration of Lab DDS 3.0"),
        ("--loopback", 2, "pqsec does not know how to restrict Lab DDS to one machine"),
        ("--plugin", 2, "Lab DDS cannot load pqsec's plugin"),
    ],
)
def test_an_option_that_its_stack_has_not_is_refused(here, keystore, options, code, words):
    keystore()
    here(f"-k k export labdds talker {options}").refused(code, words)


def test_credentials_that_are_not_trusted_are_not_exported_for_its_stack(here, keystore, tmp_path):
    path = keystore() / "enclaves/talker/permissions.p7s"
    path.write_bytes(path.read_bytes().replace(b"chatter", b"chattex"))
    done = here("-k k export labdds talker -o conf")
    assert done.code == 1
    assert not (tmp_path / "conf").exists()


def test_a_passphrase_that_its_stack_writes_is_for_its_owner_only(here, keystore, tmp_path):
    path = keystore() / "enclaves/talker/key.pem"
    path.write_bytes(private_key_pem(load_private_key(path.read_bytes()), b"open sesame, please"))
    secret(tmp_path / "right", "open sesame, please\n")
    here("-k k export labdds talker").refused(2, "Lab DDS does not ask", hint="--password-file")
    here("-k k export labdds talker --password-file right").refused(2, "is not printed")
    here("-k k export labdds talker --password-file right -o conf").done()
    written = tmp_path / "conf/participant.properties"
    assert "dds.sec.auth.password=open sesame, please\n" in written.read_text()
    assert written.stat().st_mode & 0o777 == 0o600


def test_its_key_agreement_protects_a_handshake(lab):
    lab("-k k ca init --no-passphrase --profile pq --kem lab-kem").done()
    done = lab("-k k issue /a /b --publish t --subscribe t", measured=True).done()
    assert "the key agreement lab-kem is code of the package pqsec-lab 1.0" in done.err
    told = lab("-k k verify-handshake /a /b --json").done().json
    assert told["key_agreement"] == "LabP384MLKEM768"
