"""The proof is of the present protocol: its model, its recorded results and the code are one.

ProVerif itself runs in .ci/long. A change of the protocol changes the model, and the gate fails
until `python -m tests.proof` has proved it again.
"""

import hashlib
import hmac
import re
import shutil
from collections.abc import Callable

import pytest

from pqsec_pki.algorithms import KEY_AGREEMENTS
from pqsec_pki.handshake import Done, Introduction, WireVersion, key_exchange_material
from pqsec_pki.handshake.messages import Transcript
from pqsec_pki.handshake.wire import encode_properties
from tests.docs.tables import Document
from tests.proof import bounded, pages, protocol, results
from tests.proof.checks import CHECKS, EVERYWHERE, Needed, Redundant
from tests.proof.model import FOLDER, Scenario, digest, model, questions
from tests.proof.protocol import KINDS, LABELS, of_kind
from tests.proof.scenarios import ALL_REDUNDANT, SCENARIOS

MAIN = SCENARIOS[0]
BY_NAME = {each.name: each for each in SCENARIOS}


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda each: each.name)
def test_the_recorded_results_are_those_of_this_model(scenario: Scenario) -> None:
    """If not: run `PROVERIF=PROGRAM python -m tests.proof`, and read what it says."""
    assert results.is_current(scenario, results.read())


def test_nothing_else_is_recorded() -> None:
    assert list(results.read()) == [each.name for each in SCENARIOS]
    assert len(BY_NAME) == len(SCENARIOS)


def test_the_page_shows_the_recorded_results() -> None:
    assert pages.RESULTS.read_text() == pages.results_page()


# The model is that of the code


def signing(*names: str) -> Callable[[Transcript], bytes]:
    """A method in place of `reply_octets` or `final_octets`: these values, in this order."""
    return lambda values: encode_properties([(name, getattr(values, name)) for name in names])


@pytest.mark.parametrize("octets", ["reply_octets", "final_octets"])
def test_another_order_of_what_is_signed_is_another_model(monkeypatch, octets) -> None:
    before = digest(MAIN)
    changed = ("hash_c2", "challenge2", "dh2", "challenge1", "hash_c1", "dh1")
    monkeypatch.setattr(Transcript, octets, signing(*changed))
    assert digest(MAIN) != before


def test_another_property_of_an_introduction_is_another_model(monkeypatch) -> None:
    before = digest(MAIN)
    monkeypatch.setattr(Introduction, "NAMES", (*Introduction.NAMES[:4], "c.other"))
    with pytest.raises(AssertionError):
        assert digest(MAIN) == before


def test_another_size_is_another_model(monkeypatch) -> None:
    before = digest(MAIN)
    monkeypatch.setattr(protocol, "CHALLENGE_SIZE", 16)
    assert digest(MAIN) != before


def test_a_suite_of_the_model_stands_for_agreements_of_one_kind() -> None:
    assert [row for kind in KINDS.values() for row in of_kind(kind)] == sorted(
        KEY_AGREEMENTS, key=lambda row: list(KINDS).index(row.family)
    )
    for row in of_kind("HYBRID"):
        assert {KINDS[part.family] for part in row.parts} in ({"DH", "KEM"}, set())
    for kind, bound in ("DH", False), ("KEM", True), ("HYBRID", True):
        assert {row.binds_transcript for row in of_kind(kind)} == {bound}


@pytest.mark.parametrize("row", list(KEY_AGREEMENTS), ids=lambda row: row.name)
def test_the_shared_secret_is_computed_as_in_the_model(row) -> None:
    secret, signed = b"s" * 32, b"octets"
    bound = hashlib.sha256(signed).digest() if row.binds_transcript else b""
    assert row.shared_secret(secret, signed) == hashlib.sha256(secret + bound).digest()
    (line,) = re.findall(rf"letfun shared_secret_{KINDS[row.family]}\(.*\n?", model(MAIN, "reach"))
    assert ("sha256(signed)" in line) is row.binds_transcript


