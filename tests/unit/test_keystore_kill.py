"""A keystore survives a kill at any instant: old or new, never a mix.

A child process does the work and is killed at its Nth call to the operating system, for
every N until the work is done; writes are cut in half. Then the parent looks.
"""

import errno
import hashlib
import os
import shutil
import signal
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from pqsec_pki.algorithms import profile_named
from pqsec_pki.certificates import verify_chain
from pqsec_pki.documents import DomainSet, Permissions
from pqsec_pki.errors import ExistsError, KeystoreError, PqsecError
from pqsec_pki.keystore import Keystore, Wish, issue
from pqsec_pki.smime import Require, verify

pytestmark = pytest.mark.slow

NOW = datetime(2026, 11, 21, 12, tzinfo=UTC)
YEAR = timedelta(days=365)
KILLED = 9
CALLS = (*("open", "write", "mkdir", "chmod", "rename", "replace", "symlink", "unlink", "rmdir"),)


def create(root):
    return Keystore.create(
        root,
        profile_named("transition"),
        name="Lab",
        domains=DomainSet.of(0),
        validity=10 * YEAR,
        passphrase=None,
        now=NOW,
    )


def issue_to(root, *names, force=False):
    keystore = Keystore.open(root)
    wishes = [Wish(name=name, domains=DomainSet.of(0), validity=YEAR) for name in names]
    return issue(keystore, keystore.unlock(None), wishes, now=NOW, force=force)


# Killing


