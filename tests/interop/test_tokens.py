"""CA keys in real PKCS#11 tokens: SoftHSM has EC and RSA keys, FreeHSM ML-DSA keys.

OpenSSL and Cyclone DDS judge what the tokens sign. Every command runs in a process of its own,
because a process that has used a token forks no more.
"""

import os
import re
from pathlib import Path

import pytest

from pqsec_pki.algorithms import pem
from tests.interop.cyclone import participant
from tests.interop.tokens import PIN, SPY, Token
from tests.longer import LONG

pytestmark = [pytest.mark.interop, pytest.mark.timeout(300)]

IDENTITY = "pkcs11:token=lab;object=identity-ca"
PERMISSIONS = "pkcs11:token=lab;object=permissions-ca"
BOTH = ("--identity-key-uri", IDENTITY, "--permissions-key-uri", PERMISSIONS)
RSA = ("--identity-key", "rsa-2048", "--permissions-key", "rsa-2048")


def created(token, *options, profile="classical"):
    token.pqsec("ca", "init", "--profile", profile, *BOTH, *options)
    return token.folder / "k"


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("kind", [(), RSA], ids=["EC", "RSA"])
def test_openssl_and_cyclone_dds_accept_what_a_token_signs(token, openssl, plugins, kind):
    keystore = created(token, *kind)
    token.pqsec("issue", "talker", "listener", "--publish", "chatter", "--subscribe", "chatter")
    token.pqsec("revoke", "listener", "--yes")
    token.pqsec("sign-governance", "k/enclaves/governance.xml", "--force")

    ca, talker = keystore / "public/identity_ca.cert.pem", keystore / "enclaves/talker"
    openssl("verify", "-CAfile", ca, talker / "cert.pem")
    openssl("crl", "-in", keystore / "public/identity_ca.crl.pem", "-CAfile", ca, "-noout")
    for name in ("governance.p7s", "permissions.p7s"):
        signer = ("-CAfile", keystore / "public/permissions_ca.cert.pem")
        openssl("smime", "-verify", "-text", "-in", talker / name, *signer)
    (talker / "crl.pem").unlink()  # Cyclone DDS would refuse a peer, not this
    with participant(plugins, talker) as one:
        one.join(0)


def test_two_whose_ca_is_in_a_token_authenticate_each_other(token):
    created(token)
    token.pqsec("issue", "talker", "listener", "--publish", "chatter", "--subscribe", "chatter")
    assert "/talker to /listener" in token.pqsec("verify-handshake", "talker", "listener")


def test_no_private_key_of_a_ca_is_in_a_file(token):
    keystore = created(token)
    for name in ("identity_ca.key.pem", "permissions_ca.key.pem"):
        content = (keystore / "private" / name).read_text()
        assert content.startswith("-----BEGIN PKCS#11 PROVIDER URI-----\n")
        assert "PRIVATE KEY" not in content
    private = token.objects().split("Private Key Object")[1:]
    assert len(private) == 2
    assert all("never extractable" in each and "sensitive" in each for each in private)


def test_a_pin_is_in_no_file_and_in_no_output(token):
    said = token.pqsec("ca", "init", "--profile", "classical", *BOTH)
    said += token.pqsec("issue", "talker", "--publish", "chatter")
    said += token.pqsec("log") + token.pqsec("ca", "show")
    files = [path for path in (token.folder / "k").rglob("*") if path.is_file()]
    assert PIN not in said
    assert not [path for path in files if PIN.encode() in path.read_bytes()]


@pytest.mark.slow
def test_a_second_certificate_of_ml_dsa_may_stay_in_a_file(token):
    """transition: the token has the EC keys, and files the ML-DSA keys."""
    keystore = created(token, "--no-passphrase", profile="transition")
    token.pqsec("issue", "talker", "listener", "--publish", "chatter", "--subscribe", "chatter")
    assert "ML-DSA" in token.pqsec("verify-handshake", "talker", "listener")
    alternative = keystore / "private/identity_ca.alt.key.pem"
    assert b"BEGIN PRIVATE KEY" in alternative.read_bytes()


