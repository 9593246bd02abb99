"""pqsec ca: two CAs that are never one, their keys, and what is refused before they exist."""

import json
import os
import pty
import re
import sys
from base64 import b64decode
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from pqsec_pki.algorithms import PROFILES
from pqsec_pki.certificates import Certificate
from tests.cli.conftest import NAMES, Result, clean_environment, secret, snapshot
from tests.interop.der import Der

PBES2 = bytes.fromhex("06092a864886f70d01050d")
PBKDF2 = bytes.fromhex("06092a864886f70d01050c")
FLOOR = 600_000


def certificate(path):
    return Certificate.from_pem(path.read_bytes())


def key_der(path):
    label, text = re.fullmatch(
        r"-----BEGIN ([A-Z ]+)-----\n(.*)-----END \1-----\n", path.read_text(), re.DOTALL
    ).groups()
    return label, Der(b64decode(text))


def iterations(path):
    """The PBKDF2 iterations of an encrypted PKCS#8 file, read out of its DER."""
    label, der = key_der(path)
    assert label == "ENCRYPTED PRIVATE KEY"
    scheme, parameters = der.parts[0].parts
    assert scheme == PBES2
    derivation, settings = parameters.parts[0].parts
    assert derivation == PBKDF2
    return int.from_bytes(settings.parts[1].content, "big")


def modes(folder):
    return {p.name: p.lstat().st_mode & 0o777 for p in folder.iterdir() if not p.is_symlink()}


@pytest.mark.parametrize("profile", NAMES)
def test_the_two_cas_share_neither_name_nor_key_nor_file(domains, profile):
    keystore = domains(profile)
    cas = [certificate(path) for path in sorted((keystore / "public").glob("*.pem"))]
    assert len(cas) >= 2
    assert len({ca.subject_name for ca in cas}) == len(cas)
    assert len({ca.spki for ca in cas}) == len(cas)
    assert len({ca.serial_number for ca in cas}) == len(cas)
    keys = [path.read_bytes() for path in (keystore / "private").glob("*.key.pem")]
    assert len(keys) >= 2
    assert len(set(keys)) == len(keys)


@pytest.mark.parametrize("profile", NAMES)
def test_a_new_keystore_has_a_governance_its_permissions_ca_signed(domains, run_in, profile):
    keystore = domains(profile)
    signed = run_in(keystore, "-k . verify enclaves/governance.p7s --json").done().json
    assert signed["signer"] == "CN=Permissions CA"
    governance = (keystore / "enclaves/governance.xml").read_text()
    assert "<allow_unauthenticated_participants>false<" in governance
    assert "<enable_join_access_control>true<" in governance
    assert "NONE" not in governance


def test_the_default_profile_is_transition(pqsec, tmp_path):
    pqsec("-k k ca init --no-passphrase").done()
    shown = pqsec("-k k ca show --json").done().json
    assert shown["profile"] == "transition"
    assert [ca["role"] for ca in shown["cas"]] == ["identity CA", "permissions CA", "countersigner"]


def test_names_begin_with_what_is_given(pqsec):
    pqsec("-k k ca init --no-passphrase --profile classical", "--name", "Ship 1").done()
    subjects = [ca["subject"] for ca in pqsec("-k k --json ca show").json["cas"]]
    assert subjects == ["CN=Ship 1 Identity CA", "CN=Ship 1 Permissions CA"]


@pytest.mark.parametrize("name", ["x" * 60, "a=b", "né", "a,b", "a\nb"])
def test_a_name_no_certificate_can_carry_is_refused(pqsec, tmp_path, name):
    pqsec("-k k ca init --no-passphrase --name", name).refused(2)
    assert not (tmp_path / "k").exists()


