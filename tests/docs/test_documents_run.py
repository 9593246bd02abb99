"""The documents tell the truth: their commands run, and print what they say.

Every ```console block of README.md, docs/ and examples/ is run, in order, in one empty
folder per file; an example's other files are in its folder. In a block, a line

    $ command           is a command for bash; the same folder and variables as the last one
    > more              goes on with it
    $ command  # exit 1 is to end with that code; without the mark, with 0
    anything else       is what it prints, both streams; `...` stands for any text
    text  # without X   is printed only where X, one of ABSENT, is not there

A command without output below it may print what it likes. At a command that runs something
of OTHERS which is not there, the rest of the document is skipped, and it is said why. The
blocks marked ```sh set things up (they install packages), or are for other machines, and are
not run here. The ```python blocks of a document are one program, and `# prints: ` in it starts
a line that it prints.
"""

import math
import os
import re
import shutil
import signal
import subprocess
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import click
import pytest

import pqsec_pki
from pqsec_pki.cli import COMMANDS, GROUPS, pqsec
from pqsec_pki.trial import MissingStackError, find
from pqsec_pki.vendors.cyclone_plugins import find_cyclone_plugins
from tests.docs.forking import forking_pqsec
from tests.interop.fastdds_shim import find_compiler
from tests.printed import same

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
ABOUT = [ROOT / f"{name}.md" for name in ("CHANGELOG", "CONTRIBUTING", "SECURITY")]
DOCUMENTS = [
    README,
    *ABOUT,
    *sorted(ROOT.glob("docs/**/*.md")),
    ROOT / "tests/interop/README.md",
    *sorted(ROOT.glob("examples/*/README.md")),
]
RUN = "python3 -m venv .venv && .venv/bin/pip install . && .venv/bin/pqsec demo"
TEST = (
    "python3 -m venv .venv-test && .venv-test/bin/pip install '.[test]'"
    " && .venv-test/bin/python -m pytest"
)
PATIENCE = 300
"""Seconds for one command."""
SIGNS_AGAIN = re.compile(r"\bpqsec\b.*\b(renew|permit|issue|apply|rotate|sign-\w+)\b")
"""Commands that sign what may replace something: it must be newer, and times of certificates have
whole seconds. Nobody types so fast."""


@dataclass(slots=True)
class Command:
    """One command of a block, and what the block says of it."""

    line: int
    text: str
    output: list[str] = field(default_factory=list)

    @property
    def exit_code(self) -> int:
        found = re.search(r"# exit ([0-9]+)$", self.text)
        return int(found[1]) if found else 0


def blocks(path: Path, language: str) -> list[tuple[int, list[str]]]:
    """(number of the first line, lines) of each block of that language."""
    found: list[tuple[int, list[str]]] = []
    inside = None
    for number, line in enumerate(path.read_text().splitlines(), start=1):
        if inside is None and line.startswith("```"):
            inside = line.removeprefix("```")
            found += [(number + 1, [])] if inside == language else []
        elif line == "```":
            inside = None
        elif inside == language:
            found[-1][1].append(line)
    return found


def commands_in(path: Path) -> list[Command]:
    """The commands of the file's console blocks."""
    found: list[Command] = []
    for start, lines in blocks(path, "console"):
        assert lines[0].startswith("$ "), f"{path}:{start}: a console block starts with a command"
        for number, line in enumerate(lines, start=start):
            if line.startswith("$ "):
                found.append(Command(number, line.removeprefix("$ ")))
            elif line.startswith("> "):
                found[-1].text += "\n" + line.removeprefix("> ")
            else:
                found[-1].output.append(line)
    return found


