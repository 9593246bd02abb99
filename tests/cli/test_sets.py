"""Keystores with several sets of credentials, by commands."""

import json

import pytest

TWO = "classical,hybrid"


@pytest.fixture
def k(pqsec, tmp_path):
    """A keystore with two sets and two participants, in k."""
    pqsec(f"-k k ca init --profile {TWO} --no-passphrase").done()
    pqsec("-k k issue /talker --publish chatter").done()
    pqsec("-k k issue /listener --subscribe chatter").done()
    return tmp_path / "k"


def test_init_makes_a_set_for_each_profile(pqsec, tmp_path):
    out = pqsec(f"-k k ca init --name Lab --profile {TWO} --no-passphrase").done().out
    assert "profile classical" in out
    assert "set            k/sets/hybrid (profile hybrid" in out
    settings = json.loads((tmp_path / "k/pqsec.json").read_text())
    assert [each["profile"] for each in settings["algorithms"]] == TWO.split(",")
    [further] = pqsec("-k k ca show --json").done().json["further"]
    assert further["profile"] == "hybrid"
    assert further["cas"][0]["subject"] == "CN=Lab hybrid Identity CA"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--profile classical,other", "'other' is not one of"),
        ("--profile classical,", "'' is not one of"),
        ("--profile classical,hybrid,classical", "profile classical is given twice"),
        ("--profile classical,pq --kem mlkem768", "are for a keystore with one profile"),
        (
            "--profile classical,pq --ledger postgresql://u@h/d",
            "a ledger in a database is for a keystore with one profile",
        ),
    ],
)
def test_lists_of_profiles_that_cannot_be_are_usage_errors(pqsec, tmp_path, options, words):
    pqsec(f"-k k ca init --no-passphrase {options}").refused(2, words)
    assert not (tmp_path / "k").exists()


def test_issue_prints_the_place_in_each_set(pqsec, k):
    del k
    out = pqsec("-k k issue /new --publish x").done().out
    assert "k/enclaves/new" in out
    assert "k/sets/hybrid/enclaves/new" in out


def test_status_shows_a_participant_that_lacks_a_set(pqsec, k):
    (k / "sets/hybrid/enclaves/talker/cert.pem").unlink()
    done = pqsec("-k k status").done()
    assert "profile classical, hybrid" in done.out
    assert "1 incomplete, 1 valid" in done.out
    assert "(set hybrid)" in done.out


@pytest.mark.parametrize(
    "line",
    [
        "bundle /talker",
        "ca show --pins",
        "ca crl --show -o x",
        "export cyclonedds /talker",
        "ledger move postgresql://u@h/d",
        "report -o x",
        "estimate",
        "migrate plan --to pq",
        "domain import k",
        "receipt import x",
        "sign-governance k/enclaves/governance.xml -o x.p7s",
    ],
)
def test_what_handles_one_set_refuses_several(pqsec, k, tmp_path, line):
    del k
    before = sorted(tmp_path.rglob("*"))
    done = pqsec(f"-k k {line}")
    assert done.code == 3
    assert "further sets of credentials (hybrid)" in done.err
    assert sorted(tmp_path.rglob("*")) == before


def test_a_set_is_added_to_a_keystore_that_runs(pqsec, tmp_path):
    pqsec("-k k ca init --name Lab --profile classical --no-passphrase").done()
    pqsec("-k k issue /talker --publish chatter").done()
    before = (tmp_path / "k/enclaves/talker/cert.pem").read_bytes()
    done = pqsec("-k k ca add-set hybrid").done()
    assert "k/sets/hybrid/enclaves/talker" in done.out
    assert (tmp_path / "k/enclaves/talker/cert.pem").read_bytes() == before
    pqsec("-k k log --verify").done()
    pqsec("-k k ca add-set hybrid").refused(3, "a set of profile hybrid already")


def test_a_passphrase_is_of_all_sets(pqsec, tmp_path):
    for name in ("old", "new"):
        (tmp_path / name).write_text(f"{name} horse battery staple")
        (tmp_path / name).chmod(0o600)
    pqsec(f"-k k ca init --profile {TWO} --passphrase-file old").done()
    out = pqsec("-k k ca passphrase --passphrase-file old --new-passphrase-file new").done().out
    assert out.count("encrypted again") == 4
    pqsec("-k k issue /a --publish x --passphrase-file old").refused(3, "passphrase")
    pqsec("-k k issue /a --publish x --passphrase-file new").done()


# The handshake, in each set


def test_a_handshake_is_run_in_each_set(pqsec, k):
    del k
    done = pqsec("-k k verify-handshake /talker /listener").done()
    assert "set hybrid" in done.out
    value = pqsec("-k k verify-handshake /talker /listener --json").done().json
    assert [value["profile"], *(each["profile"] for each in value["further"])] == TWO.split(",")
    assert value["ok"]
    assert all(each["ok"] for each in value["further"])


@pytest.mark.parametrize("number", [0, 1])
def test_a_handshake_fails_if_it_fails_in_one_set(pqsec, k, number):
    folder = (k, k / "sets/hybrid")[number]
    (folder / "enclaves/talker/permissions.p7s").write_bytes(
        (folder / "enclaves/listener/permissions.p7s").read_bytes()
    )
    assert pqsec("-k k verify-handshake /talker /listener").code == 1


