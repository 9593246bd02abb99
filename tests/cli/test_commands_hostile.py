"""Every command with files, words and keystores that it cannot like.

The commands are those of the click tree, so a new one is tested by being there. None may
hang, show a traceback, pass on what a terminal would obey, or leave anything half done.
In the gate each command meets a part of them, and each of them a part of the commands.
"""

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import click
import pytest

from pqsec_pki.cli import pqsec as tree
from tests.cli.conftest import copy, snapshot
from tests.longer import some
from tests.unit.approving import Council

ENDLESS = {
    "agent run": "it serves until it is told to stop",
    "serve": "likewise",
}
VALUES = {
    "plan": "plan.json",
    "names": "/talker",
    "words": "revoke",
    "name": "/talker",
    "subjects": "/talker",
    "text": "141",
}
"""What stands for an argument that is no file; files are there, and seldom the right kind."""
CHOICES = {
    "ca add-set": "hybrid",
    "ca remove-set": "hybrid",
    "export": "cyclonedds",
    "schema": "domain",
    "try": "ros2",
}
COMPANY = {
    "apply": "--yes --no-passphrase",
    "apply --passphrase-file": "--yes",
    "approve": "--yes --key bob.pem",
    "approve --key": "--yes",
    "bench": "--profile classical --rounds 1 --warm-up 0",
    "bundle": "--plain-key",
    "bundle --robot": "--plain-key --force",
    "bundle --seal-for": "",
    "ca init": "--no-passphrase --profile classical",
    "ca init --passphrase-file": "",
    "ca passphrase": "--no-passphrase",
    "ca passphrase --new-passphrase-file": "",
    "ca remove-set": "--yes",
    "ca rotate": "--apply --yes --no-passphrase",
    "ca rotate --passphrase-file": "--apply --yes",
    "demo": "--profile classical",
    "estimate": "",
    "explain": "--participant /talker --publish rt/chatter",
    "explain --governance": "--permissions k/enclaves/talker/permissions.xml --publish t",
    "explain --permissions": "--governance k/enclaves/governance.xml --publish t",
    "explain --permissions-ca": "--governance k/enclaves/governance.p7s --publish t"
    " --permissions k/enclaves/talker/permissions.p7s",
    "issue": "--publish t --force",
    "plan --key": "-o out.json",
    "plan --output": "--key alice.pem",
    "issue --bundles": "--publish t --csr asks.csr",
    "issue --csr": "--publish t",
    "issue --policy": "--force",
    "issue --seal-for": "--publish t --csr asks.csr",
    "propose": "--key=alice.pem -o out.json",
    "propose --key": "-o out.json",
    "request": "--profile classical",
    "try": "--dry-run",
    "uninstall": "--list",
    "verify": "--ca k/public/permissions_ca.cert.pem",
    "verify-handshake": "/listener",
    "who-may --governance": "k/enclaves/talker/permissions.xml",
}
"""Words without which a command would not get as far as the file that is tried."""
ALONE = {"bundle --robot", "issue --csr"}
"""Options that stand for names."""
DONE = ("succeeded", "is issued", "are issued")
"""What a hint says where only the file in which the result goes could not be written."""


def leaves(group: click.Group = tree, *words: str) -> Iterator[tuple[str, click.Command]]:
    """Every command that is no group, with its words."""
    for name in group.list_commands(click.Context(group)):
        command = group.get_command(click.Context(group), name)
        if isinstance(command, click.Group):
            yield from leaves(command, *words, name)
        else:
            yield " ".join((*words, name)), command


COMMANDS = {words: command for words, command in leaves() if words not in ENDLESS}


def tried(kind: Callable[[click.Parameter], bool]) -> dict[tuple[str, str], click.Parameter]:
    """Every parameter of that kind of every command, by command and option or argument."""
    return {
        (words, parameter.opts[0]): parameter
        for words, command in COMMANDS.items()
        for parameter in command.params
        if kind(parameter)
    }


def is_path(parameter: click.Parameter) -> bool:
    return isinstance(parameter.type, click.Path)


def is_text(parameter: click.Parameter) -> bool:
    known = click.Path, click.Choice
    return not isinstance(parameter.type, known) and not getattr(parameter, "is_flag", False)


def line(words: str, opened: str, value: str) -> list[str]:
    """The command with `value` in that place, and in the others what it needs."""
    said = words.split() if opened == "-k" else ["-k", "k", *words.split()]
    said += COMPANY.get(f"{words} {opened}", COMPANY.get(words, "")).split()
    if opened.startswith("--"):
        said.append(f"{opened}={value}")
    elif opened.startswith("-"):
        said += [opened, value]
    last = ["--"]
    for each in COMMANDS[words].params:
        if isinstance(each, click.Option):
            said += [each.opts[0], "out"] if each.required and opened not in each.opts else []
        elif each.name == opened:
            last.append(value)
        elif each.required or (each.name in VALUES and f"{words} {opened}" not in ALONE):
            last += [filler(words, each)]
    return said + last


def filler(words: str, argument: click.Parameter) -> str:
    if isinstance(argument.type, click.Choice):
        return CHOICES[words]
    return VALUES.get(str(argument.name), "k/enclaves/governance.xml")


