"""pqsec verify-handshake --attack: does this domain refuse forgery?"""

import shutil

import pytest

from pqsec_pki.attacks import ATTACKS
from tests.cli.conftest import NAMES, snapshot

LINE = "-k k verify-handshake /talker /listener"
ALL = [row.name for row in ATTACKS]

# cryptography warns of what it will refuse some day, and a spoilt certificate may have that.
pytestmark = [
    pytest.mark.filterwarnings("ignore::cryptography.utils.CryptographyDeprecationWarning"),
    pytest.mark.filterwarnings("ignore:Attribute's length:UserWarning"),
]


def test_a_domain_that_revoked_somebody_withstands_them_too(pqsec, keystore):
    """A list of the genuine CA says nothing of the stand-in that some attacks are made with."""
    keystore("transition")
    pqsec("-k k issue /gone --publish x").done()
    pqsec("-k k revoke /gone --yes").done()
    said = pqsec(f"{LINE} --attack all --json").done().json
    assert [each["name"] for each in said["attacks"] if not each["ok"]] == []


@pytest.mark.parametrize("profile", NAMES)
def test_a_domain_withstands_all_attacks(pqsec, keystore, profile):
    root = keystore(profile)
    shutil.rmtree(root / "private")  # the CA may be elsewhere
    before = snapshot(root)
    said = pqsec(f"{LINE} --attack all --json").done().json
    assert said["ok"] is True
    assert said["control"]["ok"] is True
    assert [each["name"] for each in said["attacks"]] == ALL
    assert all(each["ok"] for each in said["attacks"])
    skipped = [each["name"] for each in said["attacks"] if "skipped" in each]
    # those for two keys, for messages of the second version, and for several sets
    assert len(skipped) == {"transition": 5, "classical": 13}.get(profile, 10)
    for attack in said["attacks"]:
        assert attack["name"] in skipped or attack["refused"] == len(attack["attempts"]) > 0
        for attempt in attack.get("attempts", ()):
            assert attempt["refused"]
            assert all(attempt[key] for key in ("what", "by", "step", "cause"))
    assert snapshot(root) == before


@pytest.mark.parametrize("profile", ["transition", "hybrid", "pq", "cnsa2"])
def test_a_domain_withstands_all_attacks_on_the_second_version(pqsec, keystore, profile):
    keystore(profile)
    said = pqsec(f"{LINE} --attack all --wire-version 2 --json").done().json
    assert [each["name"] for each in said["attacks"] if not each["ok"]] == []
    skipped = {each["name"] for each in said["attacks"] if "skipped" in each}
    assert "insider-in-the-middle" in skipped
    assert len(skipped) == {"transition": 6}.get(profile, 11)
    assert sum(len(each.get("attempts", ())) for each in said["attacks"]) > 250


def test_each_attack_is_told_to_a_person(pqsec, keystore):
    keystore("pq")
    told = pqsec(f"{LINE} --attack all").done().out.splitlines()
    for name in ALL:
        [line] = [each for each in told if name in each.split()]
        why = ("participants of profile pq have one key", "has one set of credentials here")
        assert any(each in line for each in why) == line.startswith("-")
        assert line.startswith(("ok ", "- "))
    assert told[-1].endswith("attempts, all refused")


def test_one_attack_is_told_with_its_attempts(pqsec, keystore):
    keystore("classical")
    told = pqsec(f"{LINE} --attack copied-certificate").done().out
    assert "another key, as initiator" in told
    assert "another key, as replier" in told
    assert told.count("bad ECDSA-SHA256 signature") == 2
    assert told.splitlines()[-1] == "1 attack in 2 attempts, all refused"


def test_an_unknown_attack_is_refused(pqsec, keystore):
    keystore("classical")
    said = pqsec(f"{LINE} --attack forgery")
    said.refused(2, "no attack named 'forgery'", hint="known: all, change-request")


def test_where_two_do_not_meet_attacks_prove_nothing(pqsec, keystore):
    keystore("classical")
    said = pqsec(f"{LINE} --domain 5 --attack all --json")
    assert said.code == 1
    assert said.json["ok"] is False
    assert said.json["attacks"] == []
    told = pqsec(f"{LINE} --domain 5 --attack all")
    assert told.code == 1
    assert "attacks prove nothing; documents of /talker failed" in told.out
    assert "hint: add the domain to k/enclaves/governance.xml" in told.out


def test_a_stock_stack_cannot_be_attacked(pqsec, keystore):
    keystore("classical")
    pqsec(f"{LINE} --as cyclonedds --attack all").refused(2, "--as")
