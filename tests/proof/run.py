"""Runs ProVerif, which the environment variable PROVERIF names, on the model of each scenario."""

import os
import re
import subprocess
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.proof.model import Scenario, model

LIMIT = 900
"""Seconds for one query."""
_VERDICTS = {"is true.": "holds", "is false.": "fails", "cannot be proved.": "open"}


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What ProVerif says of one query."""

    query: str
    found: str
    """holds, fails (ProVerif shows the attack), open (it can say neither), or what went wrong."""
    expected: str
    seconds: float

    @property
    def good(self) -> bool:
        """Whether it is what was expected."""
        return self.found == self.expected


def run(scenario: Scenario) -> Iterator[Verdict]:
    """The verdicts, one after the other; first that every end of a handshake can be reached."""
    wanted = {"reach": False, **scenario.expected}
    for query, holds in wanted.items():
        start = time.monotonic()
        found = "/".join(sorted(set(_verdicts(model(scenario, query)))))
        expected = "holds" if holds else "fails"
        seconds = time.monotonic() - start
        yield Verdict(query=query, found=found, expected=expected, seconds=seconds)


def _verdicts(text: str) -> list[str]:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "model.pv"
        file.write_text(text)
        command = [os.environ["PROVERIF"], str(file)]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=LIMIT, check=False
            )
        except subprocess.TimeoutExpired:
            return [f"no answer after {LIMIT} seconds"]
    results = re.findall(
        r"^RESULT .*?(is true\.|is false\.|cannot be proved\.)", done.stdout, re.MULTILINE
    )
    if done.returncode or not results:
        return [f"error: {(done.stdout + done.stderr).strip()[-300:]}"]
    return [_VERDICTS[each] for each in results]