def test_a_key_that_is_in_the_token_is_used_as_it_is(token):
    as_user = ("--token-label", "lab", "--login", "--pin", PIN)
    token.tool(*as_user, "--keypairgen", "--key-type", "EC:prime256v1", "--label", "identity-ca")
    said = token.pqsec("ca", "init", "--profile", "classical", *BOTH)
    assert f"{IDENTITY} was there already" in said
    assert f"{PERMISSIONS} was generated" in said
    assert token.objects().count("Private Key Object") == 2


@pytest.mark.slow
def test_one_key_for_two_cas_is_refused(token):
    same = ("--identity-key-uri", IDENTITY, "--permissions-key-uri", IDENTITY)
    token.pqsec("ca", "init", "--profile", "classical", *same, exit_code=2)
    assert not (token.folder / "k").exists()
    assert token.objects() == ""


@pytest.mark.slow
def test_a_key_of_another_kind_is_refused_and_what_was_made_is_removed(token):
    as_user = ("--token-label", "lab", "--login", "--pin", PIN)
    token.tool(*as_user, "--keypairgen", "--key-type", "EC:secp384r1", "--label", "permissions-ca")
    said = token.pqsec("ca", "init", "--profile", "classical", *BOTH, exit_code=2)
    assert "is ecdsa-p384, and ecdsa-p256 is needed" in said
    assert token.objects().count("Private Key Object") == 1


@pytest.mark.slow
def test_keys_that_were_made_are_removed_if_the_keystore_is_not(token):
    said = token.pqsec("ca", "init", "--profile", "classical", *BOTH, "--name", "ü", exit_code=2)
    assert "characters" in said
    assert token.objects() == ""


@pytest.mark.slow(but=1)
@pytest.mark.parametrize(
    ("profile", "words"),
    [("hybrid", "no token signs as"), ("pq", "has no keys of this algorithm")],
)
def test_what_a_token_cannot_do_is_refused_when_the_cas_are_made(token, profile, words):
    said = token.pqsec(
        "ca",
        "init",
        "--profile",
        profile,
        *BOTH,
        "--no-passphrase",
        exit_code=(2 if profile == "hybrid" else 3),
    )
    assert words in said
    assert not (token.folder / "k").exists()


def test_a_wrong_pin_is_tried_once(token):
    created(token)
    wrong, log = token.folder / "wrong", token.folder / "spy.log"
    wrong.write_text("not-the-pin\n")
    wrong.chmod(0o600)
    spied = {
        "PQSEC_PKCS11_MODULE": str(SPY),
        "PKCS11SPY": str(token.module),
        "PKCS11SPY_OUTPUT": str(log),
    }
    said = token.pqsec("issue", "talker", exit_code=3, PQSEC_PIN_FILE=str(wrong), **spied)
    assert "wrong PIN for the token 'lab'" in said
    said = token.pqsec("issue", "talker", exit_code=3, PQSEC_PIN_FILE=str(wrong), **spied)
    assert "so the stored one is not tried" in said
    assert len(re.findall(r"^\d+: C_Login$", log.read_text(), re.MULTILINE)) == 1
    token.pqsec("issue", "talker", exit_code=3)
    token.objects()  # a person logs in
    token.pqsec("issue", "talker")


@pytest.mark.slow
def test_many_are_issued_with_one_login(token):
    created(token)
    log = token.folder / "spy.log"
    spied = {"PKCS11SPY": str(token.module), "PKCS11SPY_OUTPUT": str(log)}
    names = [f"r{number}" for number in range(40)]
    token.pqsec("issue", *names, "--publish", "x", PQSEC_PKCS11_MODULE=str(SPY), **spied)
    calls = re.findall(r"^\d+: (C_\w+)$", log.read_text(), re.MULTILINE)
    assert calls.count("C_Login") == 1
    assert calls.count("C_Sign") >= 2 * len(names)


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("given", ["environment", "URI"])
def test_without_a_pin_the_error_says_where_it_can_stand(token, given):
    created(token)
    if given == "environment":
        said = token.pqsec("issue", "talker", exit_code=3, PQSEC_PIN_FILE="")
        assert "PQSEC_PIN_FILE" in said
        assert "pin-source" in said
        return
    uris = [f"{each}2?pin-source=file:{token.pin_file}" for each in (IDENTITY, PERMISSIONS)]
    options = ("--identity-key-uri", uris[0], "--permissions-key-uri", uris[1])
    token.pqsec("ca", "rotate", "--apply", "--yes", *options)
    token.pqsec("issue", "talker", PQSEC_PIN_FILE="")


