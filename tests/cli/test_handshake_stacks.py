"""verify-handshake --as: would it work with that DDS stack? Yes, or why not in plain words.

Of the two names here /talker always initiates: its GUID is the smaller one.
"""

import pytest

from pqsec_pki.algorithms import PROFILES, profile_named
from pqsec_pki.selfcheck import PQSEC, STACKS
from tests.cli.conftest import NAMES

STOCK = {row.name: row.title for row in STACKS if row is not PQSEC}
IN_STOCK = [profile.name for profile in PROFILES if profile.runs_in_stock]
NOT_IN_STOCK = [name for name in NAMES if name not in IN_STOCK]
CHOOSE_A_PROFILE = "create the keystore with profile transition or classical"
CYCLONE_MUST_INITIATE = (
    "Fast DDS and Cyclone DDS understand each other only where Cyclone DDS initiates: choose names"
    " so that its GUID is the smaller one, or use one stack"
)
LIMIT = (
    "over 8192 bytes, which Fast DDS 2.14.4, 3.0.2, 3.1.1 to 3.1.3 and 3.2.0 to 3.2.2 cannot send"
)
ECDH, MODP = "ECDH+prime256v1-CEUM", "DH+MODP-2048-256"
ASKS_FOR = {name: MODP if name.startswith("fastdds") else ECDH for name in STOCK}
each_stack = pytest.mark.parametrize("stack", STOCK)


@pytest.fixture
def meets(pqsec, keystore):
    """meets("pq", "fastdds", ...) is the report of /talker and /listener, who behave like that."""

    def report(profile, *stacks):
        keystore(profile)
        options = " ".join(f"--as {name}" for name in stacks)
        said = pqsec(f"-k k verify-handshake /talker /listener {options} --json")
        assert said.code == (0 if said.json["ok"] else 1)
        assert said.json["initiator"] in {"/talker", None}
        return said.json

    return report


@pytest.fixture
def refused(meets):
    """The same of a handshake that must fail: (step, words, hint) of the step that did."""

    def last(*profile_and_stacks):
        report = meets(*profile_and_stacks)
        assert report["ok"] is False
        step = report["steps"][-1]
        return step["name"], step["detail"], step.get("hint")

    return last


# One of them is pqsec


@pytest.mark.parametrize(
    ("profile", "stack"),
    [
        (profile, stack)
        for profile in IN_STOCK
        for stack in STOCK
        if (profile, stack) != ("transition", "fastdds-3.1")  # its limit has its own test
    ],
)
def test_a_stock_stack_that_answers_agrees_as_classical_peers_do(meets, profile, stack):
    report = meets(profile, stack)
    assert report["ok"] is True
    assert report["stacks"] == {"/talker": "pqsec", "/listener": stack}
    assert (report["signature"], report["key_agreement"]) == ("ECDSA-SHA256", ECDH)


@each_stack
def test_a_stock_stack_that_initiates_asks_for_what_it_is_used_to(meets, stack):
    report = meets("classical", stack, "pqsec")
    assert report["ok"] is True
    assert report["stacks"] == {"/talker": stack, "/listener": "pqsec"}
    assert report["key_agreement"] == ASKS_FOR[stack]


@pytest.mark.parametrize(("place", "name"), [(0, "/talker"), (1, "/listener")])
@each_stack
@pytest.mark.parametrize("profile", NOT_IN_STOCK)
def test_post_quantum_identities_run_in_no_stock_stack(refused, profile, stack, place, name):
    stacks = ["pqsec", "pqsec"]
    stacks[place] = stack
    step, words, hint = refused(profile, *stacks)
    key = profile_named(profile).participant_key.name
    assert step == f"identity of {name}"
    assert f"{STOCK[stack]} accepts no {key} key of a participant" in words
    assert hint == CHOOSE_A_PROFILE


def test_the_size_limit_of_fast_dds_3_1_stops_transition_and_is_told_of_others(refused):
    step, words, hint = refused("transition", "fastdds-3.1")
    assert step == "reply"
    assert words.startswith("Fast DDS 3.1 (/listener) refuses: a message of ")
    assert words.endswith(LIMIT)
    assert hint == "use another version, or a keystore with profile classical"


def test_the_size_limit_is_told_where_the_version_is_not_known(meets):
    report = meets("transition", "fastdds")
    assert report["ok"] is True
    [reply] = [step for step in report["steps"] if step["name"] == "reply"]
    assert reply["detail"].endswith(LIMIT)


# Both are stock


@pytest.mark.parametrize("profile", IN_STOCK)
def test_fast_dds_that_initiates_is_refused_by_cyclone_dds(refused, profile):
    step, words, hint = refused(profile, "fastdds", "cyclonedds")
    assert step == "reply"
    assert words.startswith("Cyclone DDS (/listener) refuses: ")
    assert hint == CYCLONE_MUST_INITIATE


@pytest.mark.parametrize("profile", IN_STOCK)
def test_cyclone_dds_that_initiates_meets_fast_dds(meets, profile):
    report = meets(profile, "cyclonedds", "fastdds")
    assert report["ok"] is True
    assert report["key_agreement"] == ECDH


@each_stack
def test_two_of_one_stack_meet(meets, stack):
    report = meets("classical", stack, stack)
    assert report["ok"] is True
    assert report["key_agreement"] == ASKS_FOR[stack]


# What is asked wrongly


def test_an_unknown_stack_is_refused_with_those_there_are(pqsec, keystore):
    keystore()
    said = pqsec("-k k verify-handshake /talker /listener --as rti")
    said.refused(2, "no stack named 'rti'", hint=", ".join(row.name for row in STACKS))


def test_a_third_stack_is_a_usage_error(pqsec, keystore):
    keystore()
    line = "-k k verify-handshake /talker /listener" + " --as pqsec" * 3
    pqsec(line).refused(2, "--as is given more than twice")