def test_modes_hold_under_any_umask(pqsec, tmp_path):
    before = os.umask(0)
    try:
        pqsec("-k k ca init --no-passphrase").done()
    finally:
        os.umask(before)
    folders = {"private": 0o700, "public": 0o755, "enclaves": 0o755}
    assert modes(tmp_path / "k") == folders | {"pqsec.json": 0o644, ".gitignore": 0o644}
    assert set(modes(tmp_path / "k/private").values()) == {0o600}
    assert modes(tmp_path / "k/private")["ledger.sqlite3"] == 0o600
    keys = {k: v for k, v in modes(tmp_path / "k/private").items() if k.endswith(".pem")}
    assert set(keys.values()) == {0o600}
    assert len(keys) == 4
    assert set(modes(tmp_path / "k/public").values()) == {0o644}


# How the keys are protected


@pytest.mark.usefixtures("all_iterations")
@pytest.mark.parametrize(("profile", "keys"), [("transition", 4), ("hybrid", 2)])
def test_every_ca_key_is_encrypted_under_the_passphrase(pqsec, tmp_path, profile, keys):
    secret(tmp_path / "passphrase", "open sesame, please\r\nsecond line\n")
    said = pqsec(f"-k k ca init --profile {profile} --passphrase-file passphrase").done()
    assert said.err == ""
    files = sorted((tmp_path / "k/private").glob("*.key.pem"))
    assert len(files) == keys
    assert all(iterations(file) >= FLOOR for file in files)
    assert pqsec("-k k ca show --json").json["keys"] == "encrypted"
    secret(tmp_path / "first line", "open sesame, please")
    pqsec("-k k issue /a --publish x --passphrase-file", "first line").done()


def test_the_passphrase_file_can_be_named_in_the_environment(pqsec, locked):
    pqsec("-k k issue /a --publish x", PQSEC_PASSPHRASE_FILE="right").done()
    pqsec("-k k issue /b --publish x", PQSEC_PASSPHRASE_FILE="wrong").refused(3, "passphrase")


def test_keys_are_unencrypted_only_when_asked_and_then_it_is_said(pqsec, tmp_path):
    said = pqsec("-k k ca init --profile pq --no-passphrase --json").done()
    assert said.json["keys"] == "not encrypted"
    assert "pqsec: note: the CA keys in k/private are not encrypted" in said.err
    assert key_der(tmp_path / "k/private/identity_ca.key.pem")[0] == "PRIVATE KEY"


def test_without_terminal_and_choice_nothing_is_made(process, tmp_path):
    said = process("-k k ca init")
    said.refused(2, "no terminal", hint="--passphrase-file FILE, or --no-passphrase")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("content", "code"), [(b"", 3), (b"\n", 3), (b"\r\nx\n", 3), (b"x" * 5000, 3), (None, 3)]
)
def test_a_passphrase_file_without_passphrase_makes_nothing(pqsec, tmp_path, content, code):
    if content is not None:
        secret(tmp_path / "passphrase", content)
    pqsec("-k k ca init --passphrase-file passphrase").refused(code, "passphrase: ")
    assert not (tmp_path / "k").exists()


def test_a_passphrase_and_none_exclude_each_other(pqsec, tmp_path):
    secret(tmp_path / "passphrase", "open sesame, please\n")
    pqsec("-k k ca init --no-passphrase --passphrase-file passphrase").refused(2, "exclude")
    assert not (tmp_path / "k").exists()


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o644])
def test_a_passphrase_file_that_others_can_open_is_noted_and_used(pqsec, locked, tmp_path, mode):
    (tmp_path / "right").chmod(mode)
    said = pqsec("-k k issue /a --publish x --passphrase-file right").done()
    assert said.err == "pqsec: note: right can be read by others: chmod 600 it\n"
    new = pqsec("-k new ca init --profile classical", PQSEC_PASSPHRASE_FILE="right").done()
    assert new.err == said.err
    (tmp_path / "right").chmod(0o400)
    assert pqsec("-k k issue /b --publish x --passphrase-file right").done().err == ""