@pytest.mark.slow
def test_a_token_that_is_away_is_told(token):
    created(token)
    (token.folder / "tokens").rename(token.folder / "elsewhere")
    (token.folder / "tokens").mkdir()
    said = token.pqsec("issue", "talker", exit_code=3)
    assert "the token 'lab' is not there" in said
    (token.folder / "tokens").rmdir()
    (token.folder / "elsewhere").rename(token.folder / "tokens")
    token.pqsec("issue", "talker")


LOST = """
from pqsec_pki.tokens import find_key
key = find_key({uri!r})
key.sign(b"before")
key.handle.login.session.close()
key.sign(b"after")
"""


def test_a_key_is_used_again_after_its_session_was_lost(token):
    created(token)
    uri = f"{IDENTITY}?pin-source=file:{token.pin_file}"
    done = token.run("-c", LOST.format(uri=uri))
    assert done.returncode == 0, done.stderr


SWAPPED = """
import pkcs11
token = pkcs11.lib({module!r}).get_token(token_label="lab")
with token.open(rw=True, user_pin={pin!r}) as session:
    found = {{}}
    for each in session.get_objects({{pkcs11.Attribute.CLASS: pkcs11.ObjectClass.PUBLIC_KEY}}):
        found[each.label] = each
    for label, other in (("identity-ca", "permissions-ca"), ("permissions-ca", "identity-ca")):
        found[label][pkcs11.Attribute.LABEL] = other
"""


def test_a_signature_by_another_key_than_the_public_one_is_refused(token):
    """Public and private key objects are found by their names, which anybody can change."""
    created(token)
    done = token.run("-c", SWAPPED.format(module=str(token.module), pin=PIN))
    assert done.returncode == 0, done.stderr
    said = token.pqsec("ca", "rotate", "--apply", "--yes", *BOTH, exit_code=3)
    assert "another key's signature" in said


def test_a_key_that_is_not_the_certificates_is_refused(token):
    keystore = created(token)
    private = keystore / "private"
    content = (private / "permissions_ca.key.pem").read_bytes()
    (private / "identity_ca.key.pem").write_bytes(content)
    assert "does not match the certificate" in token.pqsec("issue", "talker", exit_code=3)


@pytest.mark.slow
def test_new_keys_follow_into_the_token_or_the_command_refuses(token):
    created(token)
    said = token.pqsec("ca", "rotate", "--apply", "--yes", exit_code=2)
    assert "the new keys would be in files" in said
    second = ("--identity-key-uri", f"{IDENTITY}-2", "--permissions-key-uri", f"{PERMISSIONS}-2")
    token.pqsec("ca", "rotate", "--apply", "--yes", *second, "--destroy-old-keys")
    assert token.objects().count("Private Key Object") == 4, "the old keys stay in the token"
    token.pqsec(
        "ca",
        "rotate",
        "--apply",
        "--yes",
        "--identity-key-uri",
        "file",
        "--permissions-key-uri",
        "file",
        "--no-passphrase",
    )
    assert token.answer("ca", "show")["key_uris"] == {}


@pytest.mark.slow
def test_the_steps_of_an_overlap_use_the_token(token):
    created(token)
    token.pqsec("issue", "talker", "--publish", "chatter")
    begin = ("ca", "rotate", "--apply", "--yes", "--overlap")
    token.pqsec(*begin, "begin", "--identity-key-uri", f"{IDENTITY}-2")
    token.pqsec(*begin, "switch")
    token.pqsec(*begin, "finish")
    uris = token.answer("ca", "show")["key_uris"]
    assert uris["identity_ca.key.pem"] == f"{IDENTITY}-2;type=private"
    token.pqsec("issue", "listener", "--subscribe", "chatter")
    token.pqsec("verify-handshake", "talker", "listener")


