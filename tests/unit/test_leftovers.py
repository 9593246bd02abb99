"""What killed commands leave: the next change removes temporary files, and ends half a change."""

import errno
import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from pqsec_pki import _drafts, _files
from pqsec_pki._drafts import draft_file, draft_folder
from pqsec_pki._files import write
from pqsec_pki.enrolment.credential_store import changing
from pqsec_pki.errors import ExistsError, FileError, InterruptedChangeError, PqsecError
from pqsec_pki.keystore import Keystore, _journal, _lock, audit, change
from pqsec_pki.keystore._folder import Folder
from pqsec_pki.keystore.layout import JOURNAL
from pqsec_pki.lifecycle import adopt
from pqsec_pki.lint import check
from pqsec_pki.vendors import Export
from pqsec_pki.vendors import write as write_export
from tests.longer import LONG
from tests.running import run_here
from tests.unit.killing import (
    KILLED,
    NOW,
    copies,
    create,
    disturbed_calls,
    drafts,
    fails_with,
    fork,
    issue_to,
    survives,
)
from tests.unit.sros2_keystore import SROS2


def names(folder):
    return sorted(each.name for each in folder.iterdir())


# Files and folders outside keystores


def to_a_new_file(folder):
    _files._UNNAMED = 0  # as on most file systems
    write(folder / "b.bundle", b"new" * 100, private=True)


def over_an_old_file(folder):
    write(folder / "old", b"new" * 100, force=True)


def into_a_folder(folder):
    with Folder.opened(folder) as there:
        there.replace("seen.json", b"new" * 100)


def an_export(folder):
    files = {"run.sh": "new" * 100, "more/set.xml": "new"}
    write_export(Export(stack="cyclonedds", participant="/a", files=files), folder / "cyclone")


@pytest.mark.parametrize("work", [to_a_new_file, over_an_old_file, into_a_folder, an_export])
def test_the_next_file_in_a_folder_ends_what_a_killed_command_left_there(place, work):
    left = 0
    for calls in disturbed_calls(1):
        folder = place / str(calls)
        folder.mkdir()
        (folder / "old").write_text("old")
        (folder / ".pqsec-0123").write_text("of somebody")
        done = survives(calls, lambda folder=folder: work(folder))
        left += bool(
            [each for each in names(folder) if each.startswith(".pqsec-") and len(each) > 20]
        )
        write(folder / "next", b"next")
        assert {*names(folder)} <= {
            *(".pqsec-0123", "old", "next", "b.bundle", "seen.json", "cyclone")
        }
        for each in ("b.bundle", "seen.json"):
            with suppress(FileNotFoundError):
                assert (folder / each).read_bytes() == b"new" * 100
        assert (folder / "old").read_bytes() in {b"old", b"new" * 100}
        if done:
            break
    assert done
    assert left > 1


def test_a_new_file_leaves_nothing_at_all_when_its_command_is_killed(place):
    """Where the file system has files without names, as ext4, XFS, Btrfs and tmpfs."""
    for calls in disturbed_calls(1):
        folder = place / str(calls)
        folder.mkdir()
        done = survives(calls, lambda folder=folder: write(folder / "made", b"new" * 100))
        assert names(folder) in ([], ["made"])
        if names(folder):
            assert (folder / "made").read_bytes() == b"new" * 100
        if done:
            break
    assert done
    assert calls > 4


def test_a_draft_that_a_process_uses_stays(tmp_path):
    script = """
        import sys
        from pqsec_pki._drafts import draft_file, draft_folder
        with draft_file(".", "b"), draft_folder("."):
            print("ready", flush=True)
            sys.stdin.read()
    """
    command = [sys.executable, "-c", "\n".join(line[8:] for line in script.splitlines())]
    streams = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, cwd=tmp_path, **streams) as process:
        assert process.stdout.readline() == b"ready\n"
        write(tmp_path / "mine", b"")
        assert len(drafts(tmp_path)) == 2
        process.send_signal(signal.SIGKILL)
    write(tmp_path / "mine", b"", force=True)
    assert names(tmp_path) == ["mine"]


