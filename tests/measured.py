"""Coverage is measured where a test shows something new: measuring takes half as long as the test.

Under pytest-cov this plugin measures a test if unmeasured.txt names neither the test nor its file.
Of each fixture, and each of its parameters, it measures the first set-up in a process, also for a
test that is not measured, and no other.

What a module runs when it is imported is measured once, in a process that imports them all
(tests/unit/test_rooms.py). The job of mutants, which asks which test runs what, measures all.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from coverage import Coverage

ROOT = Path(__file__).parents[1]
LIST = ROOT / "tests/unmeasured.txt"
_PROCESSES = {
    "COVERAGE_PROCESS_START": str(ROOT / "tests/processes.coveragerc"),
    "COVERAGE_FILE": str(ROOT / ".coverage"),
}

_environment: dict[str, str] = {}


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
        self._unmeasured = frozenset(LIST.read_text().split())
        # What a fork of this process runs is measured for nobody: it ends without saving it.
        os.register_at_fork(after_in_child=lambda: sys.settrace(None))
        self._switch(on=False)

    def _switch(self, *, on: bool) -> None:
        if on and not self._runs:
            self._coverage.start()
        elif self._runs and not on:
            self._coverage.stop()
        self._runs = on

    @contextmanager
    def _measured(self, *, on: bool) -> Iterator[None]:
        before = self._runs
        self._switch(on=on)
        try:
            yield
        finally:
            self._switch(on=before)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item):
        test, _, _ = item.nodeid.partition("[")
        file, _, _ = test.partition("::")
        with self._measured(on=self._unmeasured.isdisjoint({test, file})):
            return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef, request):
        key = fixturedef.baseid, fixturedef.argname, request.param_index
        first = key not in self._fixtures
        self._fixtures.add(key)
        with self._measured(on=first):
            return (yield)
