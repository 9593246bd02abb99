"""Is each security-relevant condition tested? python -m tests.mutants --jobs 4

Breaks one condition at a time (`conditions.py`) and runs the tests that run it: at least one
must fail. A mutant that survives fails this job, unless `survivors.toml` has its id with the
reason why no test can or need tell; a listed one that is killed is told, to be taken out.

Which tests run a condition is measured first, by coverage, on the files of tests in TESTS; what
none of them runs itself is tried with those that start Python.
Tests of kills, properties and fuzzing are not among them: they run the same code a thousand
times, and what only they find is not named by any test. Nor are those of other implementations.

Why not mutmut or cosmic-ray: both start Python for each mutant and mutate everything, text too;
here two of three mutants would be noise, and each would take its two seconds of imports.

Ends with 0 if each survivor has a reason, 1 if one has none, 3 if the tests fail by themselves.
"""

import argparse
import json
import random
import sys
import tempfile
import time
import tomllib
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path

from tests.mutants.children import Copy, Measured, Ran, warm
from tests.mutants.conditions import ROOMS, Mutant, mutants

TESTS = {
    "credentials": (
        "trust_anchors",
        "one_verdict",
        "selfcheck",
        "plugin_trust",
        "enrolment",
        "install",
        "clocks",
        "bundle_proofs",
    ),
    "smime": ("smime", "smime_readers", "handshake_versions"),
    "certificates": (
        "certificates",
        "chains",
        "short_der",
        "limits",
        "requests",
        "revocation_lists",
        "der_cutting",
        "plugin_lists",
    ),
    "handshake": (
        "handshake",
        "handshake_versions",
        "handshake_wire",
        "protection",
        "tamper",
        "attack_checks",
    ),
    "enrolment": (
        "archive",
        "hostile_archives",
        "offline_ca",
        "enrolment",
        "install",
        "sharing",
        "domain_requests",
        "issue_with_bundles",
        "receipt_import",
        "receipt_order",
        "receipts",
        "clocks",
        "rolled_back",
        "bundle_proofs",
        "bundle_sets",
        "limits",
    ),
    "plugin": ("plugin_*", "bundle_proofs", "places", "cli/test_plugin.py"),
    "access": (
        "access",
        "amending",
        "counterparts",
        "decide",
        "matrix_*",
        "everywhere",
        "diff",
        "sharing",
        "plugin_rights",
        "python_calls",
        "permitting",
    ),
    "approvals": ("approvals", "registration", "domain_orders", "rolled_back"),
    "policy": ("one_verdict", "current_files", "cli/test_questions.py", "cli/test_validate.py"),
    "server": (
        "serve_admission",
        "serve_decisions",
        "serve_calls",
        "serve_clocks",
        "serve_status",
        "serve_tricks",
        "readmission",
        "registration",
        "serve_expired",
        "serve_waiting",
        "serve_work",
        "serve",
        "serve_approvals",
        "serve_balancers",
        "serve_factories",
        "serve_hostile",
        "serve_signed",
    ),
}
"""For each room the files of tests for it: test_*.py in tests/unit, or a path in tests."""

KILLED, SURVIVED, NO_TEST, HANGS = "killed", "survived", "run by no test", "hangs"
SURVIVING = {SURVIVED, NO_TEST}
FAILING = {1, 2, 4}
"""pytest's exit codes where a test fails, and where one cannot be imported."""
MEASURING = 1800.0
"""Seconds for one file of tests."""