# Several sets of credentials


def of_set(name, text=""):
    """The options that put the CA keys of that set into the token."""
    uris = (f"{name}={IDENTITY}{text}", f"{name}={PERMISSIONS}{text}")
    return ("--identity-key-uri", uris[0], "--permissions-key-uri", uris[1])


IN_TOKEN = [("pq,classical", "sets/classical/"), ("classical,hybrid", "")]
"""Profiles of a keystore, and the folder of the set whose CA keys are in the token."""


def works_in_two_sets(token):
    token.pqsec("issue", "talker", "listener", "--publish", "chatter", "--subscribe", "chatter")
    token.pqsec("revoke", "listener", "--yes")
    token.pqsec("renew", "talker")
    token.pqsec("log", "--verify")


@pytest.mark.slow(but=1)
@pytest.mark.parametrize(("profiles", "folder"), IN_TOKEN)
def test_the_ca_keys_of_one_of_two_sets_are_in_a_token(token, profiles, folder):
    options = ("--profile", profiles, *of_set("classical"), "--no-passphrase")
    token.pqsec("ca", "init", *options)
    private = token.folder / f"k/{folder}private"
    for name in ("identity_ca.key.pem", "permissions_ca.key.pem"):
        assert "PRIVATE KEY" not in (private / name).read_text()
    assert token.objects().count("Private Key Object") == 2
    shown = token.answer("ca", "show")
    both = [shown, *shown["further"]]
    assert {each["profile"]: len(each["key_uris"]) for each in both}["classical"] == 2
    assert sum(len(each["key_uris"]) for each in both) == 2
    works_in_two_sets(token)


def test_a_uri_says_for_which_set_it_is_and_each_key_has_its_own(token):
    two = ("ca", "init", "--profile", "pq,classical", "--no-passphrase")
    said = token.pqsec(*two, *BOTH, exit_code=2)
    assert "does not say for which set it is: pq, classical" in said
    said = token.pqsec(*two, "--identity-key-uri", f"hybrid={IDENTITY}", exit_code=2)
    assert "does not say for which set it is" in said
    again = ("--identity-key-uri", f"classical={IDENTITY}")
    said = token.pqsec(*two, *again, *again, exit_code=2)
    assert "there are two places for one key" in said
    same = ("--permissions-key-uri", f"classical={IDENTITY}")
    assert "one key is named twice" in token.pqsec(*two, *again, *same, exit_code=2)
    assert not (token.folder / "k").exists()
    assert "Private Key Object" not in token.objects()


def test_a_set_with_ca_keys_in_a_token_is_added_rotated_and_removed(token):
    token.pqsec("ca", "init", "--profile", "pq", "--no-passphrase")
    token.pqsec("issue", "camera", "--publish", "image")
    token.pqsec("ca", "add-set", "classical", *BOTH)
    works_in_two_sets(token)
    rotate = ("ca", "rotate", "--set", "classical", "--apply", "--yes")
    assert "the new keys would be in files" in token.pqsec(*rotate, exit_code=2)
    second = ("--identity-key-uri", f"{IDENTITY}-2", "--permissions-key-uri", f"{PERMISSIONS}-2")
    token.pqsec(*rotate, *second)
    token.pqsec("ca", "rotate", "--set", "pq", "--apply", "--yes", "--no-passphrase")
    token.pqsec(*rotate[:4], "--overlap", "begin", "--apply", "--identity-key-uri", f"{IDENTITY}-3")
    token.pqsec(*rotate[:4], "--overlap", "switch", "--apply")
    token.pqsec(*rotate[:4], "--overlap", "finish", "--apply", "--yes")
    token.pqsec("log", "--verify")
    said = token.pqsec("ca", "remove-set", "classical", "--yes")
    assert f"{IDENTITY}-3;type=private is still there" in said
    assert f"{PERMISSIONS}-2;type=private is still there" in said
    token.pqsec("renew", "talker")


