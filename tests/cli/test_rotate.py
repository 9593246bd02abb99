"""ca rotate, ca passphrase and adopt, as their users run them."""

import os
import pty
import subprocess
import sys
from contextlib import suppress

import pytest

from tests.cli.conftest import clean_environment, snapshot
from tests.unit.sros2_keystore import SROS2


@pytest.fixture
def k(keystore):
    return keystore("classical")


@pytest.fixture
def secret(tmp_path):
    """secret("a") is the name of a file with a passphrase that begins with that."""

    def write(text):
        path = tmp_path / f"{text}.txt"
        path.write_text(f"{text} for a keystore\n")
        path.chmod(0o600)
        return path.name

    return write


# ca rotate


@pytest.mark.parametrize("option", ["", "--plan"])
def test_a_plan_changes_nothing_and_tells_all(pqsec, k, option):
    before = snapshot(k)
    told = pqsec(f"-k k ca rotate --profile pq {option}").done().out
    assert snapshot(k) == before
    assert told.startswith("generation 2: identity CA and permissions CA, from profile classical")
    for words in (
        "create an identity CA (ml-dsa-65)",
        "reissue 2 participants with new keys",
        "keep the old CAs in k/private/generations/1",
        "runs in no stock stack today",
        "Change to `--profile transition` first",
        "Fast DDS 2.9.1, 3.1.2: both certificates in the file identity_ca,",
    ):
        assert words in told


def test_a_plan_is_about_what_is_asked_for(pqsec, k):
    pqsec("-k k revoke /talker --yes")
    told = pqsec("-k k ca rotate --only identity --destroy-old-keys").done().out
    assert "create a permissions CA" not in told
    assert "permissions CAs: none" not in told
    assert "reissue 1 participant with the same keys" in told
    assert "do not reissue /talker: revoked" in told
    assert "issue an empty revocation list" in told
    assert "destroy the old keys" in told
    value = pqsec("-k k ca rotate --json --rekey").done().json
    assert value["rekeyed"] == ["/listener"]
    assert value["keeping"] == []
    assert value["left_out"] == {"/talker": "revoked"}
    assert value["profile"] == {"before": "classical", "after": "classical"}


def test_a_domain_goes_from_classical_by_transition_to_pq(pqsec, k):
    for number, profile in ((2, "transition"), (3, "pq")):
        done = pqsec(f"-k k ca rotate --apply --yes --profile {profile} --no-passphrase").done()
        assert f"generation {number}: " in done.out
        assert f"generation {number - 1} is in k/private/generations/{number - 1}" in done.out
        assert "2 participants reissued" in done.out
        pqsec("-k k verify-handshake /talker /listener").done()
        assert pqsec("-k k check").code == 0
        pqsec("-k k log --verify").done()
        assert f"profile {profile}" in pqsec("-k k ca show").done().out
    pqsec("-k k issue /new --publish x").done()


def test_who_stays_behind_is_told(pqsec, k):
    pqsec("-k k revoke /talker --yes")
    plan = pqsec("-k k ca rotate").done().out
    assert "reissue the participants" not in plan  # nobody should, if it was stolen
    done = pqsec("-k k ca rotate --apply --yes --no-passphrase --json").done()
    assert "note: /talker is not reissued: revoked" in done.err
    assert done.json["left_out"] == {"/talker": "revoked"}
    assert done.json["new_list"]
    assert pqsec("-k k verify-handshake /listener /talker").code == 1


def test_who_stays_behind_for_its_key_is_not_in_the_way_of_others(pqsec, k):
    (k / "enclaves/talker/key.pem").unlink()
    done = pqsec("-k k ca rotate --apply --yes --no-passphrase --profile pq").done()
    assert "next: reissue the participants that were left out: /talker" in done.out
    assert "1 previous-ca, 1 valid" in pqsec("-k k status").done().out
    renewed = pqsec("-k k renew --all --json").done().json["issued"]
    assert [each["name"] for each in renewed] == ["/listener"]
    pqsec("-k k renew /talker").refused(3, "issued by a CA that has been replaced", hint="--csr")


def test_new_cas_have_the_passphrase_that_is_given(pqsec, k, secret):
    pqsec("-k k ca rotate --apply --yes").refused(2, "need a passphrase", hint="--passphrase-file")
    pqsec("-k k ca rotate --apply --yes", "--passphrase-file", secret("one")).done()
    assert "encrypted" in pqsec("-k k ca show").out
    pqsec("-k k issue /new").refused(2, "the CA keys are encrypted")
    pqsec("-k k issue /new --passphrase-file one.txt").done()
    # One CA stays: its passphrase is needed, and is that of the new one too.
    line = "-k k ca rotate --apply --yes --only permissions --passphrase-file"
    pqsec(line, secret("wrong")).refused(3, hint="give the CA passphrase")
    pqsec(line, "one.txt").done()
    pqsec("-k k issue /newer --passphrase-file one.txt").done()


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        ("--plan --apply", 2, "exclude each other"),
        ("--profile pq --only identity", 2, "a new profile applies to both CAs"),
        ("--profile none", 2, "'none' is not one of"),
        ("--only governance", 2, "'governance' is not one of"),
        ("--apply --yes --no-passphrase --validity 999999y", 2, "beyond 2261"),
        ("--apply --yes --no-passphrase --name /", 2, "/"),
    ],
)
def test_what_makes_no_sense_is_refused(pqsec, k, options, code, words):
    before = snapshot(k)
    if words == "/":
        pqsec(f"-k k ca rotate {options}{'x' * 60}").refused(code, "1 to 64 characters")
    else:
        pqsec(f"-k k ca rotate {options}").refused(code, words)
    assert snapshot(k) == before