class Session:
    """A folder, and bash processes that hand their variables on."""

    def __init__(self, folder: Path, programs: Path) -> None:
        self.work = folder / "work"
        self.work.mkdir()
        self._groups = folder / "groups"
        self._groups.touch()
        self._next_second = 0.0
        self._variables = folder / "variables"
        self._variables.touch()
        ours = re.compile("PQSEC_|ROS_|COV_|PYTHON")
        kept = {name: value for name, value in os.environ.items() if not ours.match(name)}
        checkout = Path(pqsec_pki.__file__).parents[1]
        self._environment = kept | {
            "PATH": f"{programs}:{os.environ['PATH']}",
            "PYTHONPATH": str(checkout),
            "XDG_CACHE_HOME": str(folder / "cache"),
        }

    def run(self, command: str) -> tuple[int, str]:
        """(exit code, output of both streams)."""
        if SIGNS_AGAIN.search(command):
            time.sleep(max(0.0, self._next_second - time.time()))
        script = (
            f'echo $$ >> "{self._groups}"\n. "{self._variables}"\n{command}\n'
            f'code=$?\nexport -p > "{self._variables}"\nexit $code'
        )
        done = subprocess.run(
            ["bash", "-c", script],
            cwd=self.work,
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=PATIENCE,
            check=False,
            start_new_session=True,
        )
        self._next_second = math.floor(time.time()) + 1.01
        return done.returncode, done.stdout

    def logs(self) -> str:
        """What servers, stacks and the agent have logged, to explain a failure."""
        return self.run("tail -n 9 *.log; pqsec agent status; pqsec agent log | tail -n 99")[1]

    def end(self) -> None:
        """End what commands have left in the background."""
        for group in self._groups.read_text().split():
            with suppress(ProcessLookupError):
                os.killpg(int(group), signal.SIGTERM)


ABSENT = {"Cyclone DDS": lambda: find_cyclone_plugins(Path("/")) is None}
"""What a document may say is not there -> whether it is not."""


def said_here(lines: list[str]) -> list[str]:
    """What a command prints on this machine."""
    found = []
    for line in lines:
        text, mark, what = line.partition("  # without ")
        if not mark or ABSENT[what]():
            found.append(text)
    return found


OTHERS = {
    "pqsec plugin install": ("a C compiler", "apt-get install gcc libc6-dev"),
    "pqsec try cyclonedds": (
        "Cyclone DDS with its headers",
        "apt-get install gcc libc6-dev cyclonedds-dev cyclonedds-tools",
    ),
    "openssl": ("openssl", "apt-get install openssl"),
    "ddsperf": ("cyclonedds-tools", "apt-get install cyclonedds-tools"),
    "g++": ("g++ with Fast DDS's headers", "apt-get install g++ libfastrtps-dev"),
}
"""Program -> (what must be there to run it, how to get that)."""


def others_in(text: str) -> list[str]:
    """The programs of others that a command runs."""
    return [name for name in OTHERS if re.search(rf"(?<![\w-]){re.escape(name)} ", text)]


def _found(program: str) -> str | None:
    if program == "g++":
        return find_compiler()
    if program == "pqsec try cyclonedds":
        try:
            return str(find("cyclonedds"))
        except MissingStackError:
            return None
    return shutil.which("cc" if program == "pqsec plugin install" else program)


def _parameter(path: Path) -> object:
    others = {other for command in commands_in(path) for other in others_in(command.text)}
    marks = [pytest.mark.interop] if others else []
    if others - {"openssl"}:  # it compiles, or waits for stacks
        marks.append(pytest.mark.slow)
    return pytest.param(path, marks=marks, id=str(path.relative_to(ROOT)))


WITH_COMMANDS = [_parameter(path) for path in DOCUMENTS if blocks(path, "console")]


@pytest.fixture(scope="module")
def programs(tmp_path_factory):
    """The folder of the `pqsec` that documents run."""
    folder = tmp_path_factory.mktemp("bin")
    with forking_pqsec(folder / "pqsec"):
        yield folder


@pytest.fixture
def session(tmp_path, programs):
    made = Session(tmp_path, programs)
    yield made
    made.end()


@pytest.mark.parametrize("path", WITH_COMMANDS)
def test_the_commands_of_a_document_do_what_it_says(path, session, requires):
    if path.parent.parent.name == "examples":
        shutil.copytree(path.parent, session.work, dirs_exist_ok=True)  # what the example brings
        (session.work / path.name).unlink()
    for command in commands_in(path):
        place = f"{path.relative_to(ROOT)}:{command.line}"
        for program in others_in(command.text):
            requires(_found(program), *OTHERS[program])
        code, printed = session.run(command.text)
        said = f"{place}: {command.text}\nexit {code}\n{printed}"
        assert code == command.exit_code, f"{said}\n{session.logs()}"
        if command.output:
            output = said_here(command.output)
            wanted = "\n".join(output)
            message = f"{place}: {command.text}\nprinted:\n{printed}\nand not:\n{wanted}"
            assert same(output, printed), message