def test_the_key_of_the_key_exchange_is_derived_as_in_the_model() -> None:
    done = Done(
        peer=None, agreement=None, challenge1=b"1" * 32, challenge2=b"2" * 32, shared_secret=b"k"
    )
    salt, key = (label.encode() for label in LABELS)
    found = key_exchange_material(done)
    ones, twos = done.challenge1, done.challenge2
    assert found.salt == _hmac(ones + salt + twos)
    assert found.sender_key == _hmac(twos + key + ones)


def _hmac(covered: bytes) -> bytes:
    return hmac.digest(hashlib.sha256(covered).digest(), b"k", "sha256")


@pytest.mark.parametrize("version", list(WireVersion))
def test_the_hash_of_an_introduction_covers_what_the_model_says(version) -> None:
    introduction = Introduction(b"id", b"perm", b"data", b"sign", b"agree", version)
    names = re.findall(r"\bn_(\w+),", _hash(version))
    assert names == [
        *(name.replace(".", "_") for name in Introduction.NAMES),
        *(name for name, _ in version.mark),
    ]
    covered = (*introduction.properties, *version.mark)
    assert introduction.digest() == hashlib.sha256(encode_properties(covered)).digest()


def _hash(version: WireVersion) -> str:
    text = model(MAIN, "reach")
    return text[text.index(f"letfun hash_{version.value}(") :].partition(".\n")[0]


# Checks and queries


def test_every_check_of_the_specification_has_a_row() -> None:
    rows = Document("reference/wire.md").table("No.", "Of", "Check")
    assert {row["No."] for row in rows} == {
        name for name in CHECKS if re.fullmatch("C[0-9]+", name)
    }


@pytest.mark.parametrize("name", CHECKS)
def test_a_row_of_the_checks_names_the_scenario_that_shows_it(name: str) -> None:
    row = CHECKS[name]
    parts = set(name.split(" or "))
    if isinstance(row, Needed):
        scenario = BY_NAME[row.scenario]
        assert parts <= scenario.without or name == "C8"  # C8 is which repliers there are
        assert not all(scenario.expected.values())
    elif isinstance(row, Redundant) and row.scenario != EVERYWHERE:
        scenario = BY_NAME[row.scenario]
        assert parts <= scenario.without
        assert all(scenario.expected.values())
        assert parts <= set(ALL_REDUNDANT.split()) or name.startswith("C26.")
    elif isinstance(row, Redundant):
        assert f"(* {name} *)" not in "".join(file.read_text() for file in FOLDER.glob("*.pv"))


def test_the_scenario_with_every_check_has_every_check() -> None:
    assert BY_NAME["hybrid suite, every check"].without == frozenset()
    tagged = set(
        re.findall(
            r"\(\* (C[0-9]+(?:\.\w+)?) \*\)$", (FOLDER / "4-roles.pv").read_text(), re.MULTILINE
        )
    )
    assert tagged <= set(CHECKS)


def test_every_query_is_asked_and_described() -> None:
    asked = {query for each in SCENARIOS for query in each.expected}
    assert asked == set(questions())
    assert all(each[0].islower() for each in questions().values())


# The second tool


@pytest.mark.slow(but=3)
@pytest.mark.interop
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("scenario", bounded.SCENARIOS, ids=lambda each: each.name)
def test_a_bounded_search_finds_the_same_attacks_and_no_others(scenario, requires) -> None:
    requires(shutil.which("maude"), "Maude", "apt-get install maude")
    assert bounded.found(scenario) == bounded.expected(scenario)


def test_a_change_of_the_signed_values_changes_the_bounded_model(monkeypatch) -> None:
    before = bounded.model(bounded.SCENARIOS[0])
    monkeypatch.setattr(Transcript, "final_octets", signing("hash_c1", "hash_c2"))
    assert bounded.model(bounded.SCENARIOS[0]) != before