# ca rotate --overlap


def test_an_overlap_goes_on_step_by_step_as_its_plans_say(pqsec, k):
    for step, plan, done, left in (
        ("begin", "which does not issue yet", "CN=G2 Identity CA is now trusted too", "switch`"),
        ("switch", "reissue 2 participants", "generation 2: new identity CA, 2 part", "finish`"),
        (
            "finish",
            "refuse certificates that",
            "CN=Identity CA is no longer trusted",
            "`pqsec ca show --pins`",
        ),
    ):
        before = snapshot(k)
        told = pqsec(f"-k k ca rotate --overlap {step}").done().out
        assert plan in told
        assert "Cyclone DDS 0.10.2, 0.10.5: no (measured" in told
        assert snapshot(k) == before
        found = pqsec(f"-k k ca rotate --overlap {step} --apply --yes").done().out
        assert done in found
        assert found.splitlines()[-1].endswith(left)
        pqsec("-k k verify-handshake /talker /listener").done()
        pqsec("-k k log --verify").done()
        assert ("trusted too" in pqsec("-k k ca show").done().out) == (step != "finish")
        assert ("trusted too" in pqsec("-k k status").done().out) == (step != "finish")
        assert ("PQS131" in pqsec("-k k check").done().out) == (step != "finish")
    assert len(pqsec("-k k ca show --json").done().json["cas"]) == 2


def test_an_overlap_is_taken_back(pqsec, k):
    before = snapshot(k)
    pqsec("-k k ca rotate --overlap begin --apply").done()
    told = pqsec("-k k ca rotate --overlap cancel").done().out
    assert "destroy the key of CN=G2 Identity CA" in told
    done = pqsec("-k k ca rotate --overlap cancel --apply --yes --json").done().json
    assert done["overlap"] == "cancel"
    assert done["done"] == ["CN=G2 Identity CA is no longer trusted, and its key is destroyed"]
    after = snapshot(k)
    assert {name for name in before | after if before.get(name) != after.get(name)} <= {
        name for name in before | after if "ledger" in str(name)
    }


def test_an_overlap_has_the_passphrase_of_the_keystore(pqsec, k, secret):
    pqsec("-k k ca passphrase --new-passphrase-file", secret("one")).done()
    pqsec("-k k ca rotate --overlap begin --apply").refused(2, "the CA keys are encrypted")
    line = "-k k ca rotate --apply --yes --passphrase-file one.txt --overlap"
    pqsec(line, "begin").done()
    pqsec("-k k ca rotate --apply --overlap switch --passphrase-file", secret("two")).refused(
        3, hint="give the CA passphrase"
    )
    pqsec(line, "switch").done()
    pqsec("-k k ca rotate --apply --yes --overlap finish").done()  # which needs no key


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        ("--overlap soon", 2, "'soon' is not one of"),
        ("--overlap begin --only permissions", 2, "no stack trusts two permissions CAs"),
        ("--overlap begin --profile pq", 2, "a new profile applies to both CAs"),
        ("--overlap switch --only permissions", 2, "no stack trusts two permissions CAs"),
        ("--overlap begin --rekey", 2, "--rekey does not go with --overlap begin"),
        ("--overlap switch --name x", 2, "--name does not go with --overlap switch"),
        ("--overlap finish --validity 1y", 2, "--validity does not go with --overlap finish"),
        ("--overlap begin --no-passphrase", 2, "--no-passphrase does not go with"),
        ("--overlap switch", 3, "no overlap has begun"),
        ("--overlap finish", 3, "no overlap has begun"),
        ("--overlap cancel", 3, "no overlap has begun"),
    ],
)
def test_a_step_that_makes_no_sense_is_refused(pqsec, k, options, code, words):
    before = snapshot(k)
    for do in ("", "--apply --yes"):
        pqsec(f"-k k ca rotate {options} {do}").refused(code, words)
    assert snapshot(k) == before


def test_a_robot_with_bundles_is_told_whom_to_trust_at_the_begin_and_the_end(pqsec, k):
    def install(*named):
        pqsec("-k k bundle /talker --plain-key --force -o one.bundle").done()
        return pqsec("install one.bundle --dir robot", *named)

    def named():
        return pqsec("-k k ca show --pins").done().out.split()

    install(*named()).done()
    pqsec("-k k ca rotate --overlap begin --apply").done()
    install().refused(1, "is not trusted in this role")
    install(*named()).done()
    pqsec("-k k ca rotate --overlap switch --apply").done()
    install().done()
    pqsec("-k k ca rotate --overlap finish --apply --yes").done()
    install().refused(1, "the identity CA that is trusted is missing")
    install(*named()).done()


