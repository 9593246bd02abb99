"""The recorded results: docs/proof/results.json, by scenario."""

import json
from collections.abc import Mapping
from typing import Any

from tests.proof.model import FOLDER, Scenario, digest
from tests.proof.scenarios import SCENARIOS

FILE = FOLDER / "results.json"


def read() -> dict[str, Any]:
    """Scenario -> the digest of its models, and what ProVerif said of each query."""
    found: dict[str, Any] = json.loads(FILE.read_text()) if FILE.exists() else {}
    return found


def record(scenario: Scenario, verdicts: Mapping[str, str]) -> None:
    """Add the verdicts; scenarios that are no longer there are dropped."""
    found = read() | {scenario.name: {"model": digest(scenario), "verdicts": dict(verdicts)}}
    kept = {each.name: found[each.name] for each in SCENARIOS if each.name in found}
    FILE.write_text(json.dumps(kept, indent=1) + "\n")


def is_current(scenario: Scenario, recorded: Mapping[str, Any]) -> bool:
    """Whether these models were run, and every verdict is the expected one."""
    words = {True: "holds", False: "fails"}
    due = {query: words[holds] for query, holds in scenario.expected.items()}
    return bool(
        recorded.get(scenario.name)
        == {"model": digest(scenario), "verdicts": {"reach": "fails", **due}}
    )