def test_a_stock_stack_is_only_met_with_what_it_can_use(pqsec, k):
    del k
    line = "-k k verify-handshake /talker /listener --as cyclonedds --json"
    assert pqsec(line).done().json["further"] == []


def test_one_set_is_named_for_what_takes_one(pqsec, k):
    del k
    for more in ("--all", "/talker /listener --trace -", "/talker /listener --attack all"):
        pqsec(f"-k k verify-handshake {more}").refused(2, "name one with --set: classical, hybrid")
    pqsec("-k k verify-handshake --all --set hybrid").done()
    pqsec("-k k verify-handshake /talker /listener --set hybrid").done()
    pqsec("-k k verify-handshake --all --set pq").refused(3, "it has classical, hybrid")


def test_a_check_finds_what_a_set_lacks(pqsec, k):
    (k / "sets/hybrid/enclaves/talker/permissions.p7s").unlink()
    done = pqsec("check k")
    assert done.code == 1
    assert "PQS010 is missing; k has it" in done.out


# The CAs of one set


def rotation(text):
    return f"-k k ca rotate --apply --yes {text}"


@pytest.mark.parametrize("name", TWO.split(","))
def test_the_cas_of_the_named_set_are_replaced(pqsec, k, name):
    before = {path: path.read_bytes() for path in k.rglob("public/*_ca.cert.pem")}
    out = pqsec(rotation(f"--set {name}")).done().out
    assert "generation 2" in out
    changed = {path for path, data in before.items() if path.read_bytes() != data}
    folder = k if name == "classical" else k / "sets/hybrid"
    assert {path.parent.parent for path in changed} == {folder}
    pqsec("-k k log --verify").done()
    pqsec("-k k issue /new --publish x").done()


def test_a_rotation_names_its_set(pqsec, k):
    del k
    pqsec(rotation("")).refused(2, "name one with --set: classical, hybrid")
    pqsec("-k k ca rotate --set pq").refused(3, "it has classical, hybrid")
    pqsec(rotation("--set hybrid --profile pq")).refused(2, "keeps its profile")
    pqsec(rotation("--set hybrid --no-passphrase")).refused(2, "have one passphrase")


def test_the_plan_of_a_rotation_says_what_stays(pqsec, k):
    del k
    out = pqsec("-k k ca rotate --set hybrid").done().out
    assert "With credentials of classical nothing changes." in out
    out = pqsec("-k k ca rotate --set hybrid --overlap begin").done().out
    assert "pqsec ca rotate --set hybrid --overlap switch" in out


def test_new_keys_of_one_set_get_the_passphrase_of_all(pqsec, tmp_path):
    (tmp_path / "p").write_text("correct horse battery staple")
    (tmp_path / "p").chmod(0o600)
    pqsec(f"-k k ca init --profile {TWO} --passphrase-file p").done()
    pqsec(rotation("--set hybrid --passphrase-file p")).done()
    for path in (tmp_path / "k").rglob("*_ca.key.pem"):
        assert "ENCRYPTED" in path.read_text()
    pqsec("-k k issue /a --publish x --passphrase-file p").done()


# Removing a set


def test_a_set_is_removed_after_a_question(pqsec, k):
    asked = pqsec("-k k ca remove-set hybrid")
    assert asked.code == 2
    assert "has valid certificates of /listener, /talker" in asked.out
    assert "would be removed, and no terminal to ask" in asked.err
    assert (k / "sets/hybrid").is_dir()
    done = pqsec("-k k ca remove-set hybrid --yes").done()
    assert "valid certificates of 2 participants" in done.out
    assert not (k / "sets/hybrid").exists()
    assert "hybrid" not in pqsec("-k k ca show").done().out
    pqsec("-k k log --verify").done()
    assert pqsec("-k k status").done().out.count("2 valid") == 1
    assert pqsec("check k").code in {0, 1}
    pqsec("-k k renew --all").done()


def test_the_first_set_and_unknown_ones_are_not_removed(pqsec, k):
    del k
    line = "-k k ca remove-set"
    pqsec(f"{line} classical --yes").refused(3, "is the first set of credentials")
    pqsec(f"{line} pq --yes").refused(3, "it has classical, hybrid")


@pytest.mark.parametrize(
    "line", ["ca rotate --set hybrid --apply --yes", "ca remove-set hybrid --yes"]
)
def test_a_set_is_rotated_or_removed_without_its_own_keys(pqsec, k, line):
    for key in (k / "sets/hybrid/private").glob("*.key.pem"):
        key.write_text("damaged")
    pqsec("-k k issue /new --publish x").refused(3, "key")
    pqsec(f"-k k {line}").done()
    pqsec("-k k issue /new --publish x").done()
    pqsec("-k k log --verify").done()


@pytest.mark.parametrize("scope", ["", "--only identity", "--only permissions"])
def test_a_check_finds_nothing_new_after_a_rotation_of_a_set(pqsec, k, scope):
    before = {(each["rule"], each["path"]) for each in pqsec("check k --json").json["findings"]}
    pqsec(rotation(f"--set hybrid {scope}")).done()
    after = {(each["rule"], each["path"]) for each in pqsec("check k --json").json["findings"]}
    assert after == before
