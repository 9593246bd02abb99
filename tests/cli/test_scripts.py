"""The scenarios in scripts/*.txt: commands, what they print, and how they end.

A file has scenarios, each below its name, and each is run in a folder of its own:

    == NAME                 begins a scenario; what comes before the first one is part of each
    -- FILE --              the lines below it are written to FILE, up to the next `$`, `--` or `==`
    $ pqsec ...             runs pqsec in this process; variables may come first: A=b pqsec ...
    $ keystore PROFILE      copies a keystore `k` of that profile, with /talker and /listener
    $ anything else         is for bash
    $ command  # exit 1     must end with that code; without the mark, with 0
    anything below it       is what it prints, first on stdout, then on stderr; `...` is any text
    # text                  is a comment

A command without lines below it may print anything, but no error if it ends with 0. The documents'
console blocks have the same marks (tests/docs/test_documents_run.py). prysk and scruf read similar
files, but start a process for each command, which takes much longer than a command in this process.
"""

import re
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.cli.conftest import clean_environment
from tests.printed import same

SCRIPTS = Path(__file__).with_name("scripts")
PQSEC = re.compile(r"((?:[A-Z_]+=\S* )*)pqsec (.*)", re.DOTALL)
EXIT = re.compile(r"  # exit ([0-9]+)\Z")


ERRORS_AS_JSON = '{"version": 1, "errors": ['


@dataclass(slots=True)
class Step:
    """A command with what it prints, or a file with its content."""

    place: str
    text: str
    is_file: bool = False
    lines: list[str] = field(default_factory=list)

    @property
    def command(self) -> str:
        return EXIT.sub("", self.text)

    @property
    def exit_code(self) -> int:
        found = EXIT.search(self.text)
        return int(found[1]) if found else 0


def scenarios(path: Path) -> dict[str, list[Step]]:
    """Name -> steps, with those that all scenarios of the file share."""
    found: dict[str, list[Step]] = {"": []}
    steps = found[""]
    for number, line in enumerate(path.read_text().splitlines(), start=1):
        place = f"{path.name}:{number}"
        if line.startswith("== "):
            assert line.removeprefix("== ") not in found, place
            steps = found[line.removeprefix("== ")] = []
        elif line.startswith("$ "):
            steps.append(Step(place, line.removeprefix("$ ")))
        elif file := re.fullmatch("-- (.+) --", line):
            steps.append(Step(place, file[1], is_file=True))
        elif steps and (steps[-1].is_file or not line.startswith("# ")):
            steps[-1].lines.append(line)
        else:
            assert not line or line.startswith("# "), place
    shared = found.pop("")
    return {name: [*shared, *steps] for name, steps in found.items()}


ALL = [
    pytest.param(steps, id=f"{path.stem}: {name}")
    for path in sorted(SCRIPTS.glob("*.txt"))
    for name, steps in scenarios(path).items()
]


@pytest.fixture
def perform(run_in, keystore, tmp_path):
    """perform(step) does it in the scenario's folder: its exit code, stdout and stderr."""

    def performed(step):
        if step.is_file:
            (tmp_path / step.text).write_text("\n".join(step.lines).rstrip() + "\n")
            return 0, "", ""
        if step.command.startswith("keystore "):
            keystore(*step.command.split()[1:])
            return 0, "", ""
        if found := PQSEC.fullmatch(step.command):
            variables = dict(each.split("=", 1) for each in found[1].split())
            said = run_in(tmp_path, found[2], **variables)
            return said.code, said.out, said.err
        done = subprocess.run(
            ["bash", "-c", step.command],
            cwd=tmp_path,
            env=clean_environment(),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        return done.returncode, done.stdout, done.stderr

    return performed


@pytest.mark.parametrize("steps", ALL)
def test_a_script_runs_as_it_says(perform, steps):
    for step in steps:
        code, out, err = perform(step)
        told = f"{step.place}: {step.text}\nexit {code}\n{out}{err}"
        assert code == step.exit_code, told
        if step.command.startswith("pqsec "):  # the form of all that pqsec says on stderr
            forms = ("pqsec: ", ERRORS_AS_JSON)
            assert all(line.startswith(forms) for line in err.splitlines()), told
            is_error = "pqsec: error: " in err or err.startswith(ERRORS_AS_JSON)
            assert (code > 1) <= is_error <= (code > 0), told
        if step.lines and not step.is_file and any(step.lines):
            wanted = "\n".join(step.lines)
            assert same(step.lines, out + err), f"{told}and not:\n{wanted}"


def test_there_are_scripts():
    assert len(ALL) > 20
