"""Profiles: what they promise is kept, however they are changed."""

from dataclasses import fields

import pytest

from pqsec_pki.algorithms import (
    DEFAULT_PROFILE,
    KEY_AGREEMENTS,
    PROFILES,
    SIGNATURES,
    STOCK_AGREEMENT,
    Family,
    Profile,
    profile_named,
)
from pqsec_pki.errors import MalformedError, UnknownAlgorithmError, UsageError

each_profile = pytest.mark.parametrize("profile", PROFILES, ids=lambda profile: profile.name)
CHOICES = [
    "identity_key",
    "permissions_key",
    "participant_key",
    "alternative_key",
    "key_agreement",
]


@each_profile
def test_a_profile_is_made_of_rows_of_the_tables(profile):
    signatures = set(SIGNATURES)
    assert set(profile.signature_keys) <= signatures
    assert profile.alternative_key is None or profile.alternative_key in signatures
    assert profile.key_agreement in set(KEY_AGREEMENTS)


@each_profile
def test_a_profile_keeps_each_of_its_promises(profile):
    assert profile.promises
    assert [promise.text for promise in profile.promises if not promise.kept(profile)] == []


@each_profile
def test_a_profile_is_found_by_name_in_any_case(profile):
    assert profile_named(profile.name.upper()) is profile


def test_an_unknown_profile_is_refused_with_the_known_ones():
    with pytest.raises(UnknownAlgorithmError, match="no profile named 'fast'") as caught:
        profile_named("fast")
    assert all(profile.name in caught.value.hint for profile in PROFILES)


def test_the_default_runs_in_stock_stacks():
    assert DEFAULT_PROFILE.name == "transition"
    assert DEFAULT_PROFILE.runs_in_stock
    assert DEFAULT_PROFILE.alternative_key.family is Family.PQ
    assert STOCK_AGREEMENT.family is Family.CLASSICAL


@pytest.mark.parametrize(
    ("name", "stock"),
    [("transition", True), ("classical", True), ("hybrid", False), ("pq", False), ("cnsa2", False)],
)
def test_only_classical_main_keys_run_in_stock_stacks(name, stock):
    assert profile_named(name).runs_in_stock is stock


@each_profile
def test_no_choice_changes_nothing(profile):
    assert profile.changed(dict.fromkeys(CHOICES)) is profile


@pytest.mark.parametrize(
    ("name", "key", "row"),
    [
        ("transition", "permissions_key", "rsa-4096"),
        ("transition", "participant_key", "rsa-2048"),
        ("transition", "alternative_key", "ml-dsa-87"),
        ("transition", "key_agreement", "mlkem1024"),
        ("hybrid", "identity_key", "mldsa87+p384"),
        ("pq", "permissions_key", "mldsa65+ed25519"),
        ("pq", "key_agreement", "secp384r1mlkem1024"),
        ("classical", "key_agreement", "modp"),
    ],
)
def test_a_change_within_the_promises_is_made(name, key, row):
    changed = profile_named(name).changed({key: row})
    table = KEY_AGREEMENTS if key == "key_agreement" else SIGNATURES
    assert getattr(changed, key) is table.named(row)
    others = [field.name for field in fields(Profile) if field.name != key]
    assert all(getattr(changed, each) == getattr(profile_named(name), each) for each in others)


@pytest.mark.parametrize(
    ("name", "key", "row", "promise"),
    [
        ("transition", "identity_key", "ecdsa-p384", "runs in stock stacks"),
        ("transition", "participant_key", "ml-dsa-65", "runs in stock stacks"),
        ("transition", "permissions_key", "ml-dsa-65", "runs in stock stacks"),
        ("transition", "alternative_key", "ecdsa-p256", "also carries an ML-DSA signature"),
        ("transition", "key_agreement", "ecdh-p256", "recorded traffic"),
        ("hybrid", "participant_key", "ml-dsa-65", "while either half is"),
        ("hybrid", "key_agreement", "mlkem768", "while either half is"),
        ("hybrid", "alternative_key", "ml-dsa-65", "no alternative key"),
        ("pq", "identity_key", "ecdsa-p256", "withstands a quantum computer"),
        ("pq", "key_agreement", "ecdh-p384", "withstands a quantum computer"),
        ("pq", "alternative_key", "ml-dsa-87", "no alternative key"),
        ("cnsa2", "permissions_key", "ml-dsa-65", "CNSA 2.0"),
        ("cnsa2", "participant_key", "mldsa87+p384", "CNSA 2.0"),
        ("cnsa2", "key_agreement", "mlkem768", "CNSA 2.0"),
        ("cnsa2", "alternative_key", "ml-dsa-87", "no alternative key"),
        ("classical", "identity_key", "ml-dsa-44", "runs in stock stacks"),
        ("classical", "key_agreement", "x25519mlkem768", "one that stock stacks run"),
        ("classical", "alternative_key", "ml-dsa-65", "no alternative key"),
    ],
)
def test_a_change_that_breaks_a_promise_is_refused(name, key, row, promise):
    with pytest.raises(UsageError, match=promise) as caught:
        profile_named(name).changed({key: row})
    assert f"profile {name} promises" in str(caught.value)


def test_every_broken_promise_is_named():
    with pytest.raises(UsageError) as caught:
        profile_named("classical").changed(
            {"identity_key": "ml-dsa-65", "key_agreement": "mlkem768", "alternative_key": "p256"}
        )
    assert str(caught.value).count(";") == 2


@pytest.mark.parametrize("key", CHOICES)
def test_a_change_to_an_unknown_algorithm_is_refused(key):
    with pytest.raises(UnknownAlgorithmError, match="named 'rot13'"):
        DEFAULT_PROFILE.changed({key: "rot13"})


@each_profile
def test_a_profile_that_was_written_down_is_read_back(profile):
    names = profile.to_names()
    assert Profile.from_names(names) == profile
    assert set(names) == {"profile", *CHOICES}


def test_a_changed_profile_that_was_written_down_is_read_back():
    changed = DEFAULT_PROFILE.changed({"permissions_key": "rsa3072", "alternative_key": "mldsa87"})
    assert Profile.from_names(changed.to_names()) == changed


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda names: names.pop("identity_key"), id="a missing key"),
        pytest.param(lambda names: names.pop("profile"), id="a missing profile"),
        pytest.param(lambda names: names.update(profile="other"), id="an unknown profile"),
        pytest.param(
            lambda names: names.update(participant_key="rot13"), id="an unknown algorithm"
        ),
        pytest.param(lambda names: names.update(participant_key=5), id="a number for a name"),
        pytest.param(
            lambda names: names.update(participant_key="ml-dsa-65"), id="a broken promise"
        ),
    ],
)
def test_names_that_nobody_wrote_down_here_are_refused(change):
    names = DEFAULT_PROFILE.to_names()
    change(names)
    with pytest.raises(MalformedError, match="not a profile that pqsec wrote"):
        Profile.from_names(names)


@pytest.mark.parametrize("names", [None, 5, [], "classical"])
def test_what_is_no_set_of_names_is_refused(names):
    with pytest.raises(MalformedError):
        Profile.from_names(names)
