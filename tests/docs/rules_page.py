"""Makes docs/reference/rules.md of the rules themselves: run `python tests/docs/rules_page.py`."""

import json
import re
import sys
from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path
from textwrap import fill

ROOT = Path(__file__).parents[2]
if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))

from pqsec_pki.lint import RULES, Rule, Severity, stacks_text  # noqa: E402 -- after the path
from pqsec_pki.lint.documents._extensions import ROWS  # noqa: E402
from pqsec_pki.lint.documents.markup import UNREADABLE  # noqa: E402
from tests.docs.rows import row as _row  # noqa: E402
from tests.docs.stack_differences import HABITS, Habit  # noqa: E402

PAGE = ROOT / "docs/reference/rules.md"
MEASURED = json.loads((Path(__file__).parent / "measured.json").read_text())
STACKS = ("Cyclone 0.10.2", "0.10.5", "11.0.1", "Fast 2.9.1", "3.1.2", "3.6.2")
FAMILIES = {
    "0": ("The check itself", "files that cannot be read, and suppressions"),
    "1": ("Certificates, revocation lists, private keys", "one file by itself"),
    "2": ("Documents", "governance and permissions: how they are written, and what they mean"),
    "3": ("Files that belong together", "an enclave, a keystore, a document and its signature"),
    "4": ("Names", "subjects that stacks confuse, refuse, or cannot read"),
    "5": ("Size", "of what is sent in the handshake"),
    "6": ("Post-quantum", "what is missing, weak, or not for stock stacks"),
    "7": ("Files on disk", "who can read and change them"),
    "8": ("Configurations", "profiles of Fast DDS with security properties"),
}
HEAD = """# Rules

What [`pqsec check`](commands.md#what-check-reports) looks for. `tests/docs/rules_page.py`
generates this page from the rules; `pqsec check --explain ID` prints one of them.

An **error** fails on the stacks that it names, or is a security hole. A **warning** is a risk. An
**info** may be intended. With `--target`, a finding that names stacks is reported only if one of
them is a target; without it, all stacks are judged, and a finding says for which it holds. Some
findings hold for fewer stacks than their rule. A rule that is *checked only with* a target reports
what is correct for other stacks.

Versions in "Known from" were run; sources that were only read are named as such.

Each rule has an example that the tests run. In XML, `...` stands for the other elements of a
document. Commands run beside a keystore `k` with the participants /talker and /listener, and the
folder `elsewhere` has files that other programs made."""
ACCEPTED = """## What stacks accept

Two processes of one stack met with security, and one thing in their files was different. A: they
communicated. R: they did not. X: a process crashed. The last column has the rules that report it,
or the reason why no rule does."""
BEYOND = """## What stacks take beyond the schema

Elements that DDS-Security 1.1 does not have: an error (PQS209, PQS210) for the other stacks, an
info for the stack that takes them. RTI Connext was not run: the rows are from its documents, with
the oldest version that was found there. UM is the RTI Security Plugins User's Manual, MG the RTI
Connext Migration Guide, examples those of rticommunity/rticonnextdds-examples. Connext also skips
each element with `must_interpret="false"` (MG 7.4.0)."""
MARKUP = """## Markup that Cyclone DDS cannot read

What PQS278 finds. `tests/interop/test_markup.py` compares each row with the stack."""
READ = """## How stacks differ

From the standard, or from each other: measured through their plugins (Cyclone DDS, Fast DDS), or
read in their source (OpenDDS)."""


def page() -> str:
    """The text of docs/reference/rules.md."""
    parts = [HEAD]
    for digit, rules in groupby(RULES.values(), lambda rule: rule.id[3]):
        title, what = FAMILIES[digit]
        parts += [f"## {title}", f"{digit}xx: {what}.", *map(rule_page, rules)]
    parts += [ACCEPTED, _accepted(), BEYOND, _beyond(), MARKUP, _markup(), READ, _read()]
    return "\n\n".join(parts) + "\n"


def rules_of(variant: str) -> list[str]:
    """The rules that stand on that row of the measurements."""
    return [rule.id for rule in RULES.values() if variant in rule.rows]


def is_refused(row: dict[str, str]) -> bool:
    """Whether some stack did not take it."""
    return bool(set(row["verdicts"]) & set("RX"))


def rule_page(rule: Rule) -> str:
    """The section of one rule, in Markdown: severity, reason, example, and fix."""
    stacks = stacks_text(rule.stacks) or "all stacks"
    asked = f", checked only with `--target {'` or `'.join(sorted(rule.stacks))}`"
    kind = f"**{Severity(rule.severity)}**, {stacks}{asked if rule.only_when_asked else ''}."
    more = "" if rule.measured == stacks_text(rule.stacks) else rule.measured
    known = [f"Known from: {_plain(more)}."] if more else []
    parts = [
        f"### {rule.id}: {_plain(rule.title)}",
        _wrapped(f"{kind} {_plain(rule.why)}"),
        "Found here:",
        _block(rule.bad),
        _wrapped(f"To fix it: {_plain(rule.fix)}"),
        _block(rule.good),
        *map(_wrapped, known),
    ]
    return "\n\n".join(parts)


def _block(example: str) -> str:
    language = {"<": "xml", "$": "sh"}.get(example[0], "yaml")
    return f"```{language}\n{example}\n```"


def _accepted() -> str:
    lines = [_row(("Variant", *STACKS, "Rules")), _row(["---"] * (len(STACKS) + 2))]
    for group, rows in groupby(MEASURED, lambda row: row["group"]):
        lines.append(_row((f"**{group}**", *[""] * (len(STACKS) + 1))))
        for row in rows:
            told = row.get("why") or (_ids(rules_of(row["variant"])) if is_refused(row) else "")
            lines.append(_row((row["variant"], *row["verdicts"], told)))
    return "\n".join(lines)


def _beyond() -> str:
    lines = [_row(("Stack", "Element", "In", "Source")), _row(["---"] * 4)]
    for stack, elements in ROWS.items():
        for each in elements:
            parents = ", ".join(f"`<{parent}>`" for parent in each.parents)
            name = stacks_text({stack: each.versions})
            lines.append(_row((name, f"`<{each.tag}>`", parents, each.source)))
    return "\n".join(lines)


def _markup() -> str:
    lines = [_row(("Markup", "Stacks", "Instead")), _row(["---"] * 3)]
    rows = (
        _row((_plain(each.words), stacks_text(each.stacks), _plain(each.fix)))
        for each in UNREADABLE
    )
    return "\n".join([*lines, *rows])


def _read() -> str:
    lines = [_row(("Stack", "What it does", "Rules")), _row(["---"] * 3)]
    return "\n".join([*lines, *map(_habit, HABITS)])


def _habit(habit: Habit) -> str:
    return _row((habit.stack, _plain(habit.what), _ids(habit.rules) or habit.told_by))


def _ids(ids: Iterable[str]) -> str:
    return ", ".join(ids)


def _wrapped(text: str) -> str:
    return fill(text, 100, break_long_words=False, break_on_hyphens=False)


def _plain(text: str) -> str:
    """With the marks of Markdown taken for what they are, but for `code`."""
    return "".join(_escaped(re.split("(`[^`]*`)", text)))


def _escaped(parts: Iterable[str]) -> Iterator[str]:
    for part in parts:
        yield part if part.startswith("`") else re.sub(r"([\\<*\[\]])", r"\\\1", part)


if __name__ == "__main__":
    PAGE.write_text(page())