@pytest.mark.parametrize(
    ("name", "code"), [("x" * 300, 3), ("k/pqsec.json/x", 3), ("k", 2), ("", 2)]
)
def test_a_passphrase_file_that_cannot_be_is_refused(pqsec, locked, tmp_path, name, code):
    for line in ("-k new ca init", "-k k issue /a"):
        pqsec(f"{line} --passphrase-file", name).refused(code)
    assert not (tmp_path / "new").exists()
    assert not (locked / "enclaves/a").exists()


def at_terminal(folder: Path, line: str, *answers: bytes) -> Result:
    """`pqsec line` at a terminal of its own, without colours, stdout to a file; each prompt gets an
    answer."""
    out = folder / "out"
    command = [sys.executable, "-m", "pqsec_pki", *line.split()]
    environment = {**clean_environment(), "NO_COLOR": "1"}
    child, terminal = pty.fork()
    if child == 0:
        os.chdir(folder)
        os.dup2(os.open(out, os.O_WRONLY | os.O_CREAT), 1)
        os.execve(sys.executable, command, environment)  # noqa: S606 -- no shell wanted
    screen, left = b"", list(answers)
    with suppress(OSError):  # EIO: the other side closed
        while chunk := os.read(terminal, 1024):
            screen += chunk
            if left and screen.endswith(b": "):
                os.write(terminal, left.pop(0))
    os.close(terminal)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    result = Result(code, out.read_text(), screen.decode())
    out.unlink()
    assert not left, result
    return result


def test_a_terminal_is_asked_twice_and_shows_no_passphrase(tmp_path, pqsec):
    said = at_terminal(
        tmp_path,
        "-k k ca init --profile classical --json",
        b"open sesame, please\n",
        b"open sesame, please\n",
    )
    assert said.code == 0
    assert json.loads(said.out)["keys"] == "encrypted"
    assert "New CA passphrase: " in said.err
    assert "sesame" not in said.err
    again = at_terminal(tmp_path, "-k k issue /a --publish x", b"open sesame, please\n")
    assert again.code == 0
    assert again.out.startswith("/a ")
    assert "CA passphrase: " in again.err


def test_a_mismatch_at_the_terminal_is_said_and_asked_again(tmp_path):
    answers = (
        b"open sesame, please\n",
        b"open barley, please\n",
        b"open rye, if you please\n",
        b"open rye, if you please\n",
    )
    said = at_terminal(tmp_path, "-k k ca init --profile classical", *answers)
    assert said.code == 0
    assert "do not match" in said.err
    secret(tmp_path / "passphrase", "open rye, if you please\n")
    line = "-k k issue /a --publish x --passphrase-file passphrase"
    assert at_terminal(tmp_path, line).code == 0


