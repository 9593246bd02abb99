"""What all tests share: the time, and how a test says that it needs something else here.

A test of another implementation is marked `interop` and asks for it through `requires`.
Where it is missing the test is skipped, with the way to get it in the reason. With
PQSEC_REQUIRE_INTEROP=1, as in .ci/run, a skip is a failure.
"""

import gc
import os
import signal
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

import hypothesis
import pytest

from pqsec_pki.algorithms import _pbes2
from tests.libraries import Libraries, libraries
from tests.longer import LONG, chosen, named

Found = TypeVar("Found")

# A shell has what it starts in the background ignore it, and programs under test inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

# What a fork runs is measured for nobody: it ends without saving it.
os.register_at_fork(after_in_child=lambda: sys.settrace(None))

# No test asserts wall-clock time: by default hypothesis fails an example that takes 200 ms.
hypothesis.settings.register_profile("pqsec", deadline=None, max_examples=100 if LONG else 15)
hypothesis.settings.load_profile("pqsec")

ITERATIONS = _pbes2.ITERATIONS
if not LONG:  # else a key under a passphrase takes a quarter of a second at each use
    _pbes2.ITERATIONS = 1000

SKIPPED = os.environ.get("PQSEC_SKIPPED")
"""A file for the names of skipped tests: .ci/run runs them where nothing is missing."""
ALL_MUST_RUN = os.environ.get("PQSEC_REQUIRE_INTEROP") == "1"
ELSEWHERE = (
    *("in .ci/long: ", "PQSEC_CYCLONEDDS_11", "PQSEC_FASTDDS_"),
    *("PQSEC_OPENDDS_ROOT", "PQSEC_ROS2_TOOLS"),
)
"""In the reasons of skips that the gate allows: the longer job runs the test; or it needs OpenDDS,
ROS 2's tools, or a Cyclone DDS or Fast DDS that no registry has, and is run by hand. The variable
names a build: of a DDS, the prefix in which it was installed from the project's tag."""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what is for `.ci/long`, or is not in this part."""
    kept = chosen(items, named(items, config.args, config.invocation_params.dir))
    left = set(items).difference(kept)
    if left:
        config.hook.pytest_deselected(items=[item for item in items if item in left])
        items[:] = kept


def pytest_collection_finish() -> None:
    """Tests stay, so no collection of garbage need look at them; fewer find as much."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000)


@pytest.fixture(scope="session")
def requires() -> Callable[[Found | None, str, str], Found]:
    """requires(found, "what it is", "how to get it") gives `found`, or skips on None."""

    def check(found: Found | None, what: str, remedy: str) -> Found:
        if found is None:
            pytest.skip(f"{what} is not on this machine: {remedy}")
        return found

    return check


@pytest.fixture
def all_iterations(monkeypatch) -> None:
    """Keys are encrypted as for users."""
    monkeypatch.setattr(_pbes2, "ITERATIONS", ITERATIONS)


@pytest.fixture(scope="session")
def library(requires) -> Libraries:
    """library(soname, *needed) is the bytes of a library; `.program(*needed)` of a program."""
    return libraries(requires)


@pytest.fixture(scope="session")
def now() -> datetime:
    """When this run began."""
    return datetime.now(UTC)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    report = yield
    if ALL_MUST_RUN and _is_skipped(report) and not _is_run_elsewhere(report):
        report.outcome = "failed"
        report.longrepr = f"PQSEC_REQUIRE_INTEROP=1 allows no skips. {report.longrepr[2]}"
    return report


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """The process that has the workers notes what was skipped."""
    if SKIPPED and "PYTEST_XDIST_WORKER" not in os.environ and _is_skipped(report):
        with Path(SKIPPED).open("a") as file:
            file.write(f"{report.nodeid}\n")


def _is_skipped(report: pytest.TestReport) -> bool:
    return report.skipped and not hasattr(report, "wasxfail")


def _is_run_elsewhere(report: pytest.TestReport) -> bool:
    return any(each in report.longrepr[2] for each in ELSEWHERE)
