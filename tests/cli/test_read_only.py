"""A keystore is read where nothing may be written: on read-only media, and as another user."""

import ctypes
import os
import pickle
import re
import shutil
import signal
import sqlite3
import subprocess
import tempfile
from contextlib import closing
from pathlib import Path

import pytest

from tests.cli.conftest import copy

NOBODY = 65534
CLONE_NEWNS = 0x20000
"""Of <linux/sched.h>; Python has it from 3.12 on."""
COMMANDS = [
    "ca show",
    "status",
    "needs-renewal",
    "log",
    "log --verify",
    "check k",
    "who-may",
    "explain --participant /talker --publish rt/chatter",
    "verify-handshake /talker /listener",
    "verify-handshake --all",
    "diff k k",
    "verify k/enclaves/governance.p7s",
    "ca rotate --plan",
]
superuser = pytest.mark.skipif(os.geteuid() != 0, reason="only root may mount, and be others")


def in_a_fork(folder, enter, run_in, lines):
    """What the commands say in `folder`, to a process that did `enter` before."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        signal.alarm(60)
        try:
            os.chdir(folder)
            enter()
            with os.fdopen(writer, "wb") as told:
                told.write(pickle.dumps([run_in(Path(), f"-k k {line}") for line in lines]))
        finally:
            os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as told:
        found = told.read()
    os.waitpid(child, 0)
    return pickle.loads(found)  # noqa: S301 -- of our fork


def on_read_only_media():
    """The keystore k is mounted read-only, for this process."""
    if ctypes.CDLL(None).unshare(CLONE_NEWNS):
        raise OSError("no unshare")
    mount("--make-rprivate", "/")
    mount("--bind", "k", "k")
    mount("-o", "remount,bind,ro", "k")
    os.chdir(os.getcwd())  # noqa: PTH109 -- into the mount


def mount(*words):
    subprocess.run(["mount", *words], check=True, capture_output=True)


def can_mount():
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "k").mkdir()
        child = os.fork()
        if child == 0:
            try:
                os.chdir(folder)
                on_read_only_media()
            except BaseException:  # noqa: BLE001 -- whatever it is, it cannot
                os._exit(1)
            os._exit(0)
        return os.waitpid(child, 0)[1] == 0


def as_nobody():
    os.setgroups([])
    os.setgid(NOBODY)
    os.setuid(NOBODY)


@pytest.fixture(params=["as it is", "with lines in the -wal"])
def folder(request, domains):
    """A folder that everybody may reach, with a keystore that everybody may read, but not write."""
    with tempfile.TemporaryDirectory() as name:
        k = copy(domains("classical"), Path(name, "k"))
        if request.param != "as it is":
            leave_lines_in_the_wal(k / "private/ledger.sqlite3")
        for path in (k.parent, k, *k.rglob("*")):
            if not path.is_symlink():
                path.chmod(0o755 if path.is_dir() else 0o644)
        yield Path(name)


def leave_lines_in_the_wal(ledger):
    """As an earlier pqsec did that was killed."""
    with closing(sqlite3.connect(ledger, isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
        database.execute("CREATE TABLE another (number INTEGER)")
        for name in ("ledger.sqlite3", "ledger.sqlite3-wal"):
            shutil.copy(ledger.with_name(name), ledger.parents[2] / name)
    for name in ("ledger.sqlite3", "ledger.sqlite3-wal"):
        (ledger.parents[2] / name).rename(ledger.with_name(name))


def differences(folder, enter, run_in):
    """Where a command says anything else after `enter` than before."""
    usual = [run_in(folder, f"-k k {line}") for line in COMMANDS]
    assert [each for each in usual if each.code not in {0, 1}] == []
    found = in_a_fork(folder, enter, run_in, COMMANDS)
    both = zip(map(plain, COMMANDS, usual), map(plain, COMMANDS, found), strict=True)
    return [(one, other) for one, other in both if one != other]


def plain(line, said):
    """Without times and sizes of a handshake, which are others each time."""
    measured = "handshake" in line
    return said.code, re.sub(r"\d", "", said.out) if measured else said.out, said.err


@superuser
@pytest.mark.skipif(not (os.geteuid() == 0 and can_mount()), reason="nothing can be mounted here")
def test_a_keystore_on_read_only_media_is_read_and_not_changed(folder, run_in):
    assert differences(folder, on_read_only_media, run_in) == []
    changes = ["issue /new", "ca crl", "revoke /talker --yes"]
    for found in in_a_fork(folder, on_read_only_media, run_in, changes):
        found.refused(3, "read-only file system")
    for goal in ("k", "k/there"):
        [found] = in_a_fork(
            folder, on_read_only_media, run_in, [f"export cyclonedds /talker --anyway -o {goal}"]
        )
        assert found.refused(3).errors == [f"{goal}: read-only file system"]
    kept = ["log --anchor anchors", "log --verify --anchor anchors"]
    assert [each.code for each in in_a_fork(folder, on_read_only_media, run_in, kept)] == [0, 0]


@superuser
def test_a_keystore_of_another_user_that_may_be_read_is_read_and_not_changed(folder, run_in):
    assert differences(folder, as_nobody, run_in) == []
    changes = ["issue /new", "ca crl", "revoke /talker --yes", "ca recover"]
    for found in in_a_fork(folder, as_nobody, run_in, changes):
        found.refused(3, "k: it belongs to another user (root)", hint="work on a copy of your own")
