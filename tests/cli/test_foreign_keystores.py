"""Opening somebody else's keystore changes nothing: not in it, and not where its links lead."""

import json
import os
import shutil
import sqlite3
import stat
from contextlib import closing
from pathlib import Path

import click
import pytest

from pqsec_pki.cli import pqsec as group
from tests.cli.conftest import copy
from tests.longer import some

TALKER = "/talker"
SEEN = Path(__file__).parents[1] / "vectors/learning/nodes.txt"
READING = {
    "ca show": [""],
    "ca crl": ["--show"],
    "ca rotate": ["", "--only identity --plan"],
    "plan": ["domain.yaml"],
    "apply": ["domain.yaml --check"],
    "domain import": ["", "k"],
    "bundle": [f"{TALKER} --plain-key --force -o out.bundle"],
    "needs-renewal": [""],
    "status": [""],
    "log": ["", "--verify"],
    "ra list": [""],
    "check": ["k"],
    "report": ["", "--format csv"],
    "cbom": ["", "k"],
    "estimate": [""],
    "migrate plan": ["", "--rehearse"],
    "verify": ["k/enclaves/governance.p7s"],
    "verify-handshake": ["/talker /listener", "--all"],
    "export": [f"cyclonedds {TALKER}"],
    "try": ["ros2 /talker --dry-run"],
    "explain": ["--participant /talker --publish rt/chatter"],
    "who-may": ["", "k"],
    "diff": ["k k"],
    "permissions learn": [str(SEEN)],
    "inspect": ["k/public/identity_ca.cert.pem k/enclaves/governance.p7s"],
    "validate": ["k/enclaves/governance.xml"],
}
"""Commands that are given a keystore, or files of one, and change nothing: how each is run."""
CHANGING = {
    *("ca init", "ca add-set", "ca remove-set", "ca passphrase", "ca recover"),
    *("issue", "renew", "revoke", "permit"),
    *("sign-governance", "sign-permissions", "sign-request sign", "receipt import"),
    *("ra add", "ra revoke", "propose", "ledger move", "adopt"),
}
WITHOUT = {
    *("demo", "request", "bundle-key", "install", "rollback", "enrol", "explain-error", "profiles"),
    *("sign-request export", "sign-request import", "algorithms", "approve", "bench"),
    *(f"plugin {each}" for each in ("install", "status", "uninstall")),
    *("agent log", "agent run", "agent status", "agent stop", "uninstall"),
    *("schema", "ledger schema", "serve"),
    *(f"enrolment-token {each}" for each in ("create", "list", "revoke")),
    *(f"requests {each}" for each in ("approve", "list", "refuse")),
    *(f"governance {each}" for each in ("new", "presets", "read", "render")),
    *(f"permissions {each}" for each in ("import", "new", "read", "render")),
}
"""They are given no keystore."""

DOMAIN = """
profile: classical
roles:
  chatter: {publish: [rt/chatter], subscribe: [rt/chatter]}
participants:
  - {name: /talker, role: chatter}
  - {name: /listener, role: chatter}
"""


def commands(command, *path):
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            yield from commands(command.get_command(context, name), *path, name)
    else:
        yield " ".join(path)


def test_each_command_is_known_to_read_or_to_change():
    assert sorted(commands(group)) == sorted({*READING, *CHANGING, *WITHOUT})


# What somebody may have prepared. The canary is a folder beside the keystore.


def journal(k, **moves):
    (k / ".journal").mkdir()
    moves = {"targets": [], "entries": []} | moves
    (k / ".journal/moves.json").write_text(json.dumps(moves))


def spent(k, canary):
    journal(k)
    (k / ".journal/spent").symlink_to(canary)


def entries(k, canary):
    line = ["2026-11-21T12:00:00+00:00", "permissions", "x.p7s", None, "0" * 64, None]
    shutil.rmtree(k / "private")
    (k / "private").symlink_to(canary)
    journal(k, entries=[line])


def moved(k, canary):
    journal(k, targets=["enclaves/fleet/robot"], links=[["enclaves/talker/crl.pem", "../../x"]])
    (k / ".journal/0").mkdir()
    (k / ".journal/0/cert.pem").write_bytes(b"x")
    (k / "enclaves/fleet").symlink_to(canary)


def elsewhere(place):
    """What is at `place` lies with the canary, and a link is there."""

    def plant(k, canary):
        (k / place).rename(canary / "moved")
        (k / place).symlink_to(canary / "moved")

    return plant


def linked(place, target="file"):
    """A link to a file of the canary, or to one that is not there yet."""

    def plant(k, canary):
        (k / place).unlink(missing_ok=True)
        (k / place).symlink_to(canary / target)

    return plant


def unwritten(k, canary):
    """The ledger with its newest lines in the -wal."""
    path = k / "private/ledger.sqlite3"
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("CREATE TABLE another (number INTEGER)")
        shutil.copytree(k / "private", canary / "private")
    for each in path.parent.glob("ledger*"):
        each.unlink()
    for each in (canary / "private").glob("ledger*"):
        each.rename(path.parent / each.name)
    assert path.with_name("ledger.sqlite3-wal").stat().st_size > 0


