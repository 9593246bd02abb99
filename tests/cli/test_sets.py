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
        "ca rotate --profile pq",
        "export cyclonedds /talker",
        "estimate",
        "migrate plan --to pq",
        "domain import k",
        "receipt import x",
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


# What shows or copies what the sets have


def test_each_list_of_the_sets_is_issued_shown_and_copied(pqsec, k, tmp_path):
    out = pqsec("-k k ca crl").done().out
    assert "k/public/identity_ca.crl.pem" in out
    assert "k/sets/hybrid/public/identity_ca.crl.pem" in out
    for profile, folder in (("classical", k), ("hybrid", k / "sets/hybrid")):
        found = pqsec(f"-k k ca crl --show --set {profile} -o {profile}.pem --json").done().json
        assert [found["number"], *(each["number"] for each in found["further"])] == [1, 1]
        copy = (tmp_path / f"{profile}.pem").read_bytes()
        assert copy == (folder / "public/identity_ca.crl.pem").read_bytes()
    for command in found["delivery"]["commands"]:
        pqsec(command.removeprefix("pqsec ")).done()
    pqsec("-k k ca crl -o x.pem").refused(2, "name one with --set: classical, hybrid")
    pqsec("-k k ca crl --show --set hybrid").refused(2, "--set chooses the list that --out writes")
    pqsec("-k k ca crl --show --set pq -o x.pem").refused(3, "it has classical, hybrid")
    assert not (tmp_path / "x.pem").exists()


@pytest.mark.parametrize("folder", ["", "sets/hybrid/"])
def test_a_list_that_one_set_lacks_is_not_shown_as_if_there_was_none(pqsec, k, folder):
    pqsec("-k k ca crl").done()
    (k / f"{folder}public/identity_ca.crl.pem").unlink()
    told = pqsec("-k k ca crl --show").refused(3, f"{folder}public/identity_ca.crl.pem is missing")
    assert "`pqsec ca crl`" in told.err
    pqsec("-k k ca crl").done()
    pqsec("-k k ca crl --show").done()


def test_the_pins_are_those_of_the_cas_of_all_sets(pqsec, k):
    pins = pqsec("-k k ca show --pins --json").done().json["pins"]
    shown = pqsec("-k k ca show --json").done().json
    cas = [ca for each in (shown, *shown["further"]) for ca in each["cas"]]
    assert [each.partition(":")[2] for each in pins] == [each["sha256"] for each in cas]


def test_metrics_have_what_ends_in_each_set(pqsec, k, tmp_path):
    del k
    pqsec("-k k ca crl").done()
    pqsec("-k k status --prometheus m").done()
    lines = [each for each in (tmp_path / "m").read_text().splitlines() if each[0] != "#"]
    series = [each.rpartition(" ")[0] for each in lines]
    assert len(set(series)) == len(series)
    ends = [each for each in series if each.startswith("pqsec_not_after_seconds")]
    further = [each for each in ends if 'set="hybrid"' in each]
    assert len(further) == len(ends) - len(further) == 5
    for kind in ("identity-ca", "permissions-ca", "crl", "participant"):
        assert any(f'kind="{kind}"' in each for each in further)


def test_a_report_is_of_all_sets_and_complete(pqsec, k):
    del k
    found = pqsec("-k k report --json").done().json
    assert found["complete"]
    assert [found["profile"], *found["further_profiles"]] == TWO.split(",")


def test_a_file_elsewhere_is_signed_for_the_set_that_is_named(pqsec, k, tmp_path):
    line = "-k k sign-governance k/enclaves/governance.xml -o x.p7s"
    pqsec(line).refused(2, "name one with --set: classical, hybrid")
    pqsec(f"{line} --set hybrid").done()
    ca = k / "sets/hybrid/public/permissions_ca.cert.pem"
    pqsec(f"verify x.p7s --ca {ca}").done()
    assert (tmp_path / "x.p7s").exists()


def test_questions_about_rights_are_refused_where_the_sets_differ(pqsec, k):
    pqsec("-k k explain /talker --publish chatter --domain 0").done()
    folder = k / "sets/hybrid/enclaves"
    (folder / "talker/permissions.p7s").write_bytes(
        (folder / "listener/permissions.p7s").read_bytes()
    )
    for line in ("explain /talker --publish chatter --domain 0", "permit /talker --publish x"):
        pqsec(f"-k k {line}").refused(1, "give different rights")
    assert "give different rights" in pqsec("-k k who-may").err


def test_status_and_metrics_say_that_the_settings_hide_a_set(pqsec, k, tmp_path):
    settings = json.loads((k / "pqsec.json").read_bytes())
    settings["algorithms"] = settings["algorithms"][:1]
    (k / "pqsec.json").write_text(json.dumps(settings))
    done = pqsec("-k k status --prometheus m")
    assert "NOT AS SIGNED" in done.out
    assert "lacks the set of credentials hybrid" in done.out
    assert "pqsec_ledger_whole" in (tmp_path / "m").read_text()
    [line] = [
        e for e in (tmp_path / "m").read_text().splitlines() if e.startswith("pqsec_ledger_w")
    ]
    assert line.endswith(" 0")


@pytest.mark.parametrize("profile", TWO.split(","))
def test_a_report_is_signed_and_verified_for_the_set_that_is_named(pqsec, k, tmp_path, profile):
    del k
    pqsec("-k k report --sign -o r.html").refused(2, "name one with --set: classical, hybrid")
    pqsec(f"-k k report --set {profile} -o r.html").refused(2, "--set chooses the CA that signs")
    assert not (tmp_path / "r.html").exists()
    pqsec(f"-k k report --sign --set {profile} -o r.html").done()
    pqsec("-k k verify r.html.p7s").refused(2, "name one with --set: classical, hybrid")
    for each in TWO.split(","):
        done = pqsec(f"-k k verify r.html.p7s --set {each}")
        assert done.code == (0 if each == profile else 1)


def test_a_document_is_verified_by_the_ca_of_the_set_that_has_it(pqsec, k):
    del k
    for folder in ("", "sets/hybrid/"):
        pqsec(f"-k k verify k/{folder}enclaves/governance.p7s").done()
    pqsec("-k k verify k/enclaves/governance.p7s --set hybrid").refused(1)
    line = (
        "-k k verify k/enclaves/governance.p7s --set hybrid --ca k/public/permissions_ca.cert.pem"
    )
    pqsec(line).refused(2, "--ca and --set exclude each other")