def test_the_documents_are_all_here():
    names = {str(path.relative_to(ROOT)) for path in DOCUMENTS}
    assert {"README.md", "docs/reference/commands.md", "examples/quickstart/README.md"} <= names
    assert len(WITH_COMMANDS) >= 7


def test_the_readme_sets_things_up_in_two_lines_that_come_first():
    """The gate runs them: they install from a package index."""
    lines = [lines for _, lines in blocks(README, "sh")]
    assert lines[:2] == [[RUN], [TEST]]
    text = README.read_text()
    assert text.index(TEST) < text.index("```console")


@pytest.mark.parametrize(
    "path",
    [path for path in DOCUMENTS if blocks(path, "python")],
    ids=lambda path: str(path.relative_to(ROOT)),
)
def test_the_python_of_a_document_runs_and_prints_what_it_says(path, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    program, names = [line for _, lines in blocks(path, "python") for line in lines], {}
    exec(compile("\n".join(program), str(path), "exec"), names)  # noqa: S102 -- it is ours
    printed = iter(capsys.readouterr().out.splitlines())
    said = [line.removeprefix("# prints: ") for line in program if line.startswith("# prints: ")]
    assert said
    for line in said:  # in this order; a line may go on
        assert any(each.startswith(line) for each in printed), line


def test_the_python_of_the_readme_is_short():
    ((_, lines),) = blocks(README, "python")
    assert len([line for line in lines if line.strip()]) <= 26


def _all_commands() -> list[str]:
    """Every command, with those of groups: `ca init`."""
    context = click.Context(pqsec)
    found = []
    for name in COMMANDS:
        command = pqsec.get_command(context, name)
        inner = list(command.commands) if isinstance(command, click.Group) else [""]
        found += [f"{name} {each}".strip() for each in inner]
    return found


def test_the_overview_in_the_readme_has_every_command():
    overview = README.read_text().partition("## Commands")[2].partition("\n## ")[0]
    rows = re.findall(r"(?m)^\| ([^`|]+) \| (`.*) \|$", overview)
    found = {heading: re.findall("`([a-z-]+)`", names) for heading, names in rows}
    assert found == {heading: names.split() for heading, names in GROUPS.items()}


@pytest.mark.parametrize("name", COMMANDS)
def test_the_short_help_of_a_command_is_its_own_first_line(name):
    command = pqsec.get_command(click.Context(pqsec), name)
    own = " ".join((command.help or "").partition("\n\n")[0].split())
    assert COMMANDS[name][1] == own


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_between_documents_lead_somewhere(path):
    links = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", path.read_text())
    assert [link for link in links if not (path.parent / link).exists()] == []


def test_output_is_compared_with_gaps():
    assert same(["a", "...", "c ...d"], "a\nb\nb\nc xyz d\n")
    assert same(["one", ""], "one\n\n\n")
    assert not same(["a", "c"], "a\nb\nc\n")
    assert not same(["a ... b"], "a b c\n")


def test_what_is_printed_without_something_is_expected_there_only(monkeypatch):
    lines = ["a note  # without Cyclone DDS", "b"]
    for absent, due in ((True, ["a note", "b"]), (False, ["b"])):
        monkeypatch.setitem(ABSENT, "Cyclone DDS", lambda absent=absent: absent)
        assert said_here(lines) == due


def test_what_a_document_leaves_in_the_background_ends(session):
    started = """export XDG_RUNTIME_DIR=$(mktemp -d)
        pqsec agent run > agent.txt 2>&1 &
        until pqsec agent status > status.txt 2>&1; do sleep 0.1; done"""
    assert session.run(started)[0] == 0
    session.end()
    assert session.run("while pqsec agent status; do sleep 0.1; done")[0] == 0


def test_a_failing_command_is_seen(session):
    assert session.run("export A=b; pqsec --version; false")[0] == 1
    assert session.run("exit 3  # exit 3") == (3, "")
    code, printed = session.run('echo "$A" >&2')
    assert (code, printed) == (0, "b\n")
    assert Command(1, "pqsec verify x  # exit 1").exit_code == 1