@dataclass
class Run:
    """What came of which mutant."""

    copies: list[Copy]
    measured: Measured
    results: dict[str, str] = field(default_factory=dict)
    killers: dict[str, str] = field(default_factory=dict)
    _reliable: dict[str, bool] = field(default_factory=dict)

    def all(self, wanted: list[Mutant], until: float | None) -> None:
        """Run them, as many at once as there are copies; none is started after `until`."""
        waiting = list(reversed(wanted))
        running: list[tuple[Copy, Mutant]] = []
        free = list(self.copies)
        while waiting or running:
            while waiting and free and (until is None or time.time() < until):
                mutant = waiting.pop()
                tests = self.measured.running(mutant)
                if not tests:
                    self._tell(mutant, NO_TEST)
                    continue
                copy = free.pop()
                copy.start(self.measured.limits(tests), mutant, "-x")
                running.append((copy, mutant))
            if not running:
                return
            for copy, mutant in list(running):
                ran = copy.ended()
                if ran is not None:
                    running.remove((copy, mutant))
                    self._tell(mutant, self._result(copy, mutant, ran), ran.failed or "")
                    free.append(copy)
            time.sleep(0.02)

    def _result(self, copy: Copy, mutant: Mutant, ran: Ran) -> str:
        if ran.code is None:
            return HANGS
        if ran.code == 0:
            return SURVIVED
        # What fails without the mutant as well, when it runs alone, tells nothing of it.
        tests = [ran.failed] if ran.failed else self.measured.running(mutant)
        if ran.code not in FAILING or not self._pass_without(copy, tests, collect=not ran.failed):
            raise RuntimeError(f"it was not {mutant.id} that failed {tests}: {copy.log[-4000:]}")
        return KILLED

    def _pass_without(self, copy: Copy, tests: list[str], *, collect: bool) -> bool:
        key = "\n".join(tests)
        if key not in self._reliable:
            options = ("--collect-only",) if collect else ()
            ran = copy.run(self.measured.limits(tests), None, *options)
            self._reliable[key] = ran.code == 0
        return self._reliable[key]

    def _tell(self, mutant: Mutant, result: str, killer: str = "") -> None:
        self.results[mutant.id] = result
        self.killers[mutant.id] = killer
        print(f"{result:14}  {mutant.id}  {killer}", flush=True)
        if result in SURVIVING:
            print(f"    line {mutant.lines[0]}: {mutant.condition}\n    -> {mutant.replacement}")


def test_files(root: Path, rooms: tuple[str, ...]) -> list[str]:
    """For those rooms."""
    patterns = dict.fromkeys(pattern for room in rooms for pattern in TESTS[room])
    found = [path for pattern in patterns for path in paths(root, pattern)]
    return [str(path.relative_to(root)) for path in dict.fromkeys(found)]


def paths(root: Path, pattern: str) -> list[Path]:
    """The files of a pattern in TESTS."""
    name = pattern if "/" in pattern else f"unit/test_{pattern}.py"
    return sorted((root / "tests").glob(name))


def accepted(root: Path) -> dict[str, str]:
    """Survivors with their reasons."""
    path = root / "tests/mutants/survivors.toml"
    return tomllib.loads(path.read_text()) if path.exists() else {}


def unjudged(root: Path) -> set[str]:
    """Survivors that were found, and have neither a test nor a reason yet."""
    path = root / "tests/mutants/unjudged.txt"
    return set(path.read_text().split()) if path.exists() else set()


def table(wanted: list[Mutant], results: dict[str, str]) -> str:
    """Results of each room."""
    kinds = (KILLED, HANGS, SURVIVED, NO_TEST)
    rows = [("room", "mutants", "run", *kinds)]
    for room in dict.fromkeys(each.room for each in wanted):
        ids = [each.id for each in wanted if each.room == room]
        counted = Counter(results[each] for each in ids if each in results)
        rows.append((room, len(ids), counted.total(), *(counted[kind] for kind in kinds)))
    rows.append(("all", *(sum(column) for column in list(zip(*rows[1:], strict=True))[1:])))
    return "\n".join(f"{row[0]:14}" + "".join(f"{cell:>16}" for cell in row[1:]) for row in rows)


