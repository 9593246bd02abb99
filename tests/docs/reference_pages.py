"""Writes the pages of docs/reference that are made from the code.

Run `python tests/docs/reference_pages.py` after a change of a help text, an attack, an algorithm, a
limit, a schema or an interpretation. tests/docs/test_reference_pages.py compares them with the
code. Two scripts write the rest: rules_page.py rules.md, and man_pages.py the manual pages.
"""

import sys
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[2]
if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))

from docs.site import generated  # noqa: E402 -- after the path
from examples.study.summary import tables  # noqa: E402
from pqsec_pki.attacks import ATTACKS, Attack  # noqa: E402
from pqsec_pki.attacks.attack import CERTIFICATE, DOCUMENT  # noqa: E402
from pqsec_pki.problems import Code  # noqa: E402
from tests.docs import decisions, rules_page, wire_sizes, wire_tables, yaml_keys  # noqa: E402
from tests.docs.rows import table  # noqa: E402
from tests.proof.pages import RESULTS  # noqa: E402

FOLDER = ROOT / "docs/reference"
MADE = "Generated from {} by `python tests/docs/reference_pages.py`: do not edit this page."


def pages() -> dict[str, Callable[[], str]]:
    """By the file name of each page, a function that makes its text."""
    return {
        "all-commands.md": _commands,
        "attack-list.md": _attacks,
        "decisions.md": lambda: _page("tests/docs/decisions.py", *decisions.parts()),
        "study-tables.md": lambda: _page("`examples/study/results`", *_study()),
        "wire-tables.md": lambda: _page(
            "the tables of algorithms and limits", *wire_tables.parts()
        ),
        "yaml-keys.md": lambda: _page("the JSON Schemas in `schemas/`", *yaml_keys.parts()),
    }


def generated_pages() -> set[Path]:
    """All generated pages, also those of the other scripts."""
    measured = FOLDER / "measured.md"  # tests/interop/test_trials.py
    others = {rules_page.PAGE, wire_sizes.PAGE, measured, RESULTS}
    return {FOLDER / name for name in pages()} | others


def _page(source: str, title: str, *parts: str) -> str:
    return "\n\n".join([title, MADE.format(source), *parts]) + "\n"


def _commands() -> str:
    """All commands, with what `--help` says of each."""
    names = generated.commands()
    sections = [generated.command_section(name, command) for name, command in names.items()]
    index = generated.command_index(lambda name: f"#pqsec-{name.replace(' ', '-')}")
    about = "[The command line](commands.md) has what is common to all of them."
    return _page("the help texts", "# All commands", about, *index, *sections)


def _attacks() -> str:
    """The table of attacks: who, what, and which check refuses it."""
    about = (
        "What [`verify-handshake --attack`](attacks.md) tries. The steps and checks are described"
        "\nthere and in [the wire specification](wire.md#9-what-a-receiver-checks)."
    )
    heads = ("Name", "Attacker", "What the attacker does", "Refused at", "By check")
    return _page(
        "the rows of attacks", "# List of attacks", about, table(heads, map(_row, ATTACKS))
    )


def _study() -> tuple[str, ...]:
    """What was measured for the study."""
    about = (
        "Every result of [the study](../explanation/study.md), which says how it was measured and"
        "\nwhat it shows."
    )
    lines = "\n".join(tables(ROOT / "examples/study/results")).strip()
    return ("# Study: tables", about, lines)


def _row(attack: Attack) -> tuple[str, ...]:
    steps = ", ".join(attack.refused_at)
    return (f"`{attack.name}`", attack.attacker, attack.title, steps, _checks(attack.checks))


def _checks(codes: tuple[Code, ...]) -> str:
    """The numbers of wire.md, section 9, that these codes stand for."""
    groups = dict.fromkeys(CERTIFICATE, 10) | dict.fromkeys(DOCUMENT, 25)
    found = {groups[code] if code in groups else int(code[1:]) for code in codes}
    return ", ".join(f"C{number}" for number in sorted(found))


def main() -> None:
    """Write all pages."""
    for name, made in pages().items():
        (FOLDER / name).write_text(made())


if __name__ == "__main__":
    main()