@pytest.mark.parametrize(
    ("answers", "what"),
    [((b"\x03",), "ctrl-c"), ((b"\x04",), "end of input"), ((b"open\n", b"\x03"), "then ctrl-c")],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_giving_up_at_the_prompt_ends_with_130_and_makes_nothing(tmp_path, answers, what):
    said = at_terminal(tmp_path, "-k k ca init", *answers)
    assert said.code == 130
    assert said.out == ""
    assert "pqsec: error: interrupted" in said.err
    assert "Traceback" not in said.err
    assert not (tmp_path / "k").exists()


def test_a_wrong_passphrase_at_the_terminal_is_refused(tmp_path, locked):
    before = snapshot(locked)
    said = at_terminal(tmp_path, "-k k issue /a --publish x", b"open barley, please\n")
    assert said.code == 3
    assert "pqsec: error: " in said.err
    assert "wrong passphrase" in said.err
    assert snapshot(locked) == before


# What stands is never overwritten


def test_a_second_init_is_refused_and_changes_nothing(pqsec, keystore):
    k = keystore()
    before = snapshot(k)
    said = pqsec("-k k ca init --no-passphrase --profile pq")
    hint = "CA keys are never overwritten: choose another folder"
    said.refused(3, "k already has pqsec.json, private, public, enclaves", hint=hint)
    assert snapshot(k) == before


def test_a_second_init_is_refused_before_a_passphrase_is_needed(process, keystore):
    keystore()
    process("-k k ca init").refused(3, "k already has")


@pytest.mark.parametrize("part", ["private", "public", "enclaves"])
def test_a_folder_with_part_of_a_keystore_is_left_alone(pqsec, tmp_path, part):
    (tmp_path / "k" / part).mkdir(parents=True)
    (tmp_path / "k" / part / "mine").write_text("x")
    pqsec("-k k ca init --no-passphrase").refused(3, f"k already has {part}")
    assert list(snapshot(tmp_path / "k")) == [f"{part}/mine"]


def test_init_has_no_force(pqsec, keystore):
    keystore()
    pqsec("-k k ca init --no-passphrase --force").refused(2, "--force")


def test_a_keystore_may_be_made_beside_other_files(pqsec, tmp_path):
    (tmp_path / "README").write_text("mine")
    pqsec("-k . ca init --no-passphrase --profile classical").done()
    assert (tmp_path / "README").read_text() == "mine"


def test_a_keystore_where_a_file_is_is_refused(pqsec, tmp_path):
    (tmp_path / "k").write_text("mine")
    pqsec("-k k ca init --no-passphrase").refused(2, "k")
    pqsec("-k k/below ca init --no-passphrase").refused(3, "not a directory")
    assert (tmp_path / "k").read_text() == "mine"


# Profiles and overrides

KEPT = [
    ("transition", "--kem mlkem1024"),
    ("transition", "--alt-key ml-dsa-87"),
    ("transition", "--permissions-key ecdsa-p384"),
    ("transition", "--participant-key rsa-2048"),
    ("hybrid", "--kem secp256r1mlkem768"),
    ("hybrid", "--identity-key mldsa44+p256 --participant-key mldsa65+ed25519"),
    ("hybrid", "--permissions-key mldsa87+p384"),
    ("pq", "--kem x25519mlkem768"),
    ("pq", "--identity-key ml-dsa-87 --permissions-key mldsa65+p256 --participant-key ml-dsa-44"),
    ("cnsa2", "--kem mlkem1024 --identity-key mldsa87"),
    ("classical", "--kem dh-modp-2048-256"),
    ("classical", "--permissions-key p384"),
]

STOCK = "stock stacks"
SECOND = "ML-DSA signature"
NO_SECOND = "no alternative key"
RECORDED = "recorded traffic"
QUANTUM = "withstands a quantum computer"
EITHER = "is secure while either half is"
CNSA2 = "CNSA 2.0"
BROKEN = [
    ("transition", "--identity-key ml-dsa-65", STOCK),
    ("transition", "--identity-key ecdsa-p384", STOCK),
    ("transition", "--participant-key mldsa65+p256", STOCK),
    ("transition", "--permissions-key ml-dsa-65", STOCK),
    ("transition", "--alt-key ecdsa-p256", SECOND),
    ("transition", "--kem ecdh-p256", RECORDED),
    ("transition", "--kem dh-modp-2048-256", RECORDED),
    ("hybrid", "--identity-key ml-dsa-65", EITHER),
    ("hybrid", "--participant-key ecdsa-p256", EITHER),
    ("hybrid", "--permissions-key rsa-3072", EITHER),
    ("hybrid", "--alt-key ml-dsa-65", NO_SECOND),
    ("hybrid", "--kem mlkem768", EITHER),
    ("hybrid", "--kem ecdh-p384", EITHER),
    ("pq", "--identity-key ecdsa-p256", QUANTUM),
    ("pq", "--permissions-key rsa-4096", QUANTUM),
    ("pq", "--participant-key ecdsa-p384", QUANTUM),
    ("pq", "--alt-key ml-dsa-65", NO_SECOND),
    ("pq", "--kem ecdh-p256", QUANTUM),
    ("cnsa2", "--identity-key ml-dsa-65", CNSA2),
    ("cnsa2", "--permissions-key mldsa87+p384", CNSA2),
    ("cnsa2", "--participant-key ml-dsa-44", CNSA2),
    ("cnsa2", "--alt-key ml-dsa-87", NO_SECOND),
    ("cnsa2", "--kem mlkem768", CNSA2),
    ("cnsa2", "--kem secp384r1mlkem1024", CNSA2),
    ("classical", "--identity-key ml-dsa-65", STOCK),
    ("classical", "--alt-key ml-dsa-65", NO_SECOND),
    ("classical", "--kem mlkem768", "one that stock stacks run"),
    ("classical", "--kem ecdh-p384", "one that stock stacks run"),
]


@pytest.mark.parametrize(("profile", "options"), KEPT, ids=lambda text: text)
def test_an_override_that_keeps_the_promises_makes_a_domain_that_works(
    make_domain, pqsec, tmp_path, profile, options
):
    make_domain(tmp_path, f"--no-passphrase --profile {profile} {options}")
    report = pqsec("-k k verify-handshake /talker /listener --json").done().json
    assert report["ok"] is True
    assert pqsec("-k k ca show --json").json["profile"] == profile


@pytest.mark.parametrize(("profile", "options", "promise"), BROKEN, ids=lambda text: text)
def test_an_override_that_breaks_a_promise_is_refused_with_it(
    pqsec, tmp_path, profile, options, promise
):
    said = pqsec(f"-k k ca init --no-passphrase --profile {profile} {options}")
    said.refused(2, f"profile {profile} promises", promise, hint="pqsec profiles")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("option", "kind"),
    [
        ("--identity-key", "signature algorithm"),
        ("--permissions-key", "signature algorithm"),
        ("--participant-key", "signature algorithm"),
        ("--alt-key", "signature algorithm"),
        ("--kem", "key agreement"),
    ],
)
@pytest.mark.parametrize("name", ["", "kyber768", "x" * 9999, "é"])
def test_an_unknown_algorithm_is_refused_with_those_there_are(pqsec, tmp_path, option, kind, name):
    said = pqsec("-k k ca init --no-passphrase", option, name)
    said.refused(2, f"no {kind} named", hint="known: ")
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_profile_is_refused_with_those_there_are(pqsec, tmp_path):
    pqsec("-k k ca init --no-passphrase --profile quantum").refused(2, *NAMES)
    assert list(tmp_path.iterdir()) == []


