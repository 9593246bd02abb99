"""Reading and writing files: whole or not at all, private when they must be."""

import os
import resource
import stat
import subprocess

import pytest

from pqsec_pki._files import MAX_FILE, create, disk_errors, read, write
from pqsec_pki.errors import ExistsError, FileError, PqsecError, VerificationError, located


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


def test_what_is_written_is_read(tmp_path):
    path = tmp_path / "file"
    write(path, b"data\0\xff")
    assert read(path) == b"data\0\xff"
    assert names(tmp_path) == ["file"]


def test_an_empty_file_is_written_and_read(tmp_path):
    write(tmp_path / "file", b"")
    assert read(tmp_path / "file") == b""


@pytest.mark.usefixtures("umask")
def test_modes_do_not_depend_on_the_umask(tmp_path):
    write(tmp_path / "key", b"key", private=True)
    write(tmp_path / "cert", b"cert")
    create(tmp_path / "other", b"", mode=0o640)
    assert [mode(tmp_path / name) for name in ("key", "cert", "other")] == [0o600, 0o644, 0o640]


@pytest.mark.usefixtures("umask")
@pytest.mark.parametrize("private", [True, False])
def test_a_forced_write_sets_the_mode_anew(tmp_path, private):
    path = tmp_path / "file"
    path.write_bytes(b"old")
    path.chmod(0o666)
    write(path, b"new", private=private, force=True)
    assert (read(path), mode(path)) == (b"new", 0o600 if private else 0o644)


def test_nothing_is_overwritten_unless_forced(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"old")
    with pytest.raises(ExistsError, match="file exists") as caught:
        write(path, b"new")
    assert "--force" in caught.value.hint
    assert read(path) == b"old"
    assert names(tmp_path) == ["file"]


def test_a_link_that_leads_nowhere_is_something_too(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ExistsError):
        write(tmp_path / "link", b"new")
    assert not (tmp_path / "elsewhere").exists()


def test_a_link_is_replaced_and_not_followed(tmp_path):
    victim = tmp_path / "victim"
    victim.write_bytes(b"precious")
    (tmp_path / "link").symlink_to(victim)
    write(tmp_path / "link", b"new", force=True)
    assert victim.read_bytes() == b"precious"
    assert not (tmp_path / "link").is_symlink()


def test_create_does_not_follow_a_link(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "victim")
    with pytest.raises(FileExistsError):
        create(tmp_path / "link", b"key", mode=0o600)
    assert not (tmp_path / "victim").exists()


@pytest.mark.parametrize("force", [True, False])
def test_a_folder_in_the_way_is_refused(tmp_path, force):
    (tmp_path / "folder").mkdir()
    with pytest.raises(FileError):
        write(tmp_path / "folder", b"new", force=force)
    assert names(tmp_path) == ["folder"]


@pytest.mark.parametrize("place", ["missing/file", "file/below", "x" * 300])
def test_a_place_where_no_file_can_be_is_refused(tmp_path, place):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(FileError, match=tmp_path.name):
        write(tmp_path / place, b"")
    with pytest.raises(FileError, match=tmp_path.name):
        read(tmp_path / place)
    assert names(tmp_path) == ["file"]


def test_a_folder_is_not_read(tmp_path):
    with pytest.raises(FileError, match="is a directory"):
        read(tmp_path)


def test_a_file_over_the_limit_is_not_read(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(bytes(101))
    assert len(read(path, limit=101)) == 101
    with pytest.raises(FileError, match="larger than 100 bytes"):
        read(path, limit=100)
    with path.open("wb") as file:
        file.truncate(MAX_FILE + 1)
    with pytest.raises(FileError, match="larger than"):
        read(path)


def test_a_full_disk_leaves_no_half_file_behind(tmp_path):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        with pytest.raises(FileError, match="file too large"):
            write(tmp_path / "key", bytes(5000), private=True)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert names(tmp_path) == []


@pytest.mark.parametrize("force", [True, False])
def test_a_path_that_no_system_takes_is_refused(tmp_path, force):
    with pytest.raises(FileError):
        read(tmp_path / "a\0b")
    with pytest.raises(FileError):
        write(tmp_path / "a\0b", b"", force=force)


def test_an_error_says_where_once():
    with pytest.raises(VerificationError) as caught, located("outer"), located("inner"):
        raise VerificationError("one", "two")
    assert str(caught.value) == "inner: one; two"
    assert [each.message for each in caught.value.problems] == ["one", "two"]


def test_who_names_the_place_tells_the_words_without_it(tmp_path):
    path = tmp_path / "file"
    write(path, b"12345")
    with pytest.raises(FileError, match="larger than 4") as caught, located(path):
        read(path, limit=4)
    error = caught.value
    assert str(error) == f"{path}: {error.words}"
    assert (error.words_at(path), error.words_at(tmp_path)) == (error.words, str(error))


def test_only_our_errors_are_given_a_place():
    with pytest.raises(RuntimeError) as caught, located("here"):
        raise RuntimeError("bug")
    assert not isinstance(caught.value, PqsecError)
    assert str(caught.value) == "bug"


@pytest.mark.parametrize(
    ("refused", "where"),
    [
        (lambda at: (at / "gone").iterdir().__next__(), "/gone: no such file or directory"),
        (lambda _: os.close(1 << 20), "/place: bad file descriptor"),
        (lambda at: at.mkdir(), ": file exists"),
    ],
    ids=["a file", "no name", "something there"],
)
def test_what_the_system_refuses_is_told_of_its_file_or_of_the_place(tmp_path, refused, where):
    with pytest.raises(FileError) as caught, located("elsewhere"), disk_errors(tmp_path / "place"):
        refused(tmp_path)
    assert str(caught.value).endswith(where)
    assert str(caught.value).startswith(str(tmp_path))
    assert isinstance(caught.value, ExistsError) is isinstance(
        caught.value.__cause__, FileExistsError
    )


# Pipes


def test_a_pipe_that_nobody_writes_into_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("pqsec_pki._files.PIPE_PATIENCE", 0.01)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(FileError, match="pipe: a pipe without a writer"):
        read(tmp_path / "pipe")


@pytest.mark.parametrize("data", [b"", b"a", b"a longer text" * 100_000])
@pytest.mark.parametrize("patience", [0.05, 5.0], ids=["slow writer", "patient reader"])
def test_a_pipe_is_read_to_its_end(tmp_path, monkeypatch, data, patience):
    """A writer that is there may take longer than one that does not come."""
    monkeypatch.setattr("pqsec_pki._files.PIPE_PATIENCE", patience)
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "data").write_bytes(data)
    line = f"exec > {tmp_path}/pipe; sleep 0.1; cat {tmp_path}/data"
    with subprocess.Popen(["sh", "-c", line]):
        keeper = os.open(tmp_path / "pipe", os.O_RDONLY)  # returns when the shell has opened it
        found = read(tmp_path / "pipe")
        os.close(keeper)
    assert found == data
