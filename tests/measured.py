"""Coverage is measured where a test shows something new: measuring takes as long as the test.

Under pytest-cov this plugin stops the measurement, and lets it run

- in no test that unmeasured.txt names: others show what it runs (tests/unmeasured.py);
- in the set-up of a fixture when it is the first in this process;
- in a case of a test until two cases of it in a row have shown nothing new;
- in each case until half a second of the processor has shown nothing new.

What a module runs when it is imported is measured once, in a process that imports them all
(tests/unit/test_rooms.py). The job of mutants, which asks which test runs what, measures all.
"""

import os
import signal
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from coverage import Coverage

ROOT = Path(__file__).parents[1]
NOT_MEASURED = {"property", "fuzz", "vectors", "interop", "plugin", "docs", "e2e"}
"""Folders whose tests run the same code over and over, or processes of their own."""
MEASURED_THERE = {"test_plugin_try.py", "test_postgres.py"}
"""Files of those folders: nothing else runs what they run."""
LIST = ROOT / "tests/unmeasured.txt"
PATIENCE = 0.5
"""Seconds of the processor."""
CASES = 2
_PROCESSES = {
    "COVERAGE_PROCESS_START": str(ROOT / "tests/processes.coveragerc"),
    "COVERAGE_FILE": str(ROOT / ".coverage"),
}

_environment: dict[str, str] = {}


def in_measured_folder(file: Path) -> bool:
    """Whether tests of that file are measured, but for those of the list."""
    return file.parent.name not in NOT_MEASURED or file.name in MEASURED_THERE


def measured_too() -> dict[str, str]:
    """Variables with which the coverage of a process is measured; none if that of tests is not."""
    return _environment


@pytest.hookimpl(trylast=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    """After pytest-cov, which has started the measurement in a process that runs tests."""
    coverage = Coverage.current()
    if coverage is None:
        return
    _environment.update(_PROCESSES)
    if not session.config.getoption("cov_context"):
        session.config.pluginmanager.register(Measurement(coverage))


class Measurement:
    """Starts and stops it."""

    def __init__(self, coverage: Coverage) -> None:
        self._coverage = coverage
        self._runs = True
        self._fixtures: set[object] = set()
        self._shown = frozenset(LIST.read_text().split())
        self._nothing_new: Counter[str] = Counter()
        """Test -> how many cases in a row have shown nothing new."""
        # What a fork of this process runs is measured for nobody: it ends without saving it.
        os.register_at_fork(after_in_child=lambda: sys.settrace(None))
        self._stop()

    def _start(self) -> None:
        if not self._runs:
            self._coverage.start()
            self._runs = True

    def _stop(self) -> None:
        if self._runs:
            self._coverage.stop()
            self._runs = False

    def _found(self) -> int:
        """How much was found until now."""
        return sum(map(len, self._coverage._collector.data.values()))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item):
        test = item.nodeid.partition("[")[0]
        shown = test in self._shown or self._nothing_new[test] == CASES
        if shown or not in_measured_folder(item.path):
            return (yield)
        before = self._found()
        with self._until_nothing_is_new():
            result = yield
        self._nothing_new[test] = 0 if self._found() > before else self._nothing_new[test] + 1
        return result

    @contextmanager
    def _until_nothing_is_new(self) -> Iterator[None]:
        last = self._found()

        def look(*_: object) -> None:
            nonlocal last
            found = self._found()
            if self._runs and found == last:
                self._stop()
                signal.setitimer(signal.ITIMER_PROF, 0)
            last = found

        signal.signal(signal.SIGPROF, look)
        signal.setitimer(signal.ITIMER_PROF, PATIENCE, PATIENCE)
        self._start()
        try:
            yield
        finally:
            self._stop()
            signal.setitimer(signal.ITIMER_PROF, 0)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef, request):
        key = fixturedef.baseid, fixturedef.argname
        if not self._runs:
            return (yield)
        if key not in self._fixtures:
            self._fixtures.add(key)
            return (yield)
        self._stop()
        try:
            return (yield)
        finally:
            self._start()