def hot(k, canary):
    """A rollback journal that names a file which SQLite would delete behind it."""
    path, name = k / "private/ledger.sqlite3", os.fsencode(canary / "file")
    magic = bytes.fromhex("d9d505f920a163d7")
    header = magic + (1).to_bytes(4, "big") + bytes(4) + (1).to_bytes(4, "big")
    header += (512).to_bytes(4, "big") + (4096).to_bytes(4, "big")
    tail = (2).to_bytes(4, "big") + name + len(name).to_bytes(4, "big")
    tail += (sum(name) & 0xFFFFFFFF).to_bytes(4, "big") + magic
    path.with_name("ledger.sqlite3-journal").write_bytes(header.ljust(512, b"\0") + tail)


def pipe(k, canary):
    (k / "private/seen.json").unlink(missing_ok=True)
    os.mkfifo(k / "private/seen.json")


def older(k, canary):
    """A ledger that a command which changes the keystore would bring up to date."""
    path = k / "private/ledger.sqlite3"
    path.unlink()
    with closing(sqlite3.connect(path)) as database:
        database.execute(
            "CREATE TABLE issued (id INTEGER PRIMARY KEY, at TEXT, kind TEXT, name TEXT,"
            " serial TEXT, sha256 TEXT, not_after TEXT)"
        )


PLANTED = {
    "nothing": lambda k, canary: None,
    "a journal": lambda k, canary: journal(k),
    "a journal with moves": moved,
    "a journal that spends the canary": spent,
    "a journal with lines, and a link for private": entries,
    "a link for a journal": lambda k, canary: (k / ".journal").symlink_to(canary),
    "a file for a journal": lambda k, canary: (k / ".journal").write_bytes(b"x"),
    "a link for a draft": lambda k, canary: (k / ".draft-0123456789abcdef").symlink_to(canary),
    "private elsewhere": elsewhere("private"),
    "public elsewhere": elsewhere("public"),
    "enclaves elsewhere": elsewhere("enclaves"),
    "an enclave elsewhere": elsewhere("enclaves/talker"),
    "the ledger elsewhere": elsewhere("private/ledger.sqlite3"),
    "the settings elsewhere": elsewhere("pqsec.json"),
    "generations": lambda k, canary: (k / "private/generations").symlink_to(canary),
    "a ledger to be made elsewhere": linked("private/ledger.sqlite3", "new"),
    "a -wal elsewhere": linked("private/ledger.sqlite3-wal"),
    "a -shm elsewhere": linked("private/ledger.sqlite3-shm"),
    "a -journal elsewhere": linked("private/ledger.sqlite3-journal"),
    "what was seen, elsewhere": linked("private/seen.json"),
    "what was seen, to be made elsewhere": linked("private/seen.json", "new"),
    "a pipe for what was seen": pipe,
    "a certificate elsewhere": linked("enclaves/talker/cert.pem"),
    "a governance elsewhere": linked("enclaves/talker/governance.p7s"),
    "lines that are not written in yet": unwritten,
    "a rollback journal": hot,
    "an older ledger": older,
}


def snapshot(folder: Path) -> dict[str, object]:
    """All that can be seen of everything in it, but for when it was read."""
    found: dict[str, object] = {}
    for path in (folder, *sorted(folder.rglob("*"))):
        seen = path.lstat()
        content: object = None
        if stat.S_ISLNK(seen.st_mode):
            content = path.readlink()
        elif stat.S_ISREG(seen.st_mode):
            content = path.read_bytes()
        fields = (seen.st_mode, seen.st_ino, seen.st_nlink, seen.st_uid, seen.st_size)
        found[str(path)] = (*fields, seen.st_mtime_ns, content)
    return found


@pytest.fixture(scope="module")
def usual(domains, run_in, tmp_path_factory):
    """A keystore with a revocation list."""
    place = tmp_path_factory.mktemp("usual")
    copy(domains("classical"), place / "k")
    run_in(place, "-k k ca crl").done()
    return place / "k"


@pytest.fixture
def foreign(tmp_path, usual):
    """foreign(how) is a keystore that was prepared like that, with its canary."""

    def make(how):
        for old in ("k", "canary"):
            shutil.rmtree(tmp_path / old, ignore_errors=True)
        k, canary = copy(usual, tmp_path / "k"), tmp_path / "canary"
        canary.mkdir()
        (canary / "file").write_bytes(b"precious")
        how(k, canary)
        return [k, canary]

    (tmp_path / "domain.yaml").write_text(DOMAIN)
    return make


@pytest.mark.slow(but=15)
@pytest.mark.parametrize("command", READING)
def test_a_command_that_reads_alters_no_keystore_and_nothing_beside_it(command, foreign, pqsec):
    found, turn = [], list(READING).index(command)
    for words in dict.fromkeys(["nothing", *some([*PLANTED], turn)]):
        folders = foreign(PLANTED[words])
        for line in READING[command]:
            before = [*map(snapshot, folders)]
            done = pqsec(f"-k k {command} {line}")
            if [*map(snapshot, folders)] != before:
                found.append(f"{words}: {line}")
            if words == "nothing" and (done.code not in {0, 1} or "error:" in done.err):
                found.append(f"{words}: {done}")
    assert found == []