def verdict(
    known: set[str], results: dict[str, str], reasons: dict[str, str], debts: set[str]
) -> int:
    """Say what is not as it is listed; the exit code."""
    bad = sorted(key for key, result in results.items() if result in SURVIVING)
    unlisted = [each for each in bad if each not in {*reasons, *debts}]
    for each in unlisted:
        print(f"survived, without a reason in survivors.toml: {each}")
    print(f"survived, and not judged yet: {len(debts.intersection(bad))} of {len(debts)}")
    for each in sorted({*reasons, *debts}):
        if each not in known:
            print(f"listed as a survivor, and not a mutant: {each}")
        elif results.get(each) in {KILLED, HANGS}:
            print(f"listed as a survivor, and killed: {each}")
    return 1 if unlisted else 0


def options() -> argparse.ArgumentParser:
    """Of the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.mutants",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--root", type=Path, default=Path(), help="the checkout")
    parser.add_argument("--room", action="append", choices=ROOMS, help="this room alone")
    parser.add_argument("--id", action="append", help="this mutant alone")
    parser.add_argument("--sample", type=int, help="so many, drawn by --seed")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--part", help="2/5 is the second of five parts, of few rooms")
    parser.add_argument("--jobs", type=int, default=1, help="so many at once")
    parser.add_argument("--minutes", type=float, help="start none after that")
    parser.add_argument("--list", action="store_true", help="say which there are, and run none")
    parser.add_argument("--measured", type=Path, help="keep what was measured here, and use it")
    parser.add_argument("--json", type=Path, help="write results here")
    return parser


def measured(copy: Copy, files: list[str], kept: Path | None) -> Measured:
    """By running them, unless it is kept; the copy has their bytecode then."""
    if kept and kept.exists():
        copy.run(dict.fromkeys(files, MEASURING), None, "--collect-only")
        read = json.loads(kept.read_text())
        lines = {
            path: {int(line): tests for line, tests in found.items()}
            for path, found in read["tests"].items()
        }
        return Measured(read["seconds"], lines, read["starting"])
    result = Measured.by(copy, files, MEASURING)
    if kept:
        kept.write_text(json.dumps(asdict(result)))
    return result


def main() -> int:
    chosen = options().parse_args()
    until = chosen.minutes and time.time() + 60 * chosen.minutes
    rooms = tuple(chosen.room or ROOMS)
    every = mutants(chosen.root, rooms)
    wanted = [each for each in every if not chosen.id or each.id in chosen.id]
    if chosen.sample is not None and chosen.sample < len(wanted):
        wanted = random.Random(chosen.seed).sample(wanted, chosen.sample)  # noqa: S311 -- a draw
    if chosen.part:
        part, parts = map(int, chosen.part.split("/"))
        wanted = wanted[len(wanted) * (part - 1) // parts : len(wanted) * part // parts]
        rooms = tuple(dict.fromkeys(each.room for each in wanted))
    if chosen.list:
        for each in wanted:
            print(each.id)
        return 0
    warm()
    with tempfile.TemporaryDirectory(prefix="pqsec-mutants-") as folder:
        folders = [Path(folder).resolve() / str(number) for number in range(chosen.jobs)]
        first = Copy.made(chosen.root, folders[0])
        try:
            found = measured(first, test_files(chosen.root, rooms), chosen.measured)
            others = [Copy.made(chosen.root, each, compiled=first) for each in folders[1:]]
            run = Run([first, *others], found)
            run.all(wanted, until)
        except RuntimeError as error:
            print(error, file=sys.stderr)
            return 3
    print(table(wanted, run.results))
    if chosen.json:
        chosen.json.write_text(
            json.dumps({"results": run.results, "killers": run.killers}, indent=1)
        )
    reasons = {
        key: why for key, why in accepted(chosen.root).items() if key.partition("/")[0] in rooms
    }
    debts = {each for each in unjudged(chosen.root) if each.partition("/")[0] in rooms}
    return verdict({each.id for each in every}, run.results, reasons, debts)


if __name__ == "__main__":
    sys.exit(main())
