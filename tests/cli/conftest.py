"""Running pqsec as its users do: commands in a folder, an exit code, two streams.

`pqsec` runs a command line in this process, through the same `main` as the shell does;
`process` starts Python for it, where the process itself is what is tested. Both run in
the test's own folder, without a terminal.
"""

import itertools
import json
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import pytest

from pqsec_pki.algorithms import PROFILES
from pqsec_pki.cli import pqsec as PQSEC  # noqa: N812 -- a fixture has that name
from pqsec_pki.cli._printing import JSON_VERSION
from tests.running import clean_environment, measured_too, run_here

NAMES = [profile.name for profile in PROFILES]
PARTICIPANTS = ("/talker", "/listener")
EXTENSION = Path(__file__).parents[2] / "examples/extension"

AT_ONCE = (
    "-c",
    "from pqsec_pki.cli import _progress as it, main; it._FIRST = it._NEXT = 0.002; main()",
)
"""pqsec, which shows its progress soon, and often."""
ERASE = "\r\x1b[K"

Run = Callable[..., "Result"]


@dataclass(frozen=True)
class Result:
    """What a command left: its exit code and what it said."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """What is printed, without the version of its format."""
        value = json.loads(self.out)
        if isinstance(value, dict) and value.get("version") == JSON_VERSION:
            del value["version"]
        return value

    @property
    def errors(self) -> list[str]:
        """The problems on stderr, which must be all there is but for one hint at the end."""
        if self.err.startswith("{"):
            return [
                f"{each['subject']}: {each['message']}" if each["subject"] else each["message"]
                for each in json.loads(self.err)["errors"]
            ]
        *lines, last = self.err.splitlines()
        if not last.startswith("pqsec: hint: "):
            lines.append(last)
        assert lines
        assert all(line.startswith("pqsec: error: ") for line in lines), self.err
        return [line.removeprefix("pqsec: error: ") for line in lines]

    def done(self) -> "Result":
        """This, which must be a success that complains of nothing."""
        assert self.code == 0, self.err
        assert "error:" not in self.err
        return self

    def refused(
        self, code: int, *words: str, hint: str | None = None, problems: int = 1, shows: str = ""
    ) -> "Result":
        """This, which must be a refusal in the house's form that holds all the words.

        It `shows` that on stdout; by default nothing.
        """
        assert self.code == code, self
        assert shows in self.out if shows else self.out == ""
        assert len(self.errors) == problems, self.err
        assert not [word for word in words if word not in "\n".join(self.errors)], self.err
        last = self.err.splitlines()[-1]
        begins = last.startswith(("pqsec: hint: ", "{"))
        assert hint is None or (begins and hint in last), self.err
        return self


def visible(shown: str) -> str:
    """What stays on a terminal, of all that was sent to it."""
    left = ""
    for part in shown.split(ERASE):
        left = left[: left.rfind("\n") + 1] + part
    return left


def command_of(words: list[str]) -> click.Command:
    """The command that these words run: a group where no command of it is named."""
    command: click.Command = PQSEC
    for before, word in itertools.pairwise(["", *words]):
        if isinstance(command, click.Group) and before not in {"-k", "--keystore"}:
            command = command.get_command(click.Context(command), word) or command
    return command


@pytest.fixture(scope="session")
def run_in() -> Run:
    """run_in(folder, "ca show", ...) runs the command there, in this process."""

    def run(folder: Path, line: str, *more: object, **environment: str) -> Result:
        words = [*shlex.split(line), *map(str, more)]
        code, out, err = run_here(words, cwd=folder, env=clean_environment() | environment)
        allowed = getattr(command_of(shlex.split(line)), "exit_codes", {0, 1, 2, 3})
        assert code in allowed, (line, code, "not in --help")
        return Result(code, out, err)

    return run


@pytest.fixture
def pqsec(run_in, tmp_path) -> Run:
    """pqsec("-k k ca show", ...) runs the command in the test's folder, in this process."""

    def run(line: str, *more: object, **environment: str) -> Result:
        return run_in(tmp_path, line, *more, **environment)

    return run


@pytest.fixture
def run_copy(run_in, tmp_path) -> Callable[[Path], Run]:
    """run_copy(made) copies the folder, whose keystore is `k`; run(line) runs pqsec in the copy."""

    def copied(made: Path) -> Run:
        folder = shutil.copytree(made, tmp_path / "work", symlinks=True)

        def run(line: str, *more: object, **environment: str) -> Result:
            return run_in(folder, line, *more, PQSEC_KEYSTORE="k", **environment)

        run.folder = folder
        return run

    return copied