def test_a_draft_of_an_earlier_version_goes_with_the_next_file_of_that_name(tmp_path):
    for name in (".b.bundle.0123456789abcdef", ".c.bundle.0123456789abcdef"):
        (tmp_path / name).write_text("left")
    write(tmp_path / "b.bundle", b"")
    assert names(tmp_path) == [".c.bundle.0123456789abcdef", "b.bundle"]


def test_a_draft_that_another_process_took_for_a_left_one_is_made_again(tmp_path, monkeypatch):
    """Between its making and its lock."""
    real, taken = fcntl.flock, []

    def late(handle, kind):
        [draft] = tmp_path.glob(".pqsec-*")
        if not taken:
            taken.append(draft)
            draft.rmdir() if draft.is_dir() else draft.unlink()
        real(handle, kind)

    monkeypatch.setattr(_drafts.fcntl, "flock", late)
    with draft_file(str(tmp_path), "b") as (name, _):
        assert (tmp_path / name).is_file()
    taken.clear()
    with draft_folder(str(tmp_path)) as made:
        assert Path(made).is_dir()
    assert names(tmp_path) == []


@pytest.mark.parametrize("unnamed", [_files._UNNAMED, 0])
def test_a_folder_is_not_listed_for_each_file_that_is_added(tmp_path, monkeypatch, unnamed):
    """Ten thousand bundles, for example."""
    monkeypatch.setattr(_files, "_UNNAMED", unnamed)
    listed = []
    monkeypatch.setattr(_drafts.os, "listdir", lambda folder: listed.append(folder) or [])
    for number in range(20):
        write(tmp_path / str(number), b"")
    assert len(listed) == 1


# Keystores and robots


def test_the_next_change_ends_drafts_in_all_folders_of_a_keystore(tmp_path):
    create(tmp_path)
    for name in (".pqsec-0123456789abcdef", ".seen.json.0123456789abcdef"):
        (tmp_path / "private" / name).write_text("left")
    (tmp_path / ".pqsec-0123456789abcdef").write_text("left")
    (tmp_path / ".draft-0123456789abcdef").mkdir()
    before = names(tmp_path / "private")
    with change(tmp_path):
        pass
    assert drafts(tmp_path) == []
    assert names(tmp_path / "private") == [each for each in before if not each.startswith(".")]


def test_the_next_change_ends_drafts_in_a_robots_folder(tmp_path):
    robot = tmp_path / "robot"
    robot.mkdir(0o700)
    for name in (".pqsec-0123456789abcdef", ".bundle.key.pem.0123456789abcdef"):
        (robot / name).write_text("left")
    (robot / ".draft-0123456789abcdef").mkdir()
    (robot / ".mine").touch()
    with changing(robot):
        pass
    assert names(robot) == [".mine"]


def half_done(root, work=lambda root: issue_to(root, "/a")):
    """A keystore with a change that was killed after its commit."""
    if work is not create:
        create(root)
    if not (child := fork()):
        _journal._finish = lambda folder: os._exit(KILLED) if folder.kind(JOURNAL) else None
        work(root)
        os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == KILLED
    return root


def test_half_a_change_has_one_exit_code_in_all_commands_that_read(place, tmp_path):
    root = half_done(place / "k")
    for line in (
        "status",
        "log",
        "log --verify",
        "check",
        "check --strict",
        "needs-renewal",
        "verify-handshake --all",
        "ca show",
        "report",
        "check --json",
    ):
        code, out, err = run_here(["-k", str(root), *line.split()], cwd=tmp_path, env=os.environ)
        assert code == 3, (line, out, err)
        assert "ca recover" in out + err, line
    found = json.loads(out)
    assert (found["ok"], found["incomplete"]) == (False, True)


