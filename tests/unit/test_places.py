"""Places that another user could change: by owner, mode, groups, access control list, and above."""

import ctypes
import errno
import os
import pwd
import shlex
import stat
import struct
import subprocess
import tempfile
from pathlib import Path

import pytest

from pqsec_pki import _owners
from pqsec_pki._files import read
from pqsec_pki._places import make_folders, open_place, refuse_obeyed, trusted_files
from pqsec_pki.errors import FileError
from pqsec_pki.plugin.agent_folder import AgentFolder
from pqsec_pki.plugin.units import write_units
from pqsec_pki.trial.building import cache, is_own

NOBODY = 65534
CLONE_NEWUSER = 0x10000000
superuser = pytest.mark.skipif(os.geteuid() != 0, reason="another user can be tried by root only")
USER_OWNER, USER, GROUP_OWNER, GROUP, MASK, OTHER = 0x01, 0x02, 0x04, 0x08, 0x10, 0x20
UNDEFINED = 0xFFFFFFFF


@pytest.fixture
def file(tmp_path):
    """A file in a folder in a folder, all of the caller."""
    made = tmp_path / "above/folder/file"
    made.parent.mkdir(parents=True)
    made.write_text("text")
    for each in (made.parent.parent, made.parent):
        each.chmod(0o755)
    return made


def other_group():
    """One that is nobody's own, if we may give files to it; else one of ours."""
    return NOBODY if os.geteuid() == 0 else os.getgroups()[0]


def give_access(path, *entries):
    """Set the access control list, as setfacl(1) does."""
    given = ((USER_OWNER, 7, UNDEFINED), *entries, (OTHER, 5, UNDEFINED))
    data = struct.pack("<I", 2) + b"".join(struct.pack("<HHI", *each) for each in given)
    try:
        os.setxattr(path, "system.posix_acl_access", data)
    except OSError as error:
        if error.errno == errno.ENOTSUP:
            pytest.skip("this file system has no access control lists")
        raise


FLAWS = {
    "mode": lambda path: path.chmod(path.stat().st_mode | 0o002),
    "group": lambda path: (os.chown(path, -1, other_group()), path.chmod(0o775)),
    "user of the list": lambda path: give_access(
        path, (USER, 7, NOBODY), (GROUP_OWNER, 5, UNDEFINED), (MASK, 7, UNDEFINED)
    ),
    "group of the list": lambda path: give_access(
        path, (GROUP_OWNER, 5, UNDEFINED), (GROUP, 6, NOBODY), (MASK, 7, UNDEFINED)
    ),
}
if os.geteuid() == 0:
    FLAWS["owner"] = lambda path: os.chown(path, NOBODY, -1)


@pytest.mark.parametrize("flaw", FLAWS)
@pytest.mark.parametrize("place", ["above", "above/folder", "above/folder/file"])
def test_a_place_that_others_can_change_is_found_wherever_it_is_on_the_way(
    tmp_path, file, place, flaw
):
    assert open_place(file) is None
    FLAWS[flaw](tmp_path / place)
    found = open_place(file)
    assert found.path == str(tmp_path / place)
    if "owner" not in flaw:
        assert found.remedy == f"chmod go-w {tmp_path / place}"
        subprocess.run(shlex.split(found.remedy), check=True)
        assert open_place(file) is None


@pytest.mark.parametrize("flaw", FLAWS)
def test_a_sticky_folder_protects_what_is_in_it_and_not_itself(file, flaw):
    FLAWS[flaw](file.parent)
    file.parent.chmod(file.parent.stat().st_mode | stat.S_ISVTX)
    assert (open_place(file) is None) == (flaw != "owner")
    assert open_place(file.parent)


@pytest.mark.parametrize("mask", [0, 5])
def test_what_the_mask_of_a_list_takes_away_nobody_has(file, mask):
    give_access(file, (USER, 7, NOBODY), (GROUP_OWNER, 7, UNDEFINED), (MASK, mask, UNDEFINED))
    assert open_place(file) is None


def test_the_group_of_the_file_can_write_by_the_list_alone(file):
    os.chown(file, -1, other_group())
    give_access(file, (USER, 4, NOBODY), (GROUP_OWNER, 6, UNDEFINED), (MASK, 7, UNDEFINED))
    assert open_place(file).who.startswith("group ")


def test_the_mask_is_not_taken_for_the_group(file):
    """The bits of the group are the mask: with a list they say nothing about the group."""
    os.chown(file, -1, other_group())
    give_access(
        file,
        (USER, 7, os.geteuid()),
        (USER, 7, 0),
        (GROUP_OWNER, 4, UNDEFINED),
        (MASK, 7, UNDEFINED),
    )
    assert file.stat().st_mode & stat.S_IWGRP
    assert open_place(file) is None


def test_a_link_in_the_middle_is_followed_to_the_open_folder(tmp_path, file):
    """Only the folders of the name and of the end were looked at."""
    (tmp_path / "shared").mkdir()
    (tmp_path / "shared/second").symlink_to(file.parent)
    (tmp_path / "first").symlink_to("shared/second")
    place = tmp_path / "first/file"
    assert open_place(place) is None
    (tmp_path / "shared").chmod(0o777)
    assert open_place(place).path == str(tmp_path / "shared")