@pytest.fixture
def process(tmp_path) -> Run:
    """process("-k k ca show", ...) runs the command in the test's folder, in a new process."""

    def run(line: str, *more: object, **environment: str) -> Result:
        done = subprocess.run(
            [sys.executable, "-m", "pqsec_pki", *shlex.split(line), *map(str, more)],
            cwd=tmp_path,
            env=clean_environment(**environment),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
        )
        return Result(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture(scope="session")
def make_domain(run_in) -> Callable[[Path, str], Path]:
    """make_domain(folder, options of `ca init`) makes a keystore with two participants."""

    def make(folder: Path, options: str) -> Path:
        run_in(folder, f"-k k ca init {options}").done()
        both = " ".join(PARTICIPANTS)
        topics = "--publish rt/chatter --subscribe rt/chatter"
        run_in(folder, f"-k k issue {both} {topics}").done()
        return folder / "k"

    return make


@pytest.fixture(scope="session")
def domains(make_domain, tmp_path_factory) -> Callable[..., Path]:
    """domains("pq") is a keystore of that profile, made once: to be copied, not changed.

    domains("pq", "another") has the same names in it, and other keys.
    """
    made: dict[tuple[str, str], Path] = {}

    def domain(profile: str, label: str = "one") -> Path:
        if (profile, label) not in made:
            folder = tmp_path_factory.mktemp(f"{profile}-{label}")
            made[profile, label] = make_domain(folder, f"--no-passphrase --profile {profile}")
        return made[profile, label]

    return domain


@pytest.fixture
def keystore(domains, tmp_path) -> Callable[..., Path]:
    """keystore("pq") is the test's own keystore `k` of that profile, with two participants."""

    def copied(profile: str = "classical", name: str = "k", label: str = "one") -> Path:
        return copy(domains(profile, label), tmp_path / name)

    return copied


@pytest.fixture(scope="session")
def extension_site(tmp_path_factory) -> Path:
    """The folder into which pip installed examples/extension."""
    site: Path = tmp_path_factory.mktemp("site")
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--no-index", "--target", site, EXTENSION], check=True)
    return site


@pytest.fixture(scope="session")
def extension(extension_site) -> Run:
    """extension(folder, "check robots") runs it where examples/extension is installed.

    Some are measured, for coverage: nothing else runs what loads such a package.
    """
    path = os.pathsep.join([*sys.path, str(extension_site)])

    def run(folder: Path, line: str, *, measured: bool = False) -> Result:
        more = measured_too() if measured else {}
        done = subprocess.run(
            [sys.executable, "-m", "pqsec_pki", *shlex.split(line)],
            cwd=folder,
            env=clean_environment(PYTHONPATH=path, **more),
            capture_output=True,
            text=True,
            check=False,
        )
        assert "Traceback" not in done.stderr
        return Result(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture(scope="session")
def locked_domain(tmp_path_factory, make_domain, run_in) -> Path:
    """A keystore without participants whose CA keys are encrypted under `open sesame, please`."""
    folder = tmp_path_factory.mktemp("locked")
    secret(folder / "passphrase", "open sesame, please\n")
    run_in(folder, "-k k ca init --profile classical --passphrase-file passphrase").done()
    return folder / "k"


@pytest.fixture
def locked(locked_domain, tmp_path) -> Path:
    """The test's own keystore `k` with encrypted keys; `right` and `wrong` hold passphrases."""
    secret(tmp_path / "right", "open sesame, please\n")
    secret(tmp_path / "wrong", "open barley, please\n")
    return copy(locked_domain, tmp_path / "k")


def secret(path: Path, content: str | bytes) -> None:
    """A file for its owner only, as a passphrase's should be."""
    path.touch(mode=0o600)
    path.write_bytes(content.encode() if isinstance(content, str) else content)


def copy(keystore: Path, goal: Path) -> Path:
    return shutil.copytree(keystore, goal, symlinks=True)


def snapshot(folder: Path) -> dict[str, bytes]:
    """Every file under `folder`, links followed, but for the ledger's working files."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.name.endswith(("-wal", "-shm"))
    }
