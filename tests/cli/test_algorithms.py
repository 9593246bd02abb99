"""pqsec profiles and pqsec algorithms: what is told before anything is made."""

import pytest

from tests.cli.conftest import NAMES

LEVELS = {"transition": 3, "hybrid": 3, "pq": 3, "cnsa2": 5, "classical": 0}
NONE = "no stock stack today"
RUNS_IN = {
    "transition": "all stock stacks but Fast DDS 2.14.4, 3.0.2, 3.1.1 to 3.1.3 and 3.2.0 to 3.2.2"
    " (8192-byte limit)",
    "hybrid": NONE,
    "pq": NONE,
    "cnsa2": NONE,
    "classical": "all stock stacks",
}


def told(pqsec):
    """The lines of `pqsec profiles`, by profile: the first one, and label -> words."""
    blocks = [block.splitlines() for block in pqsec("profiles").done().out.split("\n\n")]
    split = [
        (first, {line[2:24].rstrip(): line[24:] for line in reversed(rest)})
        for first, *rest in blocks
    ]
    return dict(zip(NAMES, split, strict=True))


@pytest.mark.parametrize("profile", NAMES)
def test_a_profile_is_told_with_its_level_and_the_stacks_it_runs_in(pqsec, profile):
    first, lines = told(pqsec)[profile]
    default = " (default)" if profile == "transition" else ""
    [value] = [
        each for each in pqsec("profiles --json").json["profiles"] if each["profile"] == profile
    ]
    assert first == f"{profile}{default}: {value['summary']}"
    level = str(LEVELS[profile]) if LEVELS[profile] else "0: broken by a quantum computer"
    assert lines["NIST level"] == level
    assert lines["runs in"] == RUNS_IN[profile]
    assert lines["key agreement"] == value["key_agreement"]
    assert lines["promises"] == value["promises"][0]
    assert list(reversed(lines)) == [
        "keys and documents",
        "key agreement",
        "NIST level",
        "runs in",
        "promises",
    ]


def test_profiles_in_json_tell_the_same(pqsec):
    values = pqsec("profiles --json").done().json["profiles"]
    assert {each["profile"]: each["level"] for each in values} == LEVELS
    assert {each["profile"]: each["runs_in"] for each in values} == RUNS_IN
    assert [each["profile"] for each in values if each["default"]] == ["transition"]


def test_algorithms_that_no_stock_stack_runs_are_told_as_such(pqsec):
    values = pqsec("algorithms --json").done().json
    stacks = [(each["family"], each["identities_run_in"]) for each in values["signatures"]]
    stacks += [(each["family"], each["runs_in"]) for each in values["key_agreements"]]
    assert {words for family, words in stacks if family != "classical"} == {NONE}
    assert NONE not in {words for family, words in stacks if family == "classical"}
    out = pqsec("algorithms").done().out
    assert out.count(f"  {NONE}  ") == [words for _, words in stacks].count(NONE)
    for each in values["signatures"] + values["key_agreements"]:
        [line] = [line for line in out.splitlines() if line.startswith(f"{each['name']} ")]
        assert f"  {each.get('identities_run_in') or each['runs_in']}  " in line


def test_an_experimental_algorithm_is_told_as_such(pqsec):
    values = pqsec("algorithms --json").done().json
    rows = values["signatures"] + values["key_agreements"]
    assert [each["name"] for each in rows if each["experimental"]] == ["xwing"]
    assert "xwing (experimental)  " in pqsec("algorithms").done().out
    assert "xwing" not in pqsec("profiles").out


@pytest.mark.parametrize("line", ["profiles", "algorithms"])
def test_nothing_is_told_of_a_plugin(pqsec, line):
    assert "plugin" not in pqsec(line).out + pqsec(f"{line} --json").out
