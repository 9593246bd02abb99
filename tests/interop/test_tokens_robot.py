"""A robot's key in a real PKCS#11 token: its request, and the installation of the answer."""

import time
from datetime import UTC, datetime

import pytest

from pqsec_pki.keystore import Keystore
from tests.interop.tokens import PIN
from tests.unit.est_server import serving
from tests.unit.tls_sides import identity, pin

pytestmark = [pytest.mark.interop, pytest.mark.timeout(300)]

URI = "pkcs11:token=lab;object=robot"
IN_TOKEN = ("--participant-key-uri", URI)
CSR = "credentials/requests/robot/request.csr"


@pytest.fixture
def ca(token):
    """The token, beside the keystore of a CA whose own keys are in files."""
    token.pqsec("ca", "init", "--profile", "classical", "--no-passphrase")
    return token


def requested(token, *options, exit_code=0, profile="classical", **variables):
    words = ("request", "robot", "--profile", profile, *options)
    return token.pqsec(*words, exit_code=exit_code, **variables)


def issued(token, *options):
    token.pqsec("issue", "--csr", CSR, "robot", "--publish", "chatter", *options)


def installed(token, *options, exit_code=0, **variables):
    return token.pqsec("install", "robot.bundle", *options, exit_code=exit_code, **variables)


def in_use(token):
    return token.folder / "credentials/current/enclaves/robot"


@pytest.mark.slow
def test_a_key_in_the_robots_token_is_requested_certified_and_installed(ca, openssl):
    assert f"{URI} was generated" in requested(ca, *IN_TOKEN)
    openssl("req", "-verify", "-noout", "-in", ca.folder / CSR)
    issued(ca)
    installed(ca, "--trust-first")
    openssl(
        "verify", "-CAfile", ca.folder / "k/public/identity_ca.cert.pem", in_use(ca) / "cert.pem"
    )
    assert "recorded" in ca.pqsec("receipt", "import", "credentials/installed.receipt")

    content = (in_use(ca) / "key.pem").read_text()
    assert content.startswith("-----BEGIN PKCS#11 PROVIDER URI-----\n")
    [private] = ca.objects().split("Private Key Object")[1:]
    assert "never extractable" in private
    assert "sensitive" in private


def test_neither_the_key_nor_the_pin_is_in_a_file_or_an_output(ca):
    said = requested(ca, *IN_TOKEN)
    issued(ca)
    said += installed(ca, "--trust-first") + ca.pqsec("log")
    files = [path for path in (ca.folder / "credentials").rglob("*") if path.is_file()]
    files += [ca.folder / "robot.bundle"]
    assert PIN not in said
    assert not [path for path in files if PIN.encode() in path.read_bytes()]
    assert not [path for path in files if b"PRIVATE KEY" in path.read_bytes()]


def test_a_key_in_the_token_enrols_over_a_network_and_renews_with_signed_requests(ca):
    keystore = Keystore.open(ca.folder / "k", to_change=True)
    with serving(keystore, identity("ecdsa-p256")) as server:
        server.now = datetime.now(UTC)
        trust = ("--server-pin", pin(server.shown), "--trust-first", "--profile", "classical")
        server.anybody = True
        said = ca.pqsec("enrol", server.url, "--name", "robot", *trust, *IN_TOKEN)
        assert "has a new certificate" in said
        server.anybody = False
        before = (in_use(ca) / "cert.pem").read_bytes()
        assert "is up to date" in ca.pqsec("renew", "--from", server.url)
        time.sleep(1.1)  # the next certificate is to be newer, in seconds
        server.now = datetime.now(UTC)
        assert "has a new certificate" in ca.pqsec("renew", "--from", server.url, "--rekey")
        assert (in_use(ca) / "cert.pem").read_bytes() != before
        assert (in_use(ca) / "key.pem").read_text().startswith("-----BEGIN PKCS#11")


def test_a_key_that_is_there_is_used_and_stays_when_the_request_fails(ca):
    as_user = ("--token-label", "lab", "--login", "--pin", PIN)
    ca.tool(*as_user, "--keypairgen", "--key-type", "EC:prime256v1", "--label", "robot")
    assert f"{URI} was there already" in requested(ca, *IN_TOKEN)
    requested(ca, *IN_TOKEN, exit_code=3)  # there is a request
    assert ca.objects().count("Private Key Object") == 1


def test_a_key_that_was_made_is_removed_if_the_request_is_not(ca):
    name = "a" * 70  # does not fit into a certificate
    said = ca.pqsec("request", name, "--profile", "classical", *IN_TOKEN, exit_code=2)
    assert "64 characters" in said
    assert ca.objects() == ""
    assert not list((ca.folder / "credentials").rglob("*.pem"))


@pytest.mark.parametrize(
    ("options", "profile", "words"),
    [
        (("--participant-key", "rsa-2048"), "classical", "a token cannot sign handshakes"),
        ((), "hybrid", "no token signs as"),
        (("--alt-key-uri", f"{URI}2"), "classical", "have no alternative key"),
        (("second",), "classical", "one key is named for 2 participants"),
    ],
)
def test_what_a_token_cannot_do_is_refused_before_it_makes_a_key(ca, options, profile, words):
    assert words in requested(ca, *IN_TOKEN, *options, profile=profile, exit_code=2)
    assert ca.objects() == ""


