"""`pqsec try` as its users run it, with the stacks of this machine."""

import doctest
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pqsec_pki.algorithms import load_private_key, private_key_pem
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.trial import MACHINE, STACKS, MissingStackError, built, find
from tests.docs.tables import Document
from tests.interop.conftest import DOMAINS, LAB_PROFILES, TOPIC, YEAR
from tests.interop.roots import TRIXIE

pytestmark = pytest.mark.interop

TITLE = "What try shows"
SECRET = b"correct horse battery staple"


@pytest.fixture(scope="module")
def domain(tmp_path_factory, now):
    """domain() is a folder with a keystore `k`: /talker may publish, /listener subscribe."""

    def make() -> Path:
        folder = tmp_path_factory.mktemp("try")
        profile = LAB_PROFILES["transition"]
        options = {"domains": DOMAINS, "validity": 10 * YEAR, "now": now, "passphrase": None}
        keystore = Keystore.create(folder / "k", profile, name="Lab", **options)
        may = {"domains": DOMAINS, "validity": YEAR}
        specs = [
            ParticipantSpec(name="/talker", publish=(TOPIC,), **may),
            ParticipantSpec(name="/listener", subscribe=(TOPIC,), **may),
        ]
        issue(keystore, keystore.unlock(None), specs, now=now)
        return folder

    return make


@pytest.fixture(scope="module")
def folder(domain) -> Path:
    return domain()


@pytest.fixture
def command(folder, requires):
    """command("try cyclonedds ...") is what runs it, its folder and its environment."""

    def line(text: str) -> dict:
        program, verb, stack, *_ = words = text.split()
        assert (program, verb) == ("pqsec", "try")
        try:
            requires(find(stack), stack, "")
        except MissingStackError as error:
            requires(None, stack, error.hint)
        ours = {"XDG_CACHE_HOME": str(folder / "cache"), "PQSEC_KEYSTORE": "k"}
        return {
            "args": [sys.executable, "-m", "pqsec_pki", *words[1:]],
            "cwd": folder,
            "env": os.environ | ours,
            "stdin": subprocess.DEVNULL,
        }

    return line


@pytest.fixture
def pqsec(command):
    """pqsec("pqsec try ...") is (exit code, what it printed)."""

    def run(text: str) -> tuple[int, str]:
        done = subprocess.run(
            **command(text), stdout=subprocess.PIPE, text=True, timeout=300, check=False
        )
        return done.returncode, done.stdout

    return run


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(0, 0)])
def test_the_documents_show_what_it_prints(pqsec, number, code):
    line, _, expected = Document("reference/commands.md").block(TITLE, number).partition("\n")
    done, printed = pqsec(line.removeprefix("$ "))
    if os.geteuid() != 0 and code == 0:
        pytest.skip("only root sees the wire: run the tests as root")
    assert done == code
    flags = doctest.ELLIPSIS
    assert doctest.OutputChecker().check_output(expected, printed, flags), printed


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("stack", STACKS)
@pytest.mark.parametrize(
    ("more", "code", "accepted"),
    [("", 0, True), ("--topic rt/secret", 1, False), ("--domain 0 --timeout 30", 0, True)],
)
def test_json_says_the_same_as_the_exit_code(pqsec, stack, more, code, accepted):
    done, printed = pqsec(f"pqsec try {stack} /listener /talker --json {more}")
    told = json.loads(printed)
    assert done == code
    assert (told["ok"], told["accepted"]) == (code == 0, accepted)
    assert told["unauthenticated_heard"] is (False if accepted else None)
    assert told["stack"] == stack
    assert (told["topic"] == TOPIC) is accepted
    # Who listens cannot be asked to send, unless the user insists on the topic.
    assert told["sender"] == ("/talker" if accepted else "/listener")
    assert bool(told["findings"]) is not accepted


@pytest.mark.slow
def test_json_says_who_ran_the_plugin(pqsec):
    """And who has Cyclone DDS's own does not meet a post-quantum peer that did not ask for it."""
    line = "pqsec try cyclonedds --plugin --stock listener /talker listener --json --timeout 4"
    done, printed = pqsec(line)
    told = json.loads(printed)
    assert done == 1
    assert told["plugin"] == ["/talker"]
    assert any("pqsec.toml" in (each["remedy"] or "") for each in told["findings"])


CYCLONE = ("include/dds", "include/ddsc", "include/idl", "include/idlc", "bin/idlc")
"""Of a prefix, beside its libraries."""