class Countdown:
    """Counts the calls that change something, and ends the process at the last."""

    def __init__(self, calls: int) -> None:
        self.left = calls

    def watch(self, name: str) -> None:
        real = getattr(os, name)

        def watched(*arguments, **options):
            self.left -= 1
            if self.left <= 0:
                if name == "write":  # half of it arrives
                    handle, data = arguments
                    real(handle, bytes(data)[: len(data) // 2])
                os._exit(KILLED)
            return real(*arguments, **options)

        setattr(os, name, watched)


def threads() -> int:
    return len(list(Path("/proc/self/task").iterdir()))


THREADS_OF_THE_RUNNER = threads()
"""One, or a few where tests run side by side; these know nothing of OpenSSL."""


def fork() -> int:
    """os.fork, once no thread is left that could hold one of OpenSSL's locks.

    A joined thread may still be on its way out of OpenSSL.
    """
    patience = time.monotonic() + 2
    while threads() > THREADS_OF_THE_RUNNER and time.monotonic() < patience:
        time.sleep(0.001)
    child = os.fork()
    if child == 0:
        signal.alarm(60)
    return child


def survives(calls: int, work: Callable[[], object]) -> bool:
    """Whether `work` is done before its process made so many calls."""
    child = fork()
    if child == 0:
        countdown = Countdown(calls)
        for name in CALLS:
            countdown.watch(name)
        try:
            work()
        except BaseException:  # noqa: BLE001 -- the parent wants to know of any
            os._exit(1)
        os._exit(0)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert code in {0, KILLED}, "the work failed by itself"
    return code == 0


# Looking


def check_whole(keystore: Keystore, name: str) -> str:
    """The certificate's fingerprint, after everything was found to fit together."""
    one = keystore.participant(name)
    assert one.key.public_key.spki == one.certificate.spki
    assert one.alternative_key.public_key.spki == one.certificate.alternative_key.spki
    verify_chain(one.certificate, one.identity_ca, now=NOW, require_alternative=True)
    verified = [
        verify(
            document,
            one.permissions_ca,
            alternative_ca=one.permissions_alt_ca,
            require=Require.BOTH,
        )
        for document in (one.permissions, one.governance)
    ]
    [grant] = Permissions.from_xml(verified[0].document).grants
    assert grant.subject_name == one.certificate.subject_name == f"CN={name}"
    folder = keystore.root / "enclaves" / name[1:]
    plain = (folder / "permissions.xml").read_bytes()
    assert Permissions.from_xml(plain) == Permissions.from_xml(verified[0].document)
    key_files = [folder / "key.pem", folder / "alt.key.pem"]
    assert {file.stat().st_mode & 0o777 for file in key_files} == {0o600}
    assert folder.stat().st_mode & 0o777 == 0o700
    return one.certificate.fingerprint


def check_ledger(keystore: Keystore) -> None:
    """The last lines on each name are what lies in its folder, and there are no others."""
    entries = keystore.ledger()
    assert [entry.kind for entry in entries[:4]] == [
        "identity-ca",
        "permissions-ca",
        "permissions-ca",
        "governance",
    ]
    assert entries[3].sha256 == hashlib.sha256(keystore.governance).hexdigest()
    last = {(entry.kind, entry.name): entry.sha256 for entry in entries[4:]}
    names = keystore.names()
    assert {name for _, name in last} == set(names)
    for name in names:
        one = keystore.participant(name)
        assert last["participant", name] == one.certificate.fingerprint
        assert last["permissions", name] == hashlib.sha256(one.permissions).hexdigest()


def check_no_halves(root: Path) -> None:
    """Also for a stack that looks before any pqsec command: a certificate comes last."""
    for certificate in (root / "enclaves").rglob("cert.pem"):
        files = {path.name for path in certificate.parent.iterdir() if path.exists()}
        assert files >= {
            *("key.pem", "alt.key.pem", "permissions.xml", "permissions.p7s", "governance.p7s"),
            *("identity_ca.cert.pem", "permissions_ca.cert.pem", "permissions_ca.alt.cert.pem"),
        }


def is_keystore(root: Path) -> bool:
    try:
        Keystore.open(root)
    except KeystoreError:
        return False
    return True


def drafts(root: Path) -> list[Path]:
    return [path for path in root.glob(".*") if path.name.startswith((".draft-", ".journal"))]


# What is done while the kill comes


@dataclass(frozen=True)
class Scene:
    """Work on a keystore that has the participants `before`; all of `after` then."""

    before: tuple[str, ...]
    work: Callable[[Path], object]
    after: tuple[str, ...]
    replaced: tuple[str, ...] = ()


SCENES = {
    "first issue": Scene((), lambda root: issue_to(root, "/talker"), ("/talker",)),
    "nested": Scene(
        (), lambda root: issue_to(root, "/fleet", "/fleet/robot1"), ("/fleet", "/fleet/robot1")
    ),
    "the outer beside the inner": Scene(
        ("/fleet/robot1",), lambda root: issue_to(root, "/fleet"), ("/fleet", "/fleet/robot1")
    ),
    "forced": Scene(
        ("/talker",),
        lambda root: issue_to(root, "/talker", force=True),
        ("/talker",),
        replaced=("/talker",),
    ),
    "some forced, some new": Scene(
        ("/fleet", "/fleet/robot1"),
        lambda root: issue_to(root, "/fleet", "/new", force=True),
        ("/fleet", "/fleet/robot1", "/new"),
        replaced=("/fleet",),
    ),
}


@pytest.fixture(scope="module")
def memory(tmp_path_factory):
    """A folder in memory where there is such: durability takes time, and is not tested here."""
    shared = Path("/dev/shm")
    if not os.access(shared, os.W_OK):
        yield tmp_path_factory.mktemp("disk")
        return
    with tempfile.TemporaryDirectory(dir=shared) as folder:
        yield Path(folder)


@pytest.fixture
def place(memory):
    """An empty folder."""
    with tempfile.TemporaryDirectory(dir=memory) as folder:
        yield Path(folder)


@pytest.fixture(scope="module")
def prepared(memory):
    """prepared(names) is a keystore with these participants, made once."""
    made: dict[tuple[str, ...], Path] = {}

    def make(names: tuple[str, ...]) -> Path:
        if names not in made:
            root = memory / f"prepared{len(made)}"
            create(root)
            if names:
                issue_to(root, *names)
            made[names] = root
        return made[names]

    return make


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_participants_are_all_issued_or_none_whenever_the_kill_comes(place, prepared, scene):
    original = prepared(scene.before)
    old = {name: check_whole(Keystore.open(original), name) for name in scene.before}
    outcomes = []
    for calls in range(1, 1000):
        root = place / str(calls)
        shutil.copytree(original, root, symlinks=True)
        done = survives(calls, lambda root=root: scene.work(root))

        check_no_halves(root)
        keystore = Keystore.open(root)
        names = tuple(keystore.names())
        assert names in {scene.before, scene.after}
        found = {name: check_whole(keystore, name) for name in names}
        check_ledger(keystore)
        new = {name for name in scene.replaced if found[name] != old[name]}
        assert new in (set(), set(scene.replaced))
        committed = names != scene.before or bool(new)
        kept = set(scene.before) - new
        assert all(found[name] == old[name] for name in kept)
        outcomes.append(committed)

        issue_to(root, "/next")
        check_whole(keystore, "/next")
        check_ledger(keystore)
        assert drafts(root) == []
        shutil.rmtree(root)
        if done:
            break
    assert len(outcomes) > 20
    # Not done, then from one call on done: the commitment is a single call.
    assert outcomes == sorted(outcomes)
    assert set(outcomes) == {False, True}


def test_a_keystore_is_made_or_not_whenever_the_kill_comes(place):
    outcomes = []
    for calls in range(1, 1000):
        root = place / str(calls)
        done = survives(calls, lambda root=root: create(root))
        outcomes.append(is_keystore(root))
        if outcomes[-1]:
            with pytest.raises(ExistsError):
                create(root)
        keystore = Keystore.open(root) if outcomes[-1] else create(root)
        assert keystore.names() == []
        check_ledger(keystore)
        keys = list((root / "private").glob("*.key.pem"))
        assert len(keys) == 4
        assert {key.stat().st_mode & 0o777 for key in keys} == {0o600}
        issue_to(root, "/talker")
        check_whole(keystore, "/talker")
        check_ledger(keystore)
        assert drafts(root) == []
        shutil.rmtree(root)
        if done:
            break
    assert len(outcomes) > 20
    assert outcomes == sorted(outcomes)
    assert set(outcomes) == {False, True}


def test_a_keystore_can_be_made_again_without_being_opened_after_a_kill(place):
    for calls in range(1, 1000, 3):
        root = place / str(calls)
        if survives(calls, lambda root=root: create(root)):
            break
        try:
            create(root)
        except ExistsError:
            Keystore.open(root)
        check_ledger(Keystore.open(root))
        shutil.rmtree(root)


def test_a_recovery_that_is_killed_too_is_finished_by_the_next(place, prepared):
    original = place / "committed"
    shutil.copytree(prepared(("/old",)), original, symlinks=True)
    calls = 1
    while not (original / ".journal").is_dir():
        survives(calls, lambda: issue_to(original, "/old", "/a", force=True))
        calls += 1
    for calls in range(1, 1000):
        root = place / str(calls)
        shutil.copytree(original, root, symlinks=True)
        done = survives(calls, lambda root=root: Keystore.open(root))
        keystore = Keystore.open(root)
        assert keystore.names() == ["/a", "/old"]
        for name in keystore.names():
            check_whole(keystore, name)
        check_ledger(keystore)
        shutil.rmtree(root)
        if done:
            assert calls > 10
            break


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO])
def test_a_disk_that_fails_at_any_call_is_no_worse_than_a_kill(place, prepared, code):
    original = prepared(("/old",))
    old = check_whole(Keystore.open(original), "/old")
    for calls in range(1, 1000):
        root = place / str(calls)
        shutil.copytree(original, root, symlinks=True)
        done = fails_with(code, calls, lambda root=root: issue_to(root, "/old", force=True))
        keystore = Keystore.open(root)
        found = check_whole(keystore, "/old")
        check_ledger(keystore)
        assert done or found == old or len(keystore.ledger()) == 4 + 2 * 2
        issue_to(root, "/next")
        assert drafts(root) == []
        shutil.rmtree(root)
        if done:
            break


