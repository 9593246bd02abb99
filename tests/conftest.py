"""What all tests share: the time, and how a test says that it needs something else here.

A test of another implementation is marked `interop` and asks for it through `requires`.
Where it is missing the test is skipped, with the way to get it in the reason. With
PQSEC_REQUIRE_INTEROP=1, as in .ci/run, such a skip is a failure.
"""

import os
import signal
from collections.abc import Callable
from datetime import UTC, datetime
from typing import TypeVar

import pytest

from tests.libraries import Libraries, libraries

Found = TypeVar("Found")

# A shell has what it starts in the background ignore it, and programs under test inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

ALL_MUST_RUN = os.environ.get("PQSEC_REQUIRE_INTEROP") == "1"


NOT_MEASURED = {"property", "fuzz", "vectors", "interop", "plugin", "docs", "e2e"}
"""Folders whose tests run the same code over and over, or processes of their own. So do those that
kill at every call."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Their coverage is not measured: that takes as long again, and other tests run it all."""
    for item in items:
        if item.path.parent.name in NOT_MEASURED or item.path.stem.endswith("_kill"):
            item.add_marker(pytest.mark.no_cover)


@pytest.fixture(scope="session")
def requires() -> Callable[[Found | None, str, str], Found]:
    """requires(found, "what it is", "how to get it") gives `found`, or skips on None."""

    def check(found: Found | None, what: str, remedy: str) -> Found:
        if found is None:
            pytest.skip(f"{what} is not on this machine: {remedy}")
        return found

    return check


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
    skipped = report.skipped and not hasattr(report, "wasxfail")
    if ALL_MUST_RUN and skipped and item.get_closest_marker("interop"):
        report.outcome = "failed"
        report.longrepr = f"PQSEC_REQUIRE_INTEROP=1 allows no skips. {report.longrepr[2]}"
    return report