def test_the_check_waits_for_a_change_that_is_at_work_and_finds_nothing(place, monkeypatch):
    root = half_done(place / "k")
    real = _lock.lock

    def finished(folder, kind):
        monkeypatch.setattr(_lock, "lock", real)
        Keystore.recover(root)  # by the other command, whose lock is waited for
        real(folder, kind)

    monkeypatch.setattr(_lock, "lock", finished)
    assert check((root,), now=NOW).inventory.interrupted_change is None


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO, errno.EROFS])
def test_a_disk_that_refuses_after_the_commit_is_told_as_half_a_change(place, code):
    """The message says that the change is made, and not to repeat it."""
    original = create_in(place / "original")
    told = 0
    for calls in disturbed_calls(5):
        root = place / str(calls)
        shutil.copytree(original, root, symlinks=True)

        said = place / f"{calls}.told"

        def work(root=root, said=said):
            try:
                issue_to(root, "/a")
            except FileError as error:
                if "the change is committed" in str(error):
                    said.write_text(str(error.hint))
                raise

        done = fails_with(code, calls, work)
        half = (root / ".journal").is_dir()
        assert said.exists() == half
        if half:
            told += 1
            assert "ca recover" in said.read_text()
            with pytest.raises(InterruptedChangeError):
                Keystore.open(root)
        is_in = "/a" in Keystore.open(root, to_change=True).names()
        assert is_in or not (done or half)
        shutil.rmtree(root)
        if done:
            break
    assert told


def create_in(root):
    create(root)
    return root


@pytest.mark.parametrize("how", ["killed", "full"])
def test_adopt_goes_on_where_it_was_stopped(place, how):
    trial = survives if how == "killed" else full
    original = SROS2(place / "original")
    for name in ("/talker", "/fleet/r1"):
        original.enclave(name)
    (original.root / "enclaves/talker/crl.pem").write_bytes(original.revoke(77))
    states = set()

    def work(root):
        adopt(root, now=NOW)

    for root, done in copies(place, original.root, work, trial, every=1 if trial is full else 5):
        states.add(((root / ".journal").is_dir(), (root / "pqsec.json").is_file()))
        if done or ((root / "pqsec.json").is_file() and not drafts(root)):
            with pytest.raises(ExistsError, match="is a pqsec keystore already"):
                adopt(root, now=NOW)
        else:
            assert sorted(adopt(root, now=NOW).participants) == ["/fleet/r1", "/talker"]
        audit(Keystore.open(root))
        assert drafts(root) == []
        assert check((root,), now=NOW).inventory.interrupted_change is None
    possible = {(False, False), (True, False), (True, True), (False, True)}
    if trial is full:
        possible.remove((True, False))  # the first move of the journal takes no space
    assert states == possible or not LONG
    assert (True, True) in states


def full(calls, work):
    """Whether `work` is done on a disk that is full from the Nth call on that takes space."""
    child = fork()
    if child == 0:
        left = [calls]
        for name in ("open", "write", "mkdir", "symlink", "link"):
            _fill_up(name, left)
        try:
            work()
        except PqsecError:
            os._exit(3)
        except BaseException:  # noqa: BLE001 -- the parent wants to know of any
            os._exit(1)
        os._exit(0)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert code in {0, 3}
    return code == 0


def _fill_up(name, left):
    real = getattr(os, name)

    def refusing(*arguments, **options):
        takes = name != "open" or arguments[1] & os.O_CREAT
        left[0] -= bool(takes)
        if takes and left[0] <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(*arguments, **options)

    setattr(os, name, refusing)


def test_adopt_does_not_take_a_change_of_a_keystore_for_its_own(place):
    root = half_done(place / "k")
    with pytest.raises(ExistsError, match="is a pqsec keystore already"):
        adopt(root, now=NOW)
    assert Keystore.open(root).names() == ["/a"]


def test_ca_init_names_what_ends_a_keystore_that_a_killed_one_began(place):
    root = half_done(place / "k", create)
    (root / "public").mkdir()  # the first that is moved
    assert check((root,), now=NOW).inventory.interrupted_change
    with pytest.raises(ExistsError) as refused:
        create(root)
    assert f"`pqsec -k {root} ca recover`" in refused.value.hint
    Keystore.recover(root)
    assert Keystore.open(root).names() == []