# Which keystore is meant


def test_the_option_goes_before_pqsecs_variable_and_that_before_ros(pqsec, keystore):
    for name, profile in (("ros", "classical"), ("variable", "pq"), ("option", "cnsa2")):
        keystore(profile, name)
    ros = {"ROS_SECURITY_KEYSTORE": "ros"}
    both = ros | {"PQSEC_KEYSTORE": "variable"}
    assert pqsec("ca show --json", **ros).json["profile"] == "classical"
    assert pqsec("ca show --json", **both).json["profile"] == "pq"
    assert pqsec("-k option ca show --json", **both).json["profile"] == "cnsa2"
    assert pqsec("ca show --json", **ros, PQSEC_KEYSTORE="").json["profile"] == "classical"


@pytest.mark.parametrize(
    "line",
    [
        "-k k --json ca show",
        "--json ca -k k show",
        "ca --json show -k k",
        "ca show --json -k k",
        "--keystore=k ca show --json",
        "-k elsewhere ca show -k k --json",
    ],
)
def test_keystore_and_json_are_taken_anywhere(pqsec, keystore, line):
    keystore()
    assert pqsec(line).done().json["keystore"] == "k"


def test_no_keystore_named_is_said_with_the_ways_to_name_one(pqsec, tmp_path):
    for line in ("ca init --no-passphrase", "ca show", "issue /a", "verify-handshake a b"):
        pqsec(line).refused(2, "no keystore named", hint="-k DIR, or set PQSEC_KEYSTORE")
    assert list(tmp_path.iterdir()) == []


