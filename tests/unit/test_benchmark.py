"""pqsec bench: which suites are measured, what is timed, and what comes of the samples."""

from datetime import UTC, datetime
from statistics import quantiles

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pqsec_pki.algorithms import KEY_AGREEMENTS, PROFILES, SIGNATURES, profile_named
from pqsec_pki.benchmark import (
    CSV_COLUMNS,
    Environment,
    HandshakeSuite,
    Operation,
    every_suite,
    measured_rounds,
    percentile,
    suites_of,
)
from pqsec_pki.selfcheck import HandshakeParty, HandshakeSetup, run_handshake
from tests.unit.keystores import NOW, made

KEM = KEY_AGREEMENTS.named("mlkem768")
CLASSICAL, PQ = (suites_of([profile_named(name)])[0] for name in ("classical", "pq"))


def measured(suite, rounds=2, **more):
    return measured_rounds(suite, rounds=rounds, warm_up=1, now=NOW, **more)


def test_without_a_choice_each_profile_is_measured_with_its_own_key_agreement():
    found = suites_of()
    assert [suite.profile for suite in found] == [each.name for each in PROFILES]
    assert [suite.agreement for suite in found] == [each.key_agreement for each in PROFILES]
    assert [suite.alternative for suite in found] == [each.alternative_key for each in PROFILES]


def test_each_key_that_is_chosen_is_measured_with_each_key_agreement_that_is():
    keys = [SIGNATURES.named(name) for name in ("ml-dsa-44", "rsa-2048")]
    assert [str(suite) for suite in suites_of(signatures=keys)] == [
        "ml-dsa-44 with mlkem768",
        "rsa-2048 with ecdh-p256",
    ]
    both = [KEM, KEY_AGREEMENTS.named("ecdh-p256")]
    found = suites_of([profile_named("pq")], keys, both)
    assert [(suite.keys, suite.agreement.name, suite.profile) for suite in found] == [
        ("ml-dsa-65", "mlkem768", "pq"),
        ("ml-dsa-65", "ecdh-p256", None),  # not what the profile has
        *((key.name, each.name, None) for key in keys for each in both),
    ]
    assert len(every_suite()) == len(SIGNATURES) * len(KEY_AGREEMENTS)


@pytest.mark.parametrize("profile", ["transition", "pq"])
def test_the_messages_are_as_large_as_those_of_participants_of_a_keystore(tmp_path, profile):
    store = made(tmp_path / "k", profile)
    report = run_handshake(
        HandshakeSetup(keystore=store, domain=0, now=NOW),
        *(HandshakeParty(name=name) for name in store.names()),
    )
    [suite] = suites_of([profile_named(profile)])
    sizes = measured(suite, rounds=1).sizes
    samples = {each.name: len(each.data) for each in report.sent}
    for index, name in enumerate(("request", "reply", "final")):
        assert sizes.tokens[index] == pytest.approx(report.token_bytes[name], rel=0.03)
        assert sizes.samples[index] == pytest.approx(samples[name], rel=0.03)
    assert sizes.fragments(1000) == tuple(-(-each // 1000) for each in sizes.samples)


def test_each_operation_of_each_round_is_timed_on_its_side():
    told = []
    found = measured(PQ, each=told.append)
    assert told == [1, 1, 1]  # a warm-up and two rounds
    assert [list(each) for each in found.rounds] == [list(Operation)] * 2
    assert all(timing.wall > 0 for each in found.rounds for timing in each.values())
    rows = list(found.rows())
    assert [tuple(row) for row in rows] == [CSV_COLUMNS] * 8
    assert [row["side"] for row in rows[:4]] == ["initiator", "responder"] * 2
    whole, sides = found.wall_ms(*Operation)[0], [each["wall_us"] / 1000 for each in rows[:4]]
    assert whole == pytest.approx(sum(sides))
    assert found.memory > sum(found.sizes.tokens)


def test_the_summary_of_a_part_is_of_its_operations():
    value = measured(CLASSICAL, rounds=3).to_json(1344)
    cpu = value["cpu_ms"]
    parts = sum(cpu[each]["mean"] for each in Operation)
    assert cpu["handshake"]["mean"] == pytest.approx(parts, abs=0.01)
    assert cpu["initiator"]["mean"] + cpu["responder"]["mean"] == pytest.approx(parts, abs=0.01)
    assert list(cpu["handshake"]) == ["min", "mean", "p50", "p95", "p99", "max"]
    assert len(value["samples"]) == 3 * len(Operation)


def test_an_interruption_leaves_the_rounds_that_were_measured():
    def after(count):
        seen = []

        def each(number):
            seen.append(number)
            if len(seen) == count:
                raise KeyboardInterrupt

        return each

    assert measured(CLASSICAL, each=after(1)) is None  # in the warm-up
    assert len(measured(CLASSICAL, rounds=5, each=after(3)).rounds) == 2


def test_a_suite_that_agrees_on_nothing_is_not_measured(monkeypatch):
    """The secret is compared: without that, a broken key agreement would have a time."""
    from pqsec_pki.benchmark import measuring  # noqa: PLC0415 -- what is to be broken
    from pqsec_pki.errors import VerificationError  # noqa: PLC0415 -- as above

    ended = measuring._ended

    def other(awaiting, final):
        done = ended(awaiting, final)
        return type("Done", (), {"shared_secret": done.shared_secret[::-1]})

    monkeypatch.setattr(measuring, "_ended", other)
    with pytest.raises(VerificationError, match="do not agree on a secret"):
        measured(CLASSICAL)


@given(st.lists(st.floats(0, 1e6), min_size=2), st.integers(1, 99))
def test_a_percentile_is_what_the_standard_library_has(values, percent):
    expected = quantiles(values, n=100, method="inclusive")[percent - 1]
    assert percentile(values, percent) == pytest.approx(expected)


def test_the_percentiles_of_one_value_are_that_value():
    assert [percentile([7.0], each) for each in (0, 50, 100)] == [7.0] * 3


def test_the_environment_is_this_machines():
    here = Environment.here(datetime.now(UTC))
    assert here.python.startswith("CPython 3.")
    assert here.openssl.startswith("OpenSSL")
    assert here.cores >= 1
    assert here.system


def test_a_suite_is_named_by_its_keys_and_its_key_agreement():
    both = HandshakeSuite(SIGNATURES.named("ecdsa-p256"), KEM, SIGNATURES.named("ml-dsa-65"))
    assert str(both) == "ecdsa-p256+ml-dsa-65 with mlkem768"