# What is fed


def make_folder(path: Path) -> None:
    path.mkdir()
    (path / "file.xml").write_text("not what it says")


FILES: dict[str, Callable[[Path], object]] = {
    "nothing": lambda path: None,
    "nothing, below a file": lambda path: path.parent.write_text("a file"),
    "a long name": lambda path: None,
    "an empty file": Path.touch,
    "noise": lambda path: path.write_bytes(bytes(n * n * 31 % 251 for n in range(4096))),
    "100 MB of zeros": lambda path: (path.touch(), os.truncate(path, 100 << 20)),
    "as much as is taken": lambda path: path.write_bytes(b"<a>[{-\n" * (1 << 17)),
    "a private key": lambda path: shutil.copy("k/private/identity_ca.key.pem", path),
    "a certificate": lambda path: shutil.copy("k/public/identity_ca.cert.pem", path),
    "a ledger": lambda path: shutil.copy("k/private/ledger.sqlite3", path),
    "escape sequences": lambda path: path.write_bytes(b"\x1b[2J\x1b]0;x\x07\r\xe2\x80\xae: x"),
    "a folder": make_folder,
    "a pipe": os.mkfifo,
    "a link to nowhere": lambda path: path.symlink_to("nowhere"),
    "a link to itself": lambda path: path.symlink_to(path.name),
    "a device without end": lambda path: path.symlink_to("/dev/zero"),
    "a name that moves the cursor": Path.touch,
    "a name that is no text": Path.touch,
}
FOR_FOLDERS = (
    *("nothing", "nothing, below a file", "a long name", "an empty file", "a folder", "a pipe"),
    *("a link to nowhere", "a link to itself", "a name that is no text"),
)
"""What is fed to an option that takes a folder: other files end as the empty one does."""
NAMES = {
    "nothing, below a file": "file/below",
    "a long name": "x" * 300,
    "a name that moves the cursor": "a\nb\x1b[2J\u202ec",
    "a name that is no text": os.fsdecode(b"a\xff"),
}
WORDS = {
    "nothing": "",
    "the folders above": "/../../etc",
    "a long text": "/" + "x" * 5000,
    "what moves the cursor": "/a\nb\x1b[2J\u202ec",
    "what is no text": os.fsdecode(b"/a\xff"),
    "a negative number": "-1",
    "a number of 5000 digits": "9" * 5000,
    "other digits": "\u0663\u0664y",
    "more days than there are": "999999y",
    "a pattern that is open": "[!a",
}


def everywhere(change: Callable[[Path], object], *files: str) -> Callable[[Path], None]:
    def changed(k: Path) -> None:
        for file in files:
            shutil.rmtree(k / file) if (k / file).is_dir() else (k / file).unlink()
            change(k / file)

    return changed


TALKER = [
    f"enclaves/talker/{name}"
    for name in ("cert.pem", "key.pem", "permissions.p7s", "governance.p7s")
]
CAS = ["public/identity_ca.cert.pem", "public/permissions_ca.cert.pem"]
STATES = {
    "a newer format": lambda k: (k / "pqsec.json").write_text('{"format": 99}'),
    "settings that are none": lambda k: (k / "pqsec.json").write_bytes(b"\xff" + b"[" * 100_000),
    "a ledger that is none": everywhere(FILES["noise"], "private/ledger.sqlite3"),
    "a pipe for a ledger": everywhere(os.mkfifo, "private/ledger.sqlite3"),
    "no private folder": lambda k: shutil.rmtree(k / "private"),
    "files for folders": everywhere(Path.touch, "private", "public", "enclaves"),
    "CA certificates that are none": everywhere(FILES["noise"], *CAS),
    "pipes for CA certificates": everywhere(os.mkfifo, *CAS),
    "CA keys that are none": everywhere(FILES["noise"], "private/identity_ca.key.pem"),
    "no participant": lambda k: shutil.rmtree(k / "enclaves/talker"),
    "pipes for a participant": everywhere(os.mkfifo, *TALKER),
    "noise for a participant": everywhere(FILES["noise"], *TALKER),
    "a participant without end": everywhere(FILES["a device without end"], *TALKER),
    "links in a circle": lambda k: (k / "enclaves/talker/up").symlink_to(".."),
}


# What must hold


@pytest.fixture(scope="module")
def template(domains, run_in, tmp_path_factory) -> Path:
    """A folder with a keystore `k`, a request, a domain file, and a folder with nothing in it."""
    folder = tmp_path_factory.mktemp("template")
    copy(domains("classical"), folder / "k")
    run_in(folder, "request /fleet/robot --profile classical --dir r").done()
    shutil.copy(folder / "r/requests/fleet+robot/request.csr", folder / "asks.csr")
    run_in(folder, "plan --init").done()
    Council(folder / "council").written(folder / "plan.json")
    for name in ("alice.pem", "bob.pem"):
        shutil.copy(folder / "council" / name, folder)
    (folder / "empty").mkdir(mode=0o700)
    return folder