def test_a_new_key_follows_into_the_token_or_the_command_refuses(ca):
    requested(ca, *IN_TOKEN)
    issued(ca)
    installed(ca, "--trust-first")
    said = requested(ca, exit_code=2)
    assert "the new key would be in a file" in said
    assert not (ca.folder / CSR).exists()

    first = (in_use(ca) / "cert.pem").read_bytes()
    requested(ca, "--participant-key-uri", f"{URI}-2")
    issued(ca, "--force")
    installed(ca)
    assert (in_use(ca) / "cert.pem").read_bytes() != first
    assert ca.objects().count("Private Key Object") == 2, "the old key stays in the token"
    requested(ca, "--participant-key-uri", "file")
    issued(ca, "--force")
    installed(ca)
    assert "BEGIN PRIVATE KEY" in (in_use(ca) / "key.pem").read_text()


def test_the_same_key_is_certified_again(ca):
    requested(ca, *IN_TOKEN)
    issued(ca)
    installed(ca, "--trust-first")
    ca.pqsec("renew", "robot")
    ca.pqsec("bundle", "robot", "--force")
    assert "installed" in installed(ca)
    assert ca.objects().count("Private Key Object") == 1


def test_a_second_key_may_stay_in_a_file(token):
    token.pqsec("ca", "init", "--profile", "transition", "--no-passphrase")
    requested(token, *IN_TOKEN, profile="transition")
    issued(token)
    installed(token, "--trust-first")
    assert "PROVIDER URI" in (in_use(token) / "key.pem").read_text()
    assert "BEGIN PRIVATE KEY" in (in_use(token) / "alt.key.pem").read_text()
    token.pqsec("receipt", "import", "credentials/installed.receipt")


def test_installing_without_the_token_is_refused_and_changes_nothing(ca):
    requested(ca, *IN_TOKEN)
    issued(ca)
    (ca.folder / "tokens").rename(ca.folder / "elsewhere")
    (ca.folder / "tokens").mkdir()
    assert "the token 'lab' is not there" in installed(ca, "--trust-first", exit_code=3)
    assert not in_use(ca).exists()
    (ca.folder / "tokens").rmdir()
    (ca.folder / "elsewhere").rename(ca.folder / "tokens")
    installed(ca, "--trust-first")


def test_a_token_with_another_key_under_that_name_is_refused(ca):
    requested(ca, *IN_TOKEN)
    issued(ca)
    as_user = ("--token-label", "lab", "--login", "--pin", PIN)
    for kind in ("privkey", "pubkey"):
        ca.tool(*as_user, "--delete-object", "--type", kind, "--label", "robot")
    ca.tool(*as_user, "--keypairgen", "--key-type", "EC:prime256v1", "--label", "robot")
    said = installed(ca, "--trust-first", exit_code=1)
    assert "no private key here matches the certificate" in said


# A token that is plugged in beside the CAs


def certified(token, *options, exit_code=0):
    words = ("issue", *options, "--publish", "chatter")
    return token.pqsec(*words, exit_code=exit_code)


def test_a_key_is_made_in_the_participants_token_and_certified(ca, openssl):
    assert f"{URI} was generated" in certified(ca, "robot", *IN_TOKEN)
    ca.pqsec("issue", "listener", "--subscribe", "chatter")
    enclave = ca.folder / "k/enclaves/robot"
    openssl("verify", "-CAfile", ca.folder / "k/public/identity_ca.cert.pem", enclave / "cert.pem")
    assert (enclave / "key.pem").read_text().startswith("-----BEGIN PKCS#11 PROVIDER URI")
    assert "/robot to /listener" in ca.pqsec("verify-handshake", "robot", "listener")

    requested(ca, *IN_TOKEN)  # the token moves to the robot, which says where its key is
    ca.pqsec("bundle", "robot")
    installed(ca, "--trust-first")


def test_one_key_for_several_or_beside_a_request_is_refused(ca):
    assert "named for 2" in certified(ca, "robot", "second", *IN_TOKEN, exit_code=2)
    requested(ca)
    said = certified(ca, "--csr", CSR, "robot", *IN_TOKEN, exit_code=2)
    assert "--csr has the key already" in said
    assert ca.objects() == ""


def test_a_key_that_was_made_is_removed_if_nobody_is_issued(ca):
    assert "64 characters" in certified(ca, "a" * 70, *IN_TOKEN, exit_code=2)
    assert ca.objects() == ""


def test_the_key_of_another_participant_is_refused(ca):
    certified(ca, "robot", *IN_TOKEN)
    said = certified(ca, "second", *IN_TOKEN, exit_code=1)
    assert "its key is that of /robot" in said
    assert ca.objects().count("Private Key Object") == 1


def test_the_key_of_a_ca_is_refused(token):
    ca_key = ("--permissions-key-uri", URI)
    token.pqsec("ca", "init", "--profile", "classical", "--no-passphrase", *ca_key)
    said = certified(token, "robot", *IN_TOKEN, exit_code=1)
    assert "that key is a CA's" in said


def test_renewing_keeps_the_key_in_the_token(ca):
    certified(ca, "robot", *IN_TOKEN)
    before = (ca.folder / "k/enclaves/robot/key.pem").read_bytes()
    ca.pqsec("renew", "robot")
    assert "or in a token" in ca.pqsec("renew", "robot", "--rekey", exit_code=3)
    ca.pqsec("ca", "rotate", "--apply", "--yes", "--no-passphrase")
    assert (ca.folder / "k/enclaves/robot/key.pem").read_bytes() == before
    ca.pqsec("issue", "listener", "--subscribe", "chatter")
    ca.pqsec("verify-handshake", "robot", "listener")


def test_a_participants_new_key_lies_in_a_file_only_if_it_is_said(ca):
    certified(ca, "robot", *IN_TOKEN)
    said = certified(ca, "robot", "--force", exit_code=2)
    assert "key.pem of /robot is in a token, and the new key would be in a file" in said
    certified(ca, "robot", "--force", "--participant-key-uri", "file")
    assert "BEGIN PRIVATE KEY" in (ca.folder / "k/enclaves/robot/key.pem").read_text()
