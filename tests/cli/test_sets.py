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
    for more in ("--all", "/talker /listener --trace -"):
        pqsec(f"-k k verify-handshake {more}").refused(2, "name one with --set: classical, hybrid")
    pqsec("-k k verify-handshake --all --set hybrid").done()
    pqsec("-k k verify-handshake /talker /listener --set hybrid").done()
    pqsec("-k k verify-handshake --all --set pq").refused(3, "it has classical, hybrid")


def test_a_check_finds_what_a_set_lacks(pqsec, k):
    (k / "sets/hybrid/enclaves/talker/permissions.p7s").unlink()
    done = pqsec("check k")
    assert done.code == 1
    assert "PQS010 is missing; k has it" in done.out


# What stock stacks get


@pytest.mark.parametrize("version", ["2.14.4", "3.0.2", "3.1.2", "3.2.0"])
def test_a_fast_dds_that_cannot_send_large_messages_is_given_the_first_set(pqsec, k, version):
    del k
    line = f"-k k export fastdds /talker /listener --stack-version {version} -o out --json"
    first, second = pqsec(line).done().json["exports"]
    assert (first["warnings"], second["warnings"]) == ([], [])
    pqsec("-k t ca init --profile transition --no-passphrase").done()
    pqsec("-k t issue /talker --publish chatter").done()
    pqsec(f"-k t export fastdds /talker --stack-version {version}").refused(1, "8192")


def test_a_first_set_that_stock_stacks_cannot_read_is_told_with_the_way_out(pqsec):
    pqsec("-k p ca init --profile pq,classical --no-passphrase").done()
    pqsec("-k p issue /talker --publish chatter").done()
    done = pqsec("-k p export cyclonedds /talker")
    done.refused(1, "stock stacks see only the first set of credentials")
    assert "ca init --profile classical,pq" in done.err
    pqsec("-k p export cyclonedds /talker --anyway")
    told = pqsec("-k p try ros2 --dry-run /talker")
    assert told.code == 1
    assert "only the first set" in told.out


# A domain file


DOMAIN = """
name: Lab
profile: [classical, hybrid]
stock: /listener
participants:
- {name: /talker, publish: rt/chatter}
- {name: /listener, subscribe: rt/chatter}
"""


def test_apply_makes_all_sets_and_adds_what_is_missing(pqsec, tmp_path):
    file = tmp_path / "domain.yaml"
    file.write_text(DOMAIN.replace("[classical, hybrid]", "classical"))
    (tmp_path / "secret").write_text("some secret words")
    (tmp_path / "secret").chmod(0o600)
    pqsec("-k k apply --yes --passphrase-file secret").done()
    before = (tmp_path / "k/enclaves/talker/cert.pem").read_bytes()
    file.write_text(DOMAIN)
    shown = pqsec("-k k plan")
    assert shown.code == 1
    why = "(beside classical: new CAs, and certificates for /listener, /talker)"
    assert f"add the set  hybrid  {why}" in shown.out
    done = pqsec("-k k apply --yes --passphrase-file secret").done()
    assert "add the set: 1 (hybrid)" in done.out
    assert "on their robots" not in done.err
    assert (tmp_path / "k/enclaves/talker/cert.pem").read_bytes() == before
    key = (tmp_path / "k/sets/hybrid/private/identity_ca.key.pem").read_text()
    assert "ENCRYPTED" in key
    pqsec("-k k plan").done()
    pqsec("-k k apply --check").done()
    document = pqsec("-k k domain import").done().out
    assert "stock:" in document
    file.write_text(document)
    pqsec("-k k plan").done()


def test_a_file_with_fewer_sets_says_what_to_do(pqsec, k, tmp_path):
    del k
    (tmp_path / "domain.yaml").write_text(DOMAIN.replace("[classical, hybrid]", "classical"))
    for command in ("plan", "apply --yes"):
        told = pqsec(f"-k k {command}").refused(3, "is not removed from a keystore")
        assert "pqsec -k NEW apply domain.yaml" in told.err


def test_migrate_plans_an_addition(pqsec, tmp_path):
    pqsec("-k k ca init --profile classical --no-passphrase").done()
    pqsec("-k k issue /talker /listener --publish chatter --subscribe chatter").done()
    line = "-k k migrate plan --to classical,hybrid --stack cyclonedds"
    done = pqsec(f"{line} --rehearse --steps steps").done()
    assert "adds     certificates of set hybrid for /listener, /talker\n" in done.out
    assert "removes  nothing: no file of classical changes, and no robot restarts\n" in done.out
    assert "added for 2, 1 pair authenticated each other" in done.out
    assert not (tmp_path / "k/sets").exists()
    pqsec("-k k apply steps/1-classical+hybrid.yaml --yes").done()
    pqsec("-k k apply steps/2-classical+hybrid.yaml --check").done()
    assert (tmp_path / "k/sets/hybrid/enclaves/talker/cert.pem").exists()
    pqsec("-k k migrate plan --to hybrid,classical").refused(3, "none is removed")
    pqsec("-k k migrate plan --to classical,other").refused(2, "'other' is not one of")
    pqsec("-k k migrate plan --to pq").refused(3, "is for one set")


