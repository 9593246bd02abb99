"""docs/proof/results.md: the checks, the queries, and the scenarios with their results."""

from collections.abc import Iterator

from tests.docs.rows import table
from tests.proof import results
from tests.proof.checks import CHECKS, EVERYWHERE, Needed, Outside, Redundant
from tests.proof.model import FOLDER, questions
from tests.proof.scenarios import GROUPS

RESULTS = FOLDER / "results.md"


def write() -> None:
    """Write the page."""
    RESULTS.write_text(results_page())


def checks() -> str:
    """The table of checks."""
    heads = ("Check", "Without it", "Scenario")
    return table(heads, ([name, *_cells(row)] for name, row in CHECKS.items()))


def _cells(row: Needed | Redundant | Outside) -> tuple[str, str]:
    match row:
        case Needed(scenario, attack):
            return f"**attack**: {attack}", scenario
        case Redundant(why, scenario):
            shown = "all: none has it" if scenario == EVERYWHERE else scenario
            return f"none: {why}", shown
        case Outside(assumption):
            return f"not in the model, which assumes: {assumption}", ""


def results_page() -> str:
    """The page with all scenarios and what ProVerif says of each query."""
    made = "Generated from `docs/proof/results.json` by `python -m tests.proof`: do not edit it."
    parts = ["# Results of the proof", made, _about(), "## The checks", checks()]
    parts += ["## Queries", _questions(), *_groups()]
    return "\n\n".join(parts) + "\n"


def _about() -> str:
    return """\
[The proof](README.md) describes the model. In each scenario every end of a handshake can be
reached, so no query holds because nothing happens. Unless its name says `every check`, a scenario
lacks the checks of discovery and of repeated values: C12, C14, C15, C19, C20, C23. What holds
without a check also holds with it."""


def _questions() -> str:
    rows = ((f"`{name}`", text) for name, text in questions().items())
    return table(("Query", "What it asks"), rows)


def _groups() -> Iterator[str]:
    recorded = results.read()
    for title, scenarios in GROUPS.items():
        yield f"## {title}"
        rows = []
        for each in scenarios:
            verdicts = recorded.get(each.name, {}).get("verdicts", {})
            rows.append((each.name, *(_named(verdicts, word) for word in ("holds", "fails"))))
        yield table(("Scenario", "Holds", "Attack found"), rows)


def _named(verdicts: dict[str, str], word: str) -> str:
    return ", ".join(name for name, found in verdicts.items() if found == word and name != "reach")