def test_two_dots_after_a_link_lead_where_the_kernel_goes(tmp_path, file):
    (tmp_path / "link").symlink_to(file.parent)
    file.parent.parent.chmod(0o777)
    assert open_place(tmp_path / "link/../folder/file").path == str(file.parent.parent)


@superuser
def test_a_link_of_another_user_is_found(tmp_path, file):
    (tmp_path / "link").symlink_to(file)
    os.chown(tmp_path / "link", NOBODY, NOBODY, follow_symlinks=False)
    assert open_place(tmp_path / "link").path == str(tmp_path / "link")


def test_links_without_end_are_left_to_who_reads_them(tmp_path):
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    assert open_place(tmp_path / "a") is None


def test_what_is_not_there_is_made_in_folders_that_were_looked_at(file):
    assert open_place(file.parent / "new/er") is None
    file.parent.parent.chmod(0o777)
    assert open_place(file.parent / "new/er").path == str(file.parent.parent)


def test_a_working_folder_that_was_removed_has_nothing(tmp_path):
    child = os.fork()
    if child == 0:
        try:
            os.chdir(tmp_path / ".")
            (tmp_path / "gone").mkdir()
            os.chdir(tmp_path / "gone")
            (tmp_path / "gone").rmdir()
            os._exit(open_place(Path("x")) is not None)
        finally:
            os._exit(9)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


@superuser
def test_of_roots_is_what_is_above_and_what_pqsec_obeys():
    """A user has no folder of its own without folders of root above it."""
    with tempfile.TemporaryDirectory(dir="/tmp") as name:
        folder = Path(name)
        folder.chmod(0o755)
        (folder / "own").mkdir()
        (folder / "file").write_text("")
        os.chown(folder / "own", NOBODY, NOBODY)
        assert as_user(NOBODY, lambda: open_place(folder / "own")) == "None"
        assert as_user(NOBODY, lambda: open_place(folder / "file", roots=True)) == "None"
        assert "another user (root)" in as_user(NOBODY, lambda: open_place(folder / "file").who)
        assert as_user(NOBODY, lambda: open_place(folder / "file", owner=0)) == "None"


