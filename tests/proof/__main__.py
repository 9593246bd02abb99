"""`PROVERIF=PROGRAM python -m tests.proof` proves again what has changed, and records the results.

python -m tests.proof                 the scenarios whose model is not the recorded one
python -m tests.proof --all           all of them
python -m tests.proof WORDS...        those with one of these in their names, recorded or not
python -m tests.proof show NAME QUERY the model of a scenario; it needs no ProVerif
python -m tests.proof pages           write results.md from the recorded results
"""

import sys
from collections.abc import Iterator

from tests.proof import pages, results
from tests.proof.model import Scenario, digest, model
from tests.proof.run import run
from tests.proof.scenarios import SCENARIOS


def main(words: list[str]) -> int:
    """The exit code: 1 if a verdict is not the expected one."""
    if words[:1] == ["show"]:
        (scenario,) = (each for each in SCENARIOS if each.name == words[1])
        sys.stdout.write(model(scenario, words[2]))
        return 0
    bad = 0
    for scenario in [] if words == ["pages"] else _wanted(words):
        bad += _prove(scenario)
    pages.write()
    return 1 if bad else 0


def _wanted(words: list[str]) -> Iterator[Scenario]:
    for each in SCENARIOS:
        named = words == ["--all"] or any(word in each.name for word in words)
        if named or (not words and not results.is_current(each, results.read())):
            yield each


def _prove(scenario: Scenario) -> int:
    """The number of unexpected verdicts."""
    print(scenario.name, flush=True)
    verdicts = []
    before = digest(scenario)
    for each in run(scenario):
        mark = "" if each.good else f", but expected: {each.expected}"
        print(f"  {each.query}: {each.found}{mark} ({each.seconds:.1f} s)", flush=True)
        verdicts.append(each)
    if digest(scenario) == before:
        results.record(scenario, {each.query: each.found for each in verdicts})
    return sum(not each.good for each in verdicts)


sys.exit(main(sys.argv[1:]))