# Domains and validity


@pytest.mark.parametrize(
    ("text", "xml"),
    [
        ("5", "<id>5</id>"),
        ("0-3", "<min>0</min><max>3</max>"),
        ("1,7-9", "<id>1</id><id_range><min>7</min><max>9</max>"),
        ("230", "<id>230</id>"),
    ],
)
def test_the_governance_and_participants_are_for_the_domains_named(pqsec, tmp_path, text, xml):
    pqsec("-k k ca init --no-passphrase --profile classical --domain", text).done()
    governance = (tmp_path / "k/enclaves/governance.xml").read_text()
    assert xml in re.sub(r"\s+", "", governance)
    assert pqsec("-k k ca show --json").json["domains"] == text
    said = pqsec("-k k issue /a --publish x").done()
    assert said.err == ""
    assert xml in re.sub(r"\s+", "", (tmp_path / "k/enclaves/a/permissions.xml").read_text())


@pytest.mark.parametrize("text", ["231", "-1", "x", "", "3-1", "0,", "0-231", "5-", "9" * 99, "٣"])
def test_domains_that_are_none_are_refused(pqsec, tmp_path, text):
    pqsec("-k k ca init --no-passphrase", f"--domain={text}").refused(2)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "text", ["0y", "-1y", "10", "y", "1.5y", "1 y", "", "10m", "1y6w", "9999999d", "٣y"]
)
def test_a_validity_that_is_none_is_refused_with_examples(pqsec, tmp_path, text):
    said = pqsec("-k k ca init --no-passphrase", f"--validity={text}")
    said.refused(2, "--validity", "is not a duration: write 10y")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("text", ["300y", "999999y"])
def test_a_validity_no_stack_can_represent_is_refused(pqsec, tmp_path, text):
    said = pqsec("-k k ca init --no-passphrase --validity", text)
    said.refused(2, "beyond 2261", hint="shorter --validity")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "span"),
    [("12h", timedelta(hours=12)), ("2w", timedelta(days=14)), ("3y", timedelta(days=1095))],
)
def test_both_cas_end_after_the_validity(pqsec, text, span):
    pqsec("-k k ca init --no-passphrase --profile classical --validity", text).done()
    for ca in pqsec("-k k ca show --json").json["cas"]:
        left = datetime.fromisoformat(ca["not_after"]) - datetime.now(UTC)
        assert span - timedelta(minutes=5) < left <= span


# ca show


@pytest.mark.parametrize("profile", PROFILES, ids=lambda profile: profile.name)
def test_show_tells_the_profile_in_words(pqsec, keystore, profile):
    keystore(profile.name)
    first = pqsec("-k k ca show").done().out.splitlines()[0]
    assert first == f"keystore       k (profile {profile.name}: {profile.summary})"


def test_show_tells_a_person_what_is_there(pqsec, keystore):
    keystore("transition")
    lines = pqsec("-k k ca show").done().out
    for words in (
        "keystore       k (profile transition: runs in stock stacks, with ML-DSA signatures",
        "identity CA    CN=Identity CA, ecdsa-p256 and ml-dsa-65",
        "permissions CA CN=Permissions CA, ecdsa-p256\n",
        "domain         0",
        "CA keys        not encrypted",
        "participants   /listener, /talker",
    ):
        assert words in lines


def test_show_in_json_names_the_certificates_that_lie_there(pqsec, keystore):
    k = keystore("pq")
    shown = pqsec("-k k ca show --json").done().json
    for ca, file in zip(shown["cas"], ["identity_ca", "permissions_ca"], strict=True):
        there = certificate(k / f"public/{file}.cert.pem")
        assert ca["sha256"] == there.fingerprint
        assert ca["subject"] == there.subject_name
        assert ca["algorithm"] == "ml-dsa-65"
        assert datetime.fromisoformat(ca["not_after"]) == there.not_after
    assert shown["participants"] == ["/listener", "/talker"]
    assert shown["key_agreement"] == "mlkem768"