def as_user(number, question, *, namespace=False):
    """The answer in a process of that user; in a user namespace it is root there."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.setgroups([])
            os.setgid(number)
            os.setuid(number)
            if namespace:
                become_root(number)
            _owners._unknown_user.cache_clear()
            os.write(writer, str(question()).encode())
        except BaseException as error:  # noqa: BLE001 -- told to the parent
            os.write(writer, repr(error).encode())
        finally:
            os._exit(0)
    os.close(writer)
    os.waitpid(child, 0)
    with os.fdopen(reader) as told:
        return told.read()


def become_root(number):
    """As `unshare --map-root-user`: nobody else has a number in this namespace."""
    libc = ctypes.CDLL(None, use_errno=True)
    ctypes.CDLL(None).prctl(4, 1, 0, 0, 0)  # PR_SET_DUMPABLE: else /proc/self is root's
    if libc.unshare(CLONE_NEWUSER):
        raise OSError(ctypes.get_errno(), "no user namespaces here")
    Path("/proc/self/setgroups").write_text("deny")
    Path("/proc/self/uid_map").write_text(f"0 {number} 1")
    Path("/proc/self/gid_map").write_text(f"0 {number} 1")


@superuser
def test_in_a_user_namespace_the_folders_of_the_hosts_root_are_above(tmp_path):
    """There they belong to the number of all unknown users, and nobody inside can be one."""
    with tempfile.TemporaryDirectory(dir="/tmp") as name:
        folder = Path(name)
        folder.chmod(0o755)
        (folder / "k").mkdir()
        (folder / "m").mkdir()
        os.chown(folder / "k", 12345, 12345)
        found = as_user(12345, lambda: open_place(folder / "k"), namespace=True)
        if "no user namespaces" in found:
            pytest.skip("this machine has no user namespaces")
        assert found == "None"
        assert "another user" in as_user(
            12345, lambda: open_place(folder / "m").who, namespace=True
        ), "only what is above may be the host's"
    assert _owners._unknown_user() == 0


def members_of(monkeypatch, users, groups):
    """The directory of users and groups: names to (user, group), and to (group, members)."""
    monkeypatch.setattr(
        "pwd.getpwall",
        lambda: [pwd.struct_passwd((n, "x", u, g, "", "/", "/sh")) for n, (u, g) in users.items()],
    )
    monkeypatch.setattr(
        "grp.getgrall",
        lambda: [_owners.grp.struct_group((n, "x", g, m)) for n, (g, m) in groups.items()],
    )
    _owners._is_private.cache_clear()


@superuser
@pytest.mark.parametrize(
    ("users", "groups", "private"),
    [
        ({"root": (0, 0)}, {"root": (0, [])}, True),
        ({"root": (0, 0)}, {"root": (0, ["root"])}, True),
        ({"root": (0, 0), "toor": (0, 0)}, {"root": (0, ["toor"])}, True),
        ({"root": (0, 0), "eve": (1001, 0)}, {"root": (0, [])}, False),  # her primary group
        ({"root": (0, 0)}, {"root": (0, ["eve"])}, False),
        ({"root": (0, 0)}, {"root": (0, []), "again": (0, ["eve"])}, False),  # another name of it
        ({"eve": (1001, 1001)}, {"root": (0, [])}, False),  # a directory that does not list us
        ({}, {"root": (0, [])}, False),
    ],
)
def test_a_private_group_has_no_other_member(file, monkeypatch, users, groups, private):
    """A user whose primary group it is is not among the members that the group names."""
    members_of(monkeypatch, users, groups)
    file.chmod(0o664)
    try:
        assert (open_place(file) is None) == private
    finally:
        _owners._is_private.cache_clear()


def test_a_pipe_that_the_caller_hands_over_is_taken(file):
    """As by a shell: --passphrase-file <(command)."""
    reader, writer = os.pipe()
    try:
        refuse_obeyed([Path(f"/dev/fd/{reader}"), Path("/dev/null")], "it")
        handle = os.open(file, os.O_RDONLY)
        refuse_obeyed([Path(f"/dev/fd/{handle}")], "it")
        file.parent.chmod(0o777)
        with pytest.raises(FileError):
            refuse_obeyed([Path(f"/dev/fd/{handle}")], "it")
        os.close(handle)
    finally:
        os.close(reader)
        os.close(writer)


def test_a_named_pipe_in_an_open_folder_is_refused(tmp_path):
    (tmp_path / "shared").mkdir()
    os.mkfifo(tmp_path / "shared/pipe")
    (tmp_path / "shared").chmod(0o777)
    with pytest.raises(FileError, match="anybody may write there; anyone"):
        refuse_obeyed([tmp_path / "shared/pipe"], "the passphrase")


def test_many_files_of_a_folder_cost_one_walk(file, monkeypatch):
    """Ten thousand participants have as many requests."""
    files = [file.with_name(str(number)) for number in range(200)]
    for each in files:
        each.write_text("")
    calls = []
    lstat = os.lstat
    monkeypatch.setattr(os, "lstat", lambda *a, **k: calls.append(a) or lstat(*a, **k))
    monkeypatch.setattr(Path, "lstat", lambda path: os.lstat(path))  # noqa: PLW0108 -- the new one
    refuse_obeyed(files, "it")
    assert len(files) < len(calls) <= 2 * len(files) + len(file.parents) + 2
    files[150].chmod(0o666)
    with pytest.raises(FileError, match="150: anybody"):
        refuse_obeyed(files, "it")


def test_a_link_among_many_files_is_followed(tmp_path, file):
    (tmp_path / "open").mkdir()
    (tmp_path / "open/target").write_text("")
    file.with_name("link").symlink_to(tmp_path / "open/target")
    (tmp_path / "open").chmod(0o777)
    with pytest.raises(FileError, match=str(tmp_path / "open")):
        refuse_obeyed([file, file.with_name("link")], "it")


def test_what_is_read_is_what_is_looked_at(file):
    file.chmod(0o666)
    with pytest.raises(FileError, match="file: anybody may write there"), trusted_files("it"):
        read(file)
    with trusted_files("it"):
        file.read_text()


@pytest.mark.parametrize("umask", [0, 0o077])
def test_folders_are_made_for_the_caller_whatever_the_umask(tmp_path, umask):
    before = os.umask(umask)
    try:
        make_folders(tmp_path / "a/b/c", 0o755)
    finally:
        os.umask(before)
    assert [oct((tmp_path / each).stat().st_mode & 0o777) for each in ("a", "a/b/c")] == [
        "0o755"
    ] * 2
    assert open_place(tmp_path / "a/b/c") is None


def test_an_agent_below_a_folder_that_others_can_change_is_refused(tmp_path):
    """They could put a folder with a socket of theirs in its place."""
    (tmp_path / "run").mkdir()
    agent = AgentFolder(tmp_path / "run/pqsec/agent.sock")
    agent.prepare()
    (tmp_path / "run").chmod(0o777)
    with pytest.raises(FileError, match="run: anybody may write there"):
        agent.prepare()


@pytest.mark.parametrize("folder", ["", "pqsec", "pqsec/peers"])
def test_programs_are_not_run_from_a_cache_below_an_open_folder(tmp_path, monkeypatch, folder):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    program = cache() / "program"
    program.touch(0o700)
    assert is_own(program)
    (tmp_path / "cache" / folder).chmod(0o777)
    assert not is_own(program)
    with pytest.raises(FileError, match="others may write here"):
        cache()


def test_units_of_systemd_are_not_written_where_others_can_change_them(tmp_path):
    (tmp_path / "systemd").mkdir()
    (tmp_path / "systemd").chmod(0o777)
    with pytest.raises(FileError, match="systemd: anybody may write there; systemd runs"):
        write_units({tmp_path / "systemd/user/pqsec-agent.service": b""})