def test_key_files_beside_keys_in_tokens_have_a_passphrase_unless_it_is_said(token):
    created(token)
    assert "need a passphrase" in token.pqsec("ca", "add-set", "pq", exit_code=2)
    token.pqsec("ca", "add-set", "pq", "--no-passphrase")
    said = token.pqsec("ca", "rotate", "--set", "pq", "--apply", "--yes", exit_code=2)
    assert "need a passphrase" in said
    token.pqsec("ca", "rotate", "--set", "pq", "--apply", "--yes", "--no-passphrase")
    said = token.pqsec("ca", "add-set", "hybrid", "--no-passphrase", exit_code=2)
    assert "have one passphrase" in said


def test_inspect_says_which_key_a_file_refers_to(token):
    created(token)
    [found] = token.answer("inspect", "k/private/identity_ca.key.pem")["files"]
    assert found["kind"] == "key reference"
    assert found["uri"] == f"{IDENTITY};type=private"


def test_check_finds_nothing_wrong_with_a_keystore_on_a_token(token):
    created(token)
    token.pqsec("issue", "talker", "--publish", "chatter")
    said = token.pqsec("check")
    assert "PQS707" not in said, "no key is unencrypted"


@pytest.mark.skipif(not LONG, reason="in .ci/long: only Debian sid has a token with ML-DSA")
def test_a_token_with_ml_dsa_has_the_cas_of_the_pq_profile(requires, openssl35, tmp_path):
    sid = os.environ.get("PQSEC_SID")
    token = Token.ml_dsa(tmp_path, Path(requires(sid, "Debian sid", "run .ci/sid")))
    keystore = created(token, profile="pq")
    token.pqsec("issue", "talker", "listener", "--publish", "chatter", "--subscribe", "chatter")
    token.pqsec("revoke", "listener", "--yes")

    private = token.objects().split("Private Key Object")[1:]
    assert len(private) == 2
    assert all("never extractable" in each for each in private)
    ca, talker = keystore / "public/identity_ca.cert.pem", keystore / "enclaves/talker"
    openssl35("verify", "-CAfile", ca, talker / "cert.pem")
    openssl35("crl", "-in", keystore / "public/identity_ca.crl.pem", "-CAfile", ca, "-noout")
    signer = ("-CAfile", keystore / "public/permissions_ca.cert.pem")
    certificate = ("-certfile", keystore / "public/permissions_ca.cert.pem")
    openssl35("cms", "-verify", "-in", talker / "permissions.p7s", *signer, *certificate)


def test_a_plan_is_proposed_and_approved_with_keys_in_a_token(token):
    as_user = ("--token-label", "lab", "--login", "--pin", PIN)
    approvers = {}
    for name in ("alice", "bob"):
        key = ("--key-type", "EC:prime256v1", "--label", name)
        token.tool(*as_user, "--keypairgen", *key)
        place = token.folder / f"{name}.der"
        read = ("--read-object", "--type", "pubkey", "--label", name, "-o", str(place))
        token.tool(*as_user, *read)
        (token.folder / f"{name}.pub.pem").write_bytes(pem("PUBLIC KEY", place.read_bytes()))
        approvers[name] = f"{name}.pub.pem"
    of = ", ".join(f"{name}: {file}" for name, file in approvers.items())
    text = f"profile: classical\nprune: true\napprovals: {{required: 2, of: {{{of}}}}}\n"
    robot = "participants: [{name: /a, rules: [{allow: {publish: [rt/a]}}]}]\n"
    (token.folder / "domain.yaml").write_text(text + robot)
    token.pqsec("apply", "--yes", "--no-passphrase")
    (token.folder / "domain.yaml").write_text(text)
    token.pqsec("apply", "--yes", "--revoke-most", exit_code=3)
    proposed = ("plan", "-o", "plan.json", "--key", "pkcs11:token=lab;object=alice")
    token.pqsec(*proposed)
    token.pqsec("apply", "plan.json", "--yes", "--revoke-most", exit_code=1)
    token.pqsec("approve", "plan.json", "--key", "pkcs11:token=lab;object=bob", "--yes")
    token.pqsec("apply", "plan.json", "--yes", "--revoke-most")
    assert "approved by alice, bob" in token.pqsec("log")
    assert PIN not in (token.folder / "plan.json").read_text()