def fails_with(code: int, calls: int, work: Callable[[], object]) -> bool:
    """Whether `work` is done, if the disk refuses its Nth call; it may fail by our errors only."""
    child = fork()
    if child == 0:
        left = [calls]
        for name in ("open", "write", "fchmod", "mkdir", "chmod", "rename", "replace", "symlink"):
            _refusing(name, code, left)
        try:
            work()
        except BaseException as error:  # noqa: BLE001 -- the parent wants to know of any
            os._exit(KILLED if isinstance(error, PqsecError) else 1)
        os._exit(0 if left[0] > 0 else KILLED)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert status in {0, KILLED}, "another error than ours"
    return status == 0


def _refusing(name: str, code: int, left: list[int]) -> None:
    real = getattr(os, name)

    def refusing(*arguments, **options):
        left[0] -= 1
        if left[0] == 0:
            raise OSError(code, os.strerror(code))
        return real(*arguments, **options)

    setattr(os, name, refusing)


# Two at once


def at_once(*works: Callable[[], object]) -> list[int]:
    """The exit codes of processes that each do one of `works`, all at the same time."""
    reader, writer = os.pipe()
    children = []
    for work in works:
        child = fork()
        if child == 0:
            os.close(writer)
            os.read(reader, 1)  # until the parent lets go
            os._exit(_code(work))
        children.append(child)
    os.close(reader)
    os.close(writer)
    return [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children]


def _code(work: Callable[[], object]) -> int:
    try:
        work()
    except ExistsError:
        return 3
    except BaseException:  # noqa: BLE001 -- the parent wants to know of any
        return 1
    return 0


def test_two_processes_issue_at_the_same_time(place):
    root = place / "keystore"
    create(root)
    names = [[f"/{who}{number}" for number in range(20)] for who in ("a", "b")]
    codes = at_once(*(lambda each=each: [issue_to(root, name) for name in each] for each in names))
    assert codes == [0, 0]
    keystore = Keystore.open(root)
    assert keystore.names() == sorted(names[0] + names[1])
    for name in keystore.names():
        check_whole(keystore, name)
    check_ledger(keystore)
    serials = [entry.serial for entry in keystore.ledger() if entry.serial]
    assert len(serials) == len(set(serials)) == 3 + 40
    assert drafts(root) == []


def test_two_processes_that_want_the_same_name_do_not_both_get_it(place):
    root = place / "keystore"
    create(root)
    for _ in range(5):
        shutil.rmtree(root / "enclaves/talker", ignore_errors=True)
        codes = at_once(*[lambda: issue_to(root, "/talker")] * 2)
        assert sorted(codes) == [0, 3]
        check_whole(Keystore.open(root), "/talker")