@pytest.fixture
def place(template, tmp_path, monkeypatch) -> Path:
    """The test's own copy; there is neither a home nor a compiler."""
    here = copy(template, tmp_path / "here")
    for variable in ("HOME", "PATH", "XDG_RUNTIME_DIR", "XDG_CACHE_HOME"):
        monkeypatch.setenv(variable, str(here / "empty"))
    monkeypatch.setattr("pqsec_pki._files.PIPE_PATIENCE", 0.001)
    monkeypatch.chdir(here)
    return here


def flaws(run_in, place: Path, said: list[str]) -> list[str]:
    """What is wrong with how that command ends."""
    before, stamps_before = snapshot(place / "k"), stamps(place / "k")
    try:
        result = run_in(place, "", *said)
    except (Exception, SystemExit) as error:  # noqa: BLE001 -- whatever a user would see as a traceback
        return [f"{type(error).__name__}: {error}"]
    after = before if stamps(place / "k") == stamps_before else snapshot(place / "k")
    quoted = [each for each in secrets_of(before, after) if each in result.out + result.err]
    return [*found_in(result, unchanged=before == after), *["a key is quoted"] * bool(quoted)]


def stamps(folder: Path | str) -> dict[str, tuple[int, ...]]:
    """What changes with each file and folder below; quicker to look at than their content."""
    found: dict[str, tuple[int, ...]] = {}
    with os.scandir(folder) as entries:
        for entry in entries:
            status = entry.stat(follow_symlinks=False)
            found[entry.path] = status.st_ino, status.st_mode, status.st_mtime_ns, status.st_size
            if entry.is_dir(follow_symlinks=False):
                found |= stamps(entry.path)
    return found


def secrets_of(*snapshots: dict[str, bytes]) -> set[str]:
    """The lines of the private keys, but for the first, which begins alike in all."""
    keys = {data for files in snapshots for name, data in files.items() if name.endswith("key.pem")}
    return {
        line
        for data in keys
        for line in data.decode(errors="replace").splitlines()[2:-1]
        if data.startswith(b"-----BEGIN")
    }


def found_in(result, *, unchanged: bool) -> Iterator[str]:
    errors = result.err.splitlines()
    if result.code not in {0, 1, 2, 3}:
        yield f"exit code {result.code}"
    if not all(
        each.startswith(("pqsec: error: ", "pqsec: note: ", "pqsec: hint: ")) for each in errors
    ):
        yield f"an odd line: {result.err}"
    if not (result.out + result.err).replace("\n", "").isprintable():
        yield "what a terminal would obey"
    if result.code in {2, 3}:
        # A check and a report tell what they found, and that it is not all.
        incomplete = "; incomplete: " in result.out or " is incomplete: " in result.err
        # A command that cannot ask has shown what it would do.
        cannot_ask = ", and no terminal to ask" in result.err
        if result.out and not (incomplete or cannot_ask):
            yield f"a result beside an error: {result.out[:80]}"
        if "pqsec: error: " not in result.err and not incomplete:
            yield "no error is told"
        if not (unchanged or any(words in result.err for words in DONE)):
            yield "the keystore is another"


def test_the_tree_has_commands_that_take_files():
    """Else the tests below would prove nothing."""
    assert len(tried(is_path)) > 100
    assert len(tried(is_text)) > 50


def renewed(template: Path, place: Path) -> Iterator[None]:
    """Each time that it is asked, the keystore is as it was."""
    while True:
        before = stamps(place / "k")
        yield
        if stamps(place / "k") != before:
            shutil.rmtree(place / "k")
            copy(template / "k", place / "k")


@pytest.mark.slow(but=97)
@pytest.mark.parametrize(("words", "opened"), tried(is_path))
def test_files_that_cannot_be_liked(template, place, run_in, words, opened):
    found = []
    takes_files = tried(is_path)[words, opened].type.file_okay
    kinds = [kind for kind in FILES if takes_files or kind in FOR_FOLDERS]
    turn = list(tried(is_path)).index((words, opened))
    for _, kind in zip(renewed(template, place), some(kinds, turn), strict=False):
        folder = f"case{kinds.index(kind)}"
        (place / folder).mkdir()
        name = f"{folder}/{NAMES.get(kind, 'file')}"
        FILES[kind](place / name)
        found += [f"{kind}: {each}" for each in flaws(run_in, place, line(words, opened, name))]
    assert found == []


@pytest.mark.parametrize(("words", "opened"), tried(is_text))
def test_words_that_cannot_be_liked(template, place, run_in, words, opened):
    found = []
    turn = list(tried(is_text)).index((words, opened))
    for _, kind in zip(renewed(template, place), some([*WORDS], turn), strict=False):
        said = line(words, opened, WORDS[kind])
        found += [f"{kind}: {each}" for each in flaws(run_in, place, said)]
    assert found == []


@pytest.mark.parametrize("words", COMMANDS)
def test_keystores_that_cannot_be_liked(template, place, run_in, words):
    found = []
    turn = list(COMMANDS).index(words)
    for _, state in zip(renewed(template, place), some([*STATES], turn), strict=False):
        STATES[state](place / "k")
        found += [f"{state}: {each}" for each in flaws(run_in, place, line(words, "", ""))]
    assert found == []
