"""Tests in child processes of one warm process, each on a copy of the checkout.

The checkout is never edited. A copy's module is replaced by the mutant's, in the file, so that
programs which a test starts run the mutant as well: with Python's -I too, which no PYTHONPATH
reaches, since a copy has an interpreter of its own.
"""

import gc
import importlib
import json
import os
import pkgutil
import resource
import shutil
import signal
import sys
import sysconfig
import time
import traceback
import venv
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from importlib.util import cache_from_source
from pathlib import Path

from coverage import CoverageData

from tests.mutants.conditions import PACKAGE, PARTS, Mutant

COPIED = (PACKAGE, "tests", "schemas", "templates", "docs", "examples", "pyproject.toml")
WARM = (
    "pytest", "hypothesis", "click", "jinja2", "lxml.etree", "yaml", "sqlite3", "jsonschema",
    "cryptography.x509", "cryptography.hazmat.asn1", "_pytest.assertion.rewrite",
)  # fmt: skip
"""What tests import and no mutant touches: imported once, before the children are forked."""


NO_KILLS = ("-k", "not killed_at")
"""Tests that kill at every call run the same code a thousand times, in processes of their own."""


@dataclass(frozen=True, slots=True)
class Ran:
    """How a run of tests ended."""

    code: int | None
    """pytest's exit code; None for a child that was ended, or ended itself."""
    failed: str | None
    """The first test that failed."""
    seconds: dict[str, float]
    """Of each test that ran."""
    starting: list[str]
    """Tests that start Python."""


class _Recorder:
    """A plugin of pytest."""

    def __init__(self, deadline: Path, limits: dict[str, float], *, measures: bool) -> None:
        self._deadline, self._limits, self._measures = deadline, limits, measures
        self.failed: str | None = None
        self.seconds: dict[str, float] = {}
        self.starting: set[str] = set()
        sys.addaudithook(self._heard)

    def _heard(self, event: str, arguments: tuple) -> None:
        if event == "subprocess.Popen" and sys.executable in str(arguments[1]):
            test, _, phase = os.environ.get("PYTEST_CURRENT_TEST", "").rpartition(" ")
            self.starting.add(test.partition("::")[0] if phase == "(setup)" else test)

    def pytest_collection_finish(self) -> None:
        """Rooms load on demand: what runs at import must not look as if one test ran it."""
        if not self._measures:
            return  # it takes longer than most tests
        for each in pkgutil.walk_packages(importlib.import_module(PACKAGE).__path__, f"{PACKAGE}."):
            if not each.name.endswith("__main__"):
                with suppress(ModuleNotFoundError):  # those of ROS 2 are not there
                    importlib.import_module(each.name)

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        if nodeid in self._limits:
            end = time.time() + self._limits[nodeid]
            os.utime(self._deadline, (end, end))

    def pytest_runtest_logreport(self, report) -> None:
        self.seconds[report.nodeid] = self.seconds.get(report.nodeid, 0.0) + report.duration
        if report.failed and self.failed is None:
            self.failed = report.nodeid