def test_bundles_installations_and_receipts_are_of_all_sets(pqsec, k, tmp_path):
    made = json.loads(pqsec("-k k bundle /talker --plain-key -o b --json").done().out)
    assert made["profiles"] == ["classical", "hybrid"]
    pins = pqsec("-k k ca show --pins").done().out
    assert "--ca-fingerprint hybrid/identity:" in pins
    first = " ".join(each for each in pins.splitlines() if "hybrid" not in each)
    pqsec(f"install b --dir r {first}").refused(1, "set of credentials hybrid are not trusted here")
    done = json.loads(pqsec(f"install b --dir r --json {' '.join(pins.split())}").done().out)
    assert (done["installed"], done["profiles"]) == (["/talker"], ["classical", "hybrid"])
    assert (tmp_path / "r/current/sets/hybrid/enclaves/talker/cert.pem").exists()
    pqsec("-k k receipt import r/installed.receipt").done()
    assert "current" in pqsec("-k k status /talker").done().out
    pqsec("-k k renew /talker").done()
    [row] = json.loads(pqsec("-k k status /talker --json").done().out)["participants"]
    assert "sets/hybrid/cert.pem" in row["changed"]
    [bundle] = json.loads(
        pqsec("-k k bundle /talker --outdated --plain-key -o b --force --json").done().out
    )["bundles"]
    assert bundle["number"] == row["should_run"]
    pqsec("install b --dir r").done()
    pqsec("check r/current/").done()


def test_robots_get_bundles_while_some_wait_for_a_set_that_was_added(pqsec, tmp_path):
    pqsec("-k k ca init --profile classical --no-passphrase").done()
    pqsec("-k k issue /robot --publish chatter").done()
    (tmp_path / "k/enclaves/robot/key.pem").unlink()
    pqsec("-k k ca add-set hybrid").done()
    [made] = json.loads(pqsec("-k k bundle --outdated --no-keys --json").done().out)["bundles"]
    assert made["profiles"] == ["classical"]
    assert "incomplete" in pqsec("-k k status").done().out


def test_a_sealed_bundle_has_the_keys_of_all_sets(pqsec, k, tmp_path):
    del k
    pqsec("bundle-key --dir r").done()
    pqsec("-k k bundle /talker --seal-for r/bundle.pub.pem -o sealed").done()
    pins = " ".join(pqsec("-k k ca show --pins").done().out.split())
    pqsec(f"install sealed --dir r {pins}").done()
    assert (tmp_path / "r/current/sets/hybrid/enclaves/talker/key.pem").exists()


def test_a_mixed_pair_meets_with_the_first_set_if_stock_names_it(pqsec, k):
    del k
    line = "-k k verify-handshake /talker /listener --as cyclonedds --json"
    value = pqsec(f"{line} --stock /listener").done().json
    assert value["signature"] == "ECDSA-SHA256"
    for other in ("/other", "/listener/*"):
        done = pqsec(f"{line} --stock {other}")
        assert done.code == 1
    value = pqsec("-k k verify-handshake /talker /listener --stock '/*' --json").done().json
    assert value["signature"].startswith("MLDSA65")


def test_names_that_choose_nothing_are_usage_errors(pqsec, k):
    del k
    line = "-k k verify-handshake /talker /listener"
    pqsec(f"{line} --stock /a --set hybrid").refused(2, "exclude each other")
    pqsec(f"{line} --stock '/a b='").refused(2, "read differently")
    pqsec(f"{line} --stock /a --trace -").refused(2, "not for --trace")
    pqsec("-k one ca init --profile pq --no-passphrase").done()
    for name in ("/talker", "/listener"):
        pqsec(f"-k one issue {name} --publish x").done()
    pqsec("-k one verify-handshake /talker /listener --stock /a").refused(2, "several sets")


def test_attacks_are_on_the_choice_of_the_set_too(pqsec, k):
    del k
    line = "-k k verify-handshake /talker /listener --attack"
    for name in ("weaker-set", "forged-weaker-set", "other-name", "mixed-sets"):
        out = pqsec(f"{line} {name}").done().out
        assert "1 attack in 2 attempts, all refused" in out
    assert "3 attempts, all refused" in pqsec(f"{line} replay-weaker-set").done().out
    assert "that is its policy" in pqsec(f"{line} weaker-set --stock '/*'").done().out
    assert "one set" in pqsec(f"{line} weaker-set --set hybrid").done().out


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
    # The identity CA stays: what it issued before is replaced, and accepted until it ends.
    replaced = {("PQS353", f"k/sets/hybrid/enclaves/{each}") for each in ("talker", "listener")}
    assert after == before | (replaced if "permissions" in scope else set())
