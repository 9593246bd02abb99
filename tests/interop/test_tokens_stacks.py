"""What stacks' own plugins, and the commands, do with a participant whose key is in a token."""

import re
from pathlib import Path

import pytest

from pqsec_pki.trial import (
    Act,
    Installation,
    TrialRole,
    TrialSetup,
    built,
    run_peers,
    running,
    unique_text,
)
from tests.interop.conftest import TOPIC
from tests.interop.plugin.processes import PATIENCE, logs, met
from tests.interop.tokens import PIN

pytestmark = [pytest.mark.interop, pytest.mark.timeout(300)]

NAMES = ("alice", "bob")
ENGINE = next(Path("/usr/lib").glob("*-linux-gnu/engines-3/pkcs11.so"), None)
NO_TOKEN = {"PQSEC_PKCS11_MODULE": "/nonexistent.so", "PQSEC_PIN_FILE": ""}


@pytest.fixture
def pair(token):
    """The token, with the keys of two, beside their keystore."""
    token.pqsec("ca", "init", "--profile", "classical", "--no-passphrase", "--domain", "0-10")
    for name in NAMES:
        place = ("--participant-key-uri", f"pkcs11:token=lab;object={name}")
        token.pqsec("issue", name, *place, "--publish", TOPIC, "--subscribe", TOPIC)
    return token


@pytest.fixture
def fastdds(stack_in, requires) -> Installation:
    requires(ENGINE, "OpenSSL's engine", "apt-get install libengine-pkcs11-openssl")
    return stack_in("fastdds", "bookworm")


def run_both(fastdds, token, *, seconds, **variables):
    """Alice sends, bob receives, each with what `pqsec export` wrote."""
    roles = []
    for name, act in zip(NAMES, (Act.SEND, Act.RECEIVE), strict=True):
        token.pqsec("export", "fastdds", name, "--loopback", "-o", name, **NO_TOKEN)
        environment = {
            **token.environment,
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(token.folder / name / "fastdds.xml"),
            "PKCS11_MODULE_PATH": str(token.module),
            **variables,
        }
        text = unique_text() if act is Act.SEND else ""
        roles.append(TrialRole(name=name, act=act, text=text, environment=environment))
    program = fastdds.peer(built(fastdds))
    return run_peers(TrialSetup(program=program, domain=3, topic=TOPIC, timeout=seconds), roles)


def test_stock_fast_dds_signs_handshakes_with_keys_in_a_token(fastdds, pair):
    went = run_both(fastdds, pair, seconds=PATIENCE, FASTDDS_PKCS11_PIN=PIN)
    assert met(went), logs(went)


def test_stock_fast_dds_refuses_without_its_engine(fastdds, pair, monkeypatch):
    monkeypatch.setattr(running, "_SETTLE", PATIENCE)  # it ends before, when both have ended
    variables = {"FASTDDS_PKCS11_PIN": PIN, "OPENSSL_ENGINES": str(pair.folder)}
    went = run_both(fastdds, pair, seconds=PATIENCE, **variables)
    assert all(each.refused for each in went.outcomes)
    assert "Error retrieving 'pkcs11' engine" in logs(went)


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("end", ["", "\n"])
def test_stock_fast_dds_reads_the_pin_in_a_file_without_a_line_end(
    fastdds, token, end, monkeypatch
):
    """With one, it logs in with another PIN."""
    monkeypatch.setattr(running, "_SETTLE", PATIENCE)  # it ends before, when both have ended
    token.pin_file.write_text(PIN + end)
    token.pqsec("ca", "init", "--profile", "classical", "--no-passphrase", "--domain", "0-10")
    for name in NAMES:
        uri = f"pkcs11:token=lab;object={name}?pin-source=file:{token.pin_file}"
        options = ("--participant-key-uri", uri, "--publish", TOPIC, "--subscribe", TOPIC)
        token.pqsec("issue", name, *options, PQSEC_PIN_FILE="")
    went = run_both(fastdds, token, seconds=PATIENCE)
    if end:
        assert all(each.refused for each in went.outcomes)
        assert "Login failed" in logs(went)
    else:
        assert met(went), logs(went)


@pytest.mark.slow
def test_cyclone_dds_and_fast_dds_meet_with_our_plugin_and_keys_in_a_token(fastdds, pair):
    said = pair.pqsec("try", "cyclonedds,fastdds", *NAMES, "--plugin", HOME=str(pair.home))
    assert "the sample cannot be read in" in said


@pytest.mark.slow(but=2)
@pytest.mark.parametrize("stack", ["cyclonedds", "opendds", "connext", "ros2"])
def test_an_export_for_a_plugin_that_takes_no_token_is_refused(pair, stack):
    said = pair.pqsec("export", stack, "alice", "-o", "there", exit_code=1, **NO_TOKEN)
    assert re.search(r"in a token, and .*'s own plugin is not known to take one", said)
    assert not (pair.folder / "there").exists()


@pytest.mark.slow(but=2)
@pytest.mark.parametrize(
    ("line", "exit_code", "words"),
    [
        ("check", 0, "refers to a key in a token, which was not checked"),
        ("check --target fastdds k/enclaves/alice", 0, "which was not checked"),
        ("inspect k/enclaves/alice/key.pem", 0, "pkcs11:token=lab;object=alice"),
        ("status", 0, "2 valid"),
        ("cbom", 0, "bomFormat"),
        ("report -o report.html", 0, ""),
        ("estimate", 0, "2 participants"),
        ("migrate plan", 0, "/alice: its key is not here"),
        ("renew alice", 0, "/alice"),
        ("bundle alice", 0, "alice.bundle"),
        ("explain alice --publish rt/chatter", 0, ""),
        ("verify-handshake alice bob", 1, "the library of the tokens, /nonexistent.so"),
        ("verify-handshake --all", 1, "the library of the tokens, /nonexistent.so"),
        ("try cyclonedds alice bob", 1, "own plugin is not known to take one"),
    ],
)
def test_no_command_needs_the_token_unless_it_signs(pair, line, exit_code, words):
    assert words in pair.pqsec(*line.split(), exit_code=exit_code, **NO_TOKEN)


def test_a_keystore_is_adopted_with_its_keys_in_a_token(pair):
    (pair.folder / "k/pqsec.json").unlink()
    (pair.folder / "k/private/ledger.sqlite3").unlink()
    assert "2 participants" in pair.pqsec("adopt", "k", **NO_TOKEN)


def test_a_report_is_signed_with_a_key_in_a_token(token):
    place = ("--permissions-key-uri", "pkcs11:token=lab;object=signer")
    token.pqsec("ca", "init", "--profile", "classical", "--no-passphrase", *place)
    signer = ("k/public/permissions_ca.cert.pem", "k/private/permissions_ca.key.pem")
    token.pqsec("report", "-o", "report.html", "--signer", *signer)
    token.pqsec("verify", "report.html.p7s")