@dataclass
class Copy:
    """A copy of the checkout in `root`, for one child at a time."""

    root: Path
    folder: Path
    _mutant: Mutant | None = None
    pid: int = 0

    @classmethod
    def made(cls, root: Path, folder: Path, compiled: "Copy | None" = None) -> "Copy":
        """A new one, with the bytecode of `compiled`, which has no mutant."""
        folder.mkdir(parents=True)
        source = compiled.folder if compiled else root
        ignored = None if compiled else shutil.ignore_patterns("__pycache__")
        for name in COPIED:
            if (source / name).is_dir():
                shutil.copytree(source / name, folder / name, ignore=ignored)
            elif (source / name).exists():
                shutil.copy2(source / name, folder / name)
        copy = cls(root, folder)
        venv.create(folder / "venv", symlinks=True)
        [packages] = (folder / "venv/lib").glob("python*/site-packages")
        # In a folder that is named in a file, other such files are not read: not the checkout's.
        paths = dict.fromkeys([str(folder), *map(sysconfig.get_path, ("purelib", "platlib"))])
        (packages / "copy.pth").write_text("\n".join(paths))
        return copy

    def start(self, tests: dict[str, float], mutant: Mutant | None, *options: str) -> None:
        """Start a child that runs those tests with that mutant, each for so many seconds at most.

        A test may be a file of tests, which may take so long until its first test.
        """
        self._change(mutant)
        self._deadline.touch()
        end = time.time() + STARTING + max(tests.values())
        os.utime(self._deadline, (end, end))
        self._answer.unlink(missing_ok=True)
        sys.stdout.flush()
        gc.freeze()
        self.pid = os.fork()
        if not self.pid:
            try:
                self._child(tests, options)
            except BaseException:  # noqa: BLE001 -- nothing of the parent's may run in the child
                traceback.print_exc()
            finally:
                os._exit(BROKEN)

    def ended(self) -> Ran | None:
        """How the child ended; None while it runs. RuntimeError if it could not run tests."""
        done, status = os.waitpid(self.pid, os.WNOHANG)
        if not done and time.time() < self._deadline.stat().st_mtime:
            return None
        with suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)  # and what it started
        if not done:
            os.waitpid(self.pid, 0)
        self.pid = 0
        if done and os.waitstatus_to_exitcode(status) == BROKEN:
            raise RuntimeError(f"no tests could be run:\n{self.log[-4000:]}")
        return Ran(**json.loads(self._answer.read_text())) if self._answer.exists() else NOT_ENDED

    def run(self, tests: dict[str, float], mutant: Mutant | None, *options: str) -> Ran:
        """Start it and wait."""
        self.start(tests, mutant, *options)
        while (ran := self.ended()) is None:
            time.sleep(0.05)
        return ran

    @property
    def log(self) -> str:
        """What the last child printed."""
        path = self.folder / "log"
        return path.read_text(errors="replace") if path.exists() else ""

    @property
    def _answer(self) -> Path:
        return self.folder / "answer.json"

    @property
    def _deadline(self) -> Path:
        """A file whose date is the time after which the child hangs."""
        return self.folder / "deadline"

    def _change(self, mutant: Mutant | None) -> None:
        for each in (self._mutant, mutant):
            if each is not None:
                path = self.folder / each.path
                source = (self.root / each.path).read_bytes()
                path.write_bytes(source if each is not mutant else each.applied(source))
                # Its date has whole seconds; a mutant of the same length would be taken for it.
                Path(cache_from_source(path)).unlink(missing_ok=True)
        self._mutant = mutant

    def _child(self, tests: dict[str, float], options: tuple[str, ...]) -> None:
        os.setsid()
        resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
        os.chdir(self.folder)
        log = os.open("log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for number in (1, 2):
            os.dup2(log, number)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        sys.executable = str(self.folder / "venv/bin/python")
        root = str(self.root.resolve())
        sys.path[:] = [str(self.folder), *(each for each in sys.path if each not in {"", root})]
        os.environ["PYTHONPATH"] = str(self.folder)
        os.environ["PQSEC_LONG"] = "cases"  # any of them may kill
        for name in ("PYTEST_ADDOPTS", "PQSEC_PART"):  # of the run that we may be a test of
            os.environ.pop(name, None)
        for name in [each for each in sys.modules if each.split(".")[0] in {"tests", PACKAGE}]:
            del sys.modules[name]
        # A mutant's bytecode must not outlive it.
        sys.dont_write_bytecode = self._mutant is not None
        if sys.dont_write_bytecode:
            os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
        recorder = _Recorder(self._deadline, tests, measures=self._mutant is None)
        pytest = importlib.import_module("pytest")
        own = ["-q", "-p", "no:cacheprovider", "-W", "ignore::pytest.PytestAssertRewriteWarning"]
        own += ["--basetemp", "tmp"]  # where others run tests too, each clears up what is in /tmp
        try:
            code = pytest.main([*own, *options, *tests], plugins=[recorder])
        except Exception:  # of what the failed test left open, or a group of them
            if recorder.failed is None:
                raise
            code = pytest.ExitCode.TESTS_FAILED
        sys.stdout.flush()
        found = recorder.starting  # tests, or files whose fixtures start it
        starting = [each for each in recorder.seconds if {each, each.partition("::")[0]} & found]
        answer = Ran(int(code), recorder.failed, recorder.seconds, starting)
        self._answer.write_text(json.dumps(asdict(answer)))
        os._exit(0)


STARTING = 60.0
"""Seconds until the first test runs, at most."""
MEMORY = 4 << 30
"""Octets: a mutant whose loop has no end ends before the machine does."""
BROKEN = 70
"""Exit code of a child in which pytest itself failed."""
NOT_ENDED = Ran(None, None, {}, [])


@dataclass
class Measured:
    """Which tests run which lines, and how long they take."""

    seconds: dict[str, float] = field(default_factory=dict)
    tests: dict[str, dict[int, list[str]]] = field(default_factory=dict)
    """Of a module's path, of a line: the tests."""
    starting: list[str] = field(default_factory=list)
    """Tests that start Python: what runs there is not measured."""

    @classmethod
    def by(cls, copy: Copy, files: list[str], timeout: float) -> "Measured":
        """Measured by running those files of tests once, without a mutant.

        RuntimeError if one of them fails.
        """
        measured = cls()
        for file in files:
            options = (f"--cov={PACKAGE}", "--cov-context=test", "--cov-report=", *NO_KILLS)
            ran = copy.run({file: timeout}, None, *options)
            if ran.code != 0:
                raise RuntimeError(f"{file} fails without a mutant:\n{copy.log[-4000:]}")
            measured.seconds |= ran.seconds
            measured.starting += ran.starting
            measured.add(copy)
        return measured

    def add(self, copy: Copy) -> None:
        """What the last run left in the copy's folder."""
        data = CoverageData(str(copy.folder / ".coverage"))
        data.read()
        for name in data.measured_files():
            path = str(Path(name).relative_to(copy.folder))
            lines = self.tests.setdefault(path, {})
            for line, contexts in data.contexts_by_lineno(name).items():
                found = {each.rpartition("|")[0] for each in contexts} - {""}
                lines[line] = sorted({*lines.get(line, ()), *found})

    def running(self, mutant: Mutant) -> list[str]:
        """The tests that run what the mutant changes, the cheapest files first."""
        first, last = mutant.lines
        lines = self.tests.get(mutant.path, {})
        found = {test for line in range(first, last + 1) for test in lines.get(line, ())}
        if not found and any(line in lines for line in range(first, last + 1)):
            found = set(self.seconds)  # it runs when the module is imported
        if not found or mutant.room in PARTS:  # it runs in processes of tests too
            found |= set(self.starting)
        seconds: dict[str, float] = {}
        for test in found:
            file = test.partition("::")[0]
            seconds[file] = seconds.get(file, 0.0) + self.seconds.get(test, 0.0)
        # Within a file in the file's order: its fixtures are made for that.
        order = {test: number for number, test in enumerate(self.seconds)}
        return sorted(found, key=lambda test: (seconds[test.partition("::")[0]], order[test]))

    def limits(self, tests: list[str]) -> dict[str, float]:
        """Seconds after which each of these tests hangs, by the slowest one of its file.

        That one may have prepared what the others use.
        """
        slowest: dict[str, float] = {}
        for test, seconds in self.seconds.items():
            file = test.partition("::")[0]
            slowest[file] = max(slowest.get(file, 0.0), seconds)
        return {test: 30 + 5 * slowest.get(test.partition("::")[0], 0.0) for test in tests}


def warm() -> None:
    """Import what no mutant touches."""
    for name in WARM:
        importlib.import_module(name)
