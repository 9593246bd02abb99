"""A test that hangs fails when its time is up, and says where it was."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
HANGS = """
import ctypes, os, signal, threading, time

def test_python():
    def waits_for_ever():
        threading.Event().wait()
    waits_for_ever()

def test_fork():
    def waits_for_its_child():
        os.waitpid(child, 0)
    child = os.fork()
    if child == 0:
        time.sleep(3600)
        os._exit(0)
    try:
        waits_for_its_child()
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)

def test_c():
    def waits_without_looking_up():
        pause = ctypes.CDLL(None).pthread_mutex_lock
        lock = ctypes.create_string_buffer(64)
        pause(lock), pause(lock)
    waits_without_looking_up()

def test_after():
    pass
"""


def run(folder, *options):
    (folder / "test_hangs.py").write_text(HANGS)
    command = [
        *(sys.executable, "-m", "pytest", "-c", ROOT / "pyproject.toml", "--rootdir", folder),
        *("-p", "no:cacheprovider", *options, folder / "test_hangs.py"),
    ]
    environment = {name: os.environ[name] for name in os.environ if not name.startswith("PYTEST_")}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    return done.returncode, done.stdout + done.stderr


def test_every_test_has_a_time_limit(request):
    assert (
        0 < float(request.config.getini("timeout")) < request.config.getini("faulthandler_timeout")
    )


@pytest.mark.slow
@pytest.mark.parametrize("workers", [(), ("-n", "2")], ids=["alone", "two workers"])
def test_what_hangs_fails_with_its_stack_and_the_rest_runs(tmp_path, workers):
    code, said = run(tmp_path, "--timeout", "2", "-k", "not test_c", *workers)
    assert code == 1
    assert "2 failed, 1 passed" in said
    assert "waits_for_ever()" in said
    assert "waits_for_its_child()" in said
    assert said.count("Timeout (>2.0s)") >= 2


@pytest.mark.slow
def test_what_hangs_in_c_ends_with_its_stack(tmp_path):
    limits = ("--timeout", "1", "-o", "faulthandler_timeout=2")
    code, said = run(tmp_path, *limits, "-k", "test_c or test_after")
    assert code != 0
    assert "in waits_without_looking_up" in said


@pytest.mark.slow
def test_what_hangs_in_c_fails_alone_with_workers(tmp_path):
    limits = ("--timeout", "1", "-o", "faulthandler_timeout=2")
    code, said = run(tmp_path, *limits, "-k", "test_c or test_after", "-n", "2")
    assert code == 1
    assert "1 failed, 1 passed" in said
    assert "in waits_without_looking_up" in said


def test_no_test_asserts_how_long_something_took():
    """The time limit is for that, or a count of what was done; bench/ measures."""
    clocks = {"monotonic", "perf_counter", "monotonic_ns", "perf_counter_ns", "time_ns"}
    found = [
        f"{path.relative_to(ROOT)}:{statement.lineno}"
        for path in ROOT.glob("tests/**/*.py")
        if any(clock in (text := path.read_text()) for clock in clocks)
        for statement in ast.walk(ast.parse(text))
        if isinstance(statement, ast.Assert)
        for node in ast.walk(statement)
        if isinstance(node, ast.Attribute | ast.Name)
        and getattr(node, "attr", getattr(node, "id", None)) in clocks
    ]
    assert found == []