def test_show_of_an_empty_keystore_says_how_to_go_on(pqsec, locked):
    said = pqsec("-k k ca show").done()
    assert "participants   none yet: pqsec issue NAME" in said.out
    assert "CA keys        encrypted" in said.out


def test_show_needs_no_sight_of_the_keys(pqsec, keystore):
    """Who only looks may not be let in; a link to itself is closed even to root."""
    key = keystore() / "private/identity_ca.key.pem"
    key.unlink()
    key.symlink_to(key.name)
    words = (
        "those of the identity CA not readable from here, those of the permissions CA not encrypted"
    )
    assert f"\nCA keys        {words}\n" in pqsec("-k k ca show").done().out
    shown = pqsec("-k k ca show --json").done().json
    assert shown["keys"] == words
    assert "locked" not in shown


def test_show_says_what_is_no_keystore(pqsec, tmp_path):
    pqsec("-k k ca show").refused(3, "k does not exist", hint="`pqsec -k k ca init`")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"[]", b"null", b"\xff", b'{"format": 1}', b'{"format": 2}', b"[" * 99999],
    ids=["empty", "cut", "list", "null", "binary", "no algorithms", "newer", "deep"],
)
def test_settings_that_are_none_are_said(pqsec, keystore, content):
    (keystore() / "pqsec.json").write_bytes(content)
    pqsec("-k k ca show").refused(3, "k/pqsec.json")


@pytest.mark.parametrize(
    ("field", "name"),
    [
        ("alternative_key", "ecdsa-p256"),
        ("participant_key", "p384"),
        ("key_agreement", "ecdh-p256"),
    ],
)
def test_settings_altered_to_break_the_profiles_promise_are_refused(pqsec, keystore, field, name):
    k = keystore("transition")
    settings = json.loads((k / "pqsec.json").read_text())
    settings["algorithms"][0][field] = name
    (k / "pqsec.json").write_text(json.dumps(settings))
    pqsec("-k k issue /c --publish x").refused(3, "k/pqsec.json", "promises")
    assert not (k / "enclaves/c").exists()


# CA keys that are kept elsewhere

WITHOUT_KEYS = {
    "status": 0,
    "log --verify": 0,
    "needs-renewal": 1,
    "check k": 0,
    "who-may": 0,
    "report": 0,
    "diff k k": 0,
    "ca show": 0,
    "explain --participant /talker --publish rt/chatter": 0,
    "verify-handshake /talker /listener": 0,
    "verify-handshake --all": 0,
    "bundle /talker --plain-key -o b": 0,
    "export cyclonedds /talker": 0,
}
WITH_KEYS = (
    "issue /new",
    "renew /talker",
    "revoke /talker --yes",
    "ca crl",
    "sign-governance k/enclaves/governance.xml -o g.p7s",
)


@pytest.mark.parametrize("profile", ["classical", "transition"])
def test_a_ca_key_that_is_not_here_is_told_with_the_way_out(pqsec, keystore, tmp_path, profile):
    k = keystore(profile)
    safe = tmp_path / "safe"
    safe.mkdir()
    for key in (k / "private").glob("*.key.pem"):
        key.rename(safe / key.name)
    found = {}
    for line, code in WITHOUT_KEYS.items():
        said = pqsec(f"-k k {line}")
        if said.code != code:
            found[line] = said
    for line in WITH_KEYS:
        said = pqsec(f"-k k {line}")
        ca = "permissions" if line.startswith("sign-governance") else "identity"
        words = ("is not here", f"k/private/{ca}_ca.key.pem", "sign-request", "need no CA key")
        if said.code != 3 or not all(word in said.err for word in words):
            found[line] = said
    assert not found, found
    assert "not here" in pqsec("-k k ca show").out
    for key in safe.iterdir():
        key.rename(k / "private" / key.name)
    pqsec("-k k issue /new").done()