def test_what_waits_for_the_end_of_an_overlap_says_so(pqsec, k):
    pqsec("-k k ca rotate --overlap begin --apply").done()
    for line in ("revoke /talker --yes", "ca crl", "ca rotate", "ca rotate --overlap begin"):
        pqsec(f"-k k {line}").refused(3, "two identity CAs are trusted", hint="--overlap cancel")
    pqsec("-k k renew /talker").done()


# ca passphrase


def test_a_passphrase_is_set_changed_and_removed(pqsec, k, secret):
    one, two = secret("one"), secret("two")
    done = pqsec(f"-k k ca passphrase --new-passphrase-file {one}").done()
    assert "k/private/identity_ca.key.pem  encrypted again" in done.out
    pqsec(f"-k k ca passphrase --passphrase-file {one} --new-passphrase-file {two}").done()
    pqsec(f"-k k issue /a --passphrase-file {one}").refused(3, hint="give the CA passphrase")
    pqsec(f"-k k issue /a --passphrase-file {two}").done()
    done = pqsec(f"-k k ca passphrase --passphrase-file {two} --no-passphrase").done()
    assert "note: the CA keys in k/private are not encrypted" in done.err
    pqsec("-k k issue /b").done()


def test_a_passphrase_that_is_not_said_is_asked_for(pqsec, k, secret):
    pqsec("-k k ca passphrase").refused(2, "need a passphrase", hint="--new-passphrase-file")
    line = f"-k k ca passphrase --no-passphrase --new-passphrase-file {secret('one')}"
    pqsec(line).refused(2, "--new-passphrase-file and --no-passphrase exclude each other")


# adopt


def test_a_keystore_of_sros2_is_adopted_and_led_out_of_its_hole(pqsec, tmp_path):
    sros2 = SROS2(tmp_path / "sros2")
    sros2.enclave("/talker")
    sros2.enclave("/listener")
    done = pqsec("adopt sros2").done()
    first, *findings = done.out.splitlines()
    assert first == "sros2: 2 participants, profile classical, domain 0"
    assert [line for line in findings if "CVE-2023-24010" in line]
    assert "files checked" in findings[-1]
    assert "`pqsec -k sros2 ca rotate` shows how to get two CAs" in done.err
    assert "/talker" in pqsec("-k sros2 status").done().out
    pqsec("-k sros2 issue /new").refused(3, "CVE-2023-24010", hint="pqsec ca rotate")
    assert "one key is both CAs" in pqsec("-k sros2 ca rotate").done().out
    pqsec("-k sros2 ca rotate --apply --yes --no-passphrase --rekey").done()
    pqsec("-k sros2 issue /new").done()
    pqsec("-k sros2 verify-handshake /talker /listener").done()
    assert "CVE-2023-24010" not in pqsec("-k sros2 check").out


def test_what_is_not_taken_is_told(pqsec, tmp_path):
    sros2 = SROS2(tmp_path / "sros2")
    sros2.enclave("/talker")
    (tmp_path / "sros2/enclaves/talker/permissions.p7s").write_bytes(b"")
    done = pqsec("-k sros2 adopt").done()
    assert "not taken: enclaves/talker/permissions.p7s: " in done.out
    assert pqsec("-k sros2 log --verify").code == 1


def test_what_is_no_keystore_is_not_adopted(pqsec, k, tmp_path):
    pqsec("adopt k").refused(3, "k is a pqsec keystore already")
    pqsec("adopt").refused(2, "no keystore named")
    (tmp_path / "empty").mkdir()
    pqsec("adopt empty").refused(3, "empty lacks public/identity_ca.cert.pem", hint="SROS2")
    assert list((tmp_path / "empty").iterdir()) == []


def test_a_plan_that_another_command_made_old_is_not_applied_after_the_yes(
    run_in, keystore, tmp_path
):
    keystore()
    command = [sys.executable, "-m", "pqsec_pki", "-k", "k", "ca", "rotate", "--apply"]
    ours, its = pty.openpty()
    process = subprocess.Popen(
        [*command, "--no-passphrase"],
        cwd=tmp_path,
        env=clean_environment(),
        **dict.fromkeys(("stdin", "stdout", "stderr"), its),
    )
    os.close(its)
    said = b""
    with suppress(OSError):  # Linux's way to say that the other side is closed
        while data := os.read(ours, 4096):
            said += data
            if said.endswith(b"Make these changes? [y/N]: "):
                run_in(tmp_path, "-k k issue /new").done()
                os.write(ours, b"y\n")
    os.close(ours)
    assert process.wait(timeout=60) == 3, said.decode()
    assert b"another command changed the keystore since the plan was shown" in said
    assert not (tmp_path / "k/private/generations").exists()