@pytest.fixture(scope="module")
def two_cyclones(requires, tmp_path_factory) -> Path:
    """A root file system with Debian 13's Cyclone DDS in usr/local, and Debian 12's in usr."""
    here, there = (_installation(requires, root) for root in (MACHINE, TRIXIE))
    root = tmp_path_factory.mktemp("two-cyclones") / "root"
    shutil.copytree(TRIXIE, root, symlinks=True, copy_function=_linked)
    libraries = there.folder.relative_to(TRIXIE)
    for name in CYCLONE:
        goal = root / "usr/local" / name
        goal.parent.mkdir(parents=True, exist_ok=True)
        shutil.move(root / "usr" / name, goal)
        _copied(MACHINE / "usr" / name, root / "usr" / name)
    local = root / "usr/local/lib"
    local.mkdir()
    for found in sorted((root / libraries).glob("libddsc*")) + sorted(
        (root / libraries).glob("libcycloneddsidl*")
    ):
        shutil.move(found, local / found.name)
    for pattern in ("libddsc*", "libcycloneddsidl*"):
        for found in here.folder.glob(pattern):
            _copied(found, root / libraries / found.name)
    return root


def _installation(requires, root: Path):
    try:
        return find("cyclonedds", root)
    except MissingStackError as error:
        return requires(None, f"Cyclone DDS below {root}", f"run .ci/trixie, or {error.hint}")


def _linked(source: str, goal: str) -> None:
    try:
        os.link(source, goal)
    except OSError:  # of another file system
        shutil.copy2(source, goal)


def _copied(source: Path, goal: Path) -> None:
    if source.is_dir():
        shutil.copytree(source, goal, symlinks=True)
    else:
        shutil.copy2(source, goal, follow_symlinks=False)


@pytest.mark.slow
def test_of_two_cyclones_what_is_found_is_linked_run_and_told(
    pqsec, two_cyclones, tmp_path, monkeypatch
):
    """Both have one soname: only the folder of the library tells them apart."""
    found = find("cyclonedds", two_cyclones)
    assert find("cyclonedds").version != found.version == find("cyclonedds", TRIXIE).version
    done, printed = pqsec(f"pqsec try cyclonedds --root {two_cyclones} /talker /listener --json")
    told = json.loads(printed)
    assert (done, told["stack_version"]) == (0, found.version), told
    assert told["library"] == str(found.library.path)
    assert found.library.path.is_relative_to(two_cyclones / "usr/local")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    loading = os.environ | {"LD_TRACE_LOADED_OBJECTS": "1", "LD_LIBRARY_PATH": "/usr/lib"}
    command = found.peer(built(found))
    traced = subprocess.run(command, env=loading, capture_output=True, text=True, check=True)
    [line] = [line for line in traced.stdout.splitlines() if "libddsc" in line]
    assert str(found.folder) in line


def peers(folder: Path) -> int:
    """How many peers run that were compiled for this folder."""
    there = 0
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            there += str(folder / "cache").encode() in path.read_bytes()
        except OSError:
            continue
    return there


@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "code"),
    [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGKILL, -9)],
    ids=["interrupted", "ended", "killed"],
)
def test_a_trial_that_is_stopped_leaves_nothing_running_and_no_passphrase_on_disk(
    command, domain, tmp_path, how, code
):
    here, there = domain(), domain()
    listener = "k/enclaves/listener"  # of another domain: the two never meet
    shutil.rmtree(here / listener)
    shutil.copytree(there / listener, here / listener)
    for key in here.glob("k/enclaves/*/key.pem"):
        key.write_bytes(private_key_pem(load_private_key(key.read_bytes()), SECRET))
    passphrase = tmp_path / "passphrase"
    passphrase.write_bytes(SECRET)
    passphrase.chmod(0o600)
    line = f"pqsec try cyclonedds /talker /listener --password-file {passphrase}"
    with_all = command(f"{line} --timeout 60 --anyway")
    with_all["env"] |= {"XDG_CACHE_HOME": str(here / "cache"), "TMPDIR": str(here)}
    process = subprocess.Popen(**with_all | {"cwd": here}, stderr=subprocess.PIPE)
    while peers(here) < 3:
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.05)
    process.send_signal(how)
    process.communicate(timeout=300)
    assert process.returncode == code
    time.sleep(0.2)
    assert peers(here) == 0
    files = [path for path in here.rglob("*") if path.is_file()]
    assert [path for path in files if SECRET in path.read_bytes()] == []
    # A process that was killed could not remove what was in memory only.
    left = [path for path in Path("/dev/shm").glob("pqsec-trial-*") if _names(path, here)]
    assert [path.stat().st_mode & 0o777 for path in left] == [0o700] * (how == signal.SIGKILL)
    for path in left:
        shutil.rmtree(path)


def _names(trial: Path, keystore: Path) -> bool:
    """Whether that trial is one of participants in that folder."""
    files = trial.glob("*/cyclonedds.xml")
    return any(str(keystore).encode() in path.read_bytes() for path in files)
