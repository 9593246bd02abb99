"""Who may not read something is told so, with exit 3, and never gets an answer without it."""

import os
import pickle
import pkgutil
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

import pqsec_pki
from tests.cli.conftest import Result

NOBODY = 65534
ROOT = os.geteuid() == 0
LATE = ("jinja2", "lxml.etree", "sqlite3", "yaml")
"""What commands import when they need it."""
NOTHING = ("none yet", "0 participants", "no change", "valid", "ok  ", "gone", "previous-ca")
"""What an answer without those that cannot be read would say."""

DOMAIN = """\
validity: 90d
roles:
  talker: {publish: [rt/chatter]}
participants:
  - {name: /talker, role: talker}
"""


@pytest.fixture
def shared() -> Iterator[Path]:
    """A folder that everybody can reach: pytest's own is its user's alone."""
    with tempfile.TemporaryDirectory(prefix="pqsec-test-") as folder:
        Path(folder).chmod(0o755)
        yield Path(folder)


@pytest.fixture
def closed(domains, shared):
    """closed("enclaves/talker") is the keystore `k`, where that is its owner's alone."""

    def make(*places: str, mode: int = 0o700) -> Path:
        for name in ("k", "old"):
            shutil.copytree(domains("classical"), shared / name, symlinks=True)
        shutil.copy(shared / "k/enclaves/governance.xml", shared / "g.xml")
        (shared / "domain.yaml").write_text(DOMAIN)
        _open(shared)
        for place in places:
            # Who is not root has nobody else to be, but can close a folder to itself.
            (shared / "k" / place).chmod(mode if ROOT else 0o000)
        return shared / "k"

    yield make
    _open(shared)


def _open(root: Path) -> None:
    """All folders for everybody, from the top."""
    root.chmod(0o755)
    for each in root.iterdir():
        if each.is_dir() and not each.is_symlink():
            _open(each)


@pytest.fixture
def as_nobody(run_in, shared):
    """as_nobody("-k k ca show") runs the command as another user."""
    modules = pkgutil.walk_packages(pqsec_pki.__path__, "pqsec_pki.")
    names = (each.name for each in modules if not each.name.startswith("pqsec_pki.ros."))
    for module in map(import_module, (*LATE, *names)):
        for name in getattr(module, "__all__", ()):  # what rooms load on demand
            getattr(module, name, None)  # the other user may not be let in to where we lie

    def run(line: str) -> Result:
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            try:
                os.chdir("/")  # likewise
                sys.prefix = "/usr"  # likewise
                if ROOT:
                    os.setgroups([])
                    os.setresgid(NOBODY, NOBODY, NOBODY)
                    os.setresuid(NOBODY, NOBODY, NOBODY)
                os.write(writing, pickle.dumps(run_in(shared, line)))
            finally:
                os._exit(0)
        os.close(writing)
        with os.fdopen(reading, "rb") as answer:
            told = answer.read()
        os.waitpid(child, 0)
        assert told, "the child did not answer"
        return pickle.loads(told)  # noqa: S301 -- our own child's

    return run


QUESTIONS = {
    "-k k ca show": "enclaves/talker",
    "-k k --json ca show": "enclaves/talker",
    "-k k who-may": "enclaves/talker",
    "-k k who-may --format json": "enclaves/talker",
    "who-may k/enclaves": "enclaves/talker",
    "who-may k": "enclaves/talker",
    "diff old k": "enclaves/talker",
    "diff k old": "enclaves/talker",
    "-k k explain --participant /talker --publish rt/chatter": "enclaves/talker",
    "-k k verify-handshake --all": "enclaves",
    "-k k verify-handshake /talker /listener": "enclaves/talker",
    "-k k verify-handshake /listener /talker": "enclaves",
    "-k k bundle /talker --plain-key -o b": "private",  # its number is in the ledger
    "-k k export cyclonedds /talker": "enclaves/talker",
    "inspect k/enclaves/talker/cert.pem": "enclaves/talker",
    "-k k verify k/enclaves/talker/permissions.p7s": "enclaves/talker",
    "validate k/enclaves/talker/permissions.p7s": "enclaves/talker",
    "-k k try cyclonedds /talker /listener": "enclaves",
    "-k k status": "private",
    "-k k log": "private",
    "-k k log --verify": "private",
    "-k k needs-renewal": "private",
    "-k k plan domain.yaml": "private",
    "-k k sign-governance g.xml": "k: it belongs to another user (root)" if ROOT else "private",
}


def wrong(said: Result, place: str) -> str:
    """What is wrong with an answer that should say that it cannot read what is in `place`."""
    told = [word for word in NOTHING if word in said.out]
    if said.code != 3 or told or place not in said.err or "--force" in said.err:
        return f"exit {said.code}, {said.out!r}, {said.err!r}"
    return ""


def test_another_user_is_told_what_cannot_be_read(closed, as_nobody):
    found = {}
    closed("enclaves/talker", "private")
    for line, place in QUESTIONS.items():
        print(line, as_nobody(line).err)
        if fault := wrong(as_nobody(line), place):
            found[line] = fault
    assert not found, found


@pytest.mark.parametrize(
    "line",
    [
        "who-may",
        "verify-handshake --all",
        "ca show",
        "log --verify",
        "check k",
        "who-may k/enclaves",
    ],
)
def test_a_participant_whose_folder_is_a_link_is_not_left_out_in_silence(
    pqsec, domains, tmp_path, line
):
    """A stack and `explain` find it by its path; who lists all did not follow the link."""
    shutil.copytree(domains("classical"), tmp_path / "k", symlinks=True)
    folder = tmp_path / "k/enclaves/talker"
    folder.rename(tmp_path / "talker")
    folder.symlink_to("../../talker")
    said = pqsec(f"-k k {line}")
    assert said.code == 3
    assert "k/enclaves/talker" in said.out + said.err
    assert "a link to a folder" in said.out + said.err


def test_all_enclaves_that_are_closed_are_no_empty_keystore(closed, as_nobody):
    closed("enclaves")
    lines = [line for line, place in QUESTIONS.items() if place.startswith("enclaves")]
    found = {line: fault for line in lines if (fault := wrong(as_nobody(line), "enclaves"))}
    assert not found


def test_a_keystore_that_is_closed_is_not_taken_for_a_folder_without_documents(closed, as_nobody):
    closed("")
    lines = [line for line in QUESTIONS if "k/" not in line]
    found = {line: fault for line in lines if (fault := wrong(as_nobody(line), "k"))}
    assert not found, found


@pytest.mark.skipif(not ROOT, reason="only root can be kept out by another user")
def test_the_closed_folder_and_its_owner_are_named(closed, as_nobody):
    closed("private", "enclaves/talker")
    for line, place, folder in (
        ("-k k status", "k/private", "k/private"),
        ("inspect k/enclaves/talker/cert.pem", "k/enclaves/talker/cert.pem", "k/enclaves/talker"),
    ):
        said = as_nobody(line)
        assert said.errors == [f"{place}: permission denied"]
        assert f"hint: {folder} belongs to another user (root): run pqsec as root" in said.err


@pytest.mark.skipif(not ROOT, reason="only root can be kept out by another user")
def test_a_keystore_of_another_user_is_named_with_its_owner(closed, as_nobody):
    closed().chmod(0o700)
    for line in ("status", "ca show", "issue /a --publish x", "ca recover"):
        said = as_nobody(f"-k k {line}")
        said.refused(3, "k: permission denied", hint="k belongs to another user (root)")


def test_the_revocation_list_that_cannot_be_read_is_not_told_to_be_missing(closed, as_nobody):
    closed("public")
    for line in ("-k k ca crl --show", "-k k ca show", "-k k who-may"):
        assert not wrong(as_nobody(line), "public"), line


@pytest.mark.skipif(not ROOT, reason="only root can give a folder away")
def test_nobody_is_gone_whose_folder_cannot_be_looked_into(closed, as_nobody):
    root = closed("enclaves/talker")
    for each in (root, root / "private", *(root / "private").iterdir()):
        os.chown(each, NOBODY, NOBODY)
    for line in ("-k k status", "-k k needs-renewal", "-k k log --verify"):
        assert not wrong(as_nobody(line), "enclaves/talker"), line


@pytest.mark.parametrize("line", ["-k k who-may", "who-may k/enclaves"])
def test_a_participant_whose_permissions_cannot_be_read_is_not_left_out(closed, as_nobody, line):
    """They may grant any right."""
    closed("enclaves/talker/permissions.p7s", mode=0o600)
    assert not wrong(as_nobody(line), "permissions.p7s")


def test_what_is_on_a_machine_is_listed_without_folders_of_others(
    closed, as_nobody, shared, monkeypatch
):
    """A folder on the search path, or beside a keystore, that is its owner's alone: a traceback."""
    closed()
    (shared / "closed").mkdir(0o700 if ROOT else 0o000)
    for variable, folder in (("PATH", "closed"), ("HOME", "k")):
        monkeypatch.setenv(variable, str(shared / folder))
    said = as_nobody("uninstall --list")
    assert said.code == 3
    assert f"pqsec: note: not in the list: {shared}/closed/pqsec.json: permission" in said.err
    assert "pqsec: error: the list is incomplete: a folder cannot be read" in said.err
    assert re.search(f"^keystore +{shared}/k ", said.out, re.MULTILINE)
    as_nobody("uninstall --list closed").refused(3, "closed: permission denied")
    as_nobody("-k closed/k uninstall --list").refused(3, "closed/k: permission denied")


@pytest.mark.skipif(not ROOT, reason="only root can be kept out by another user")
def test_a_home_that_is_closed_is_named(closed, as_nobody, shared, monkeypatch):
    closed()
    (shared / "home").mkdir(0o700)
    monkeypatch.setenv("HOME", str(shared / "home"))
    for line in ("uninstall --list k", "plugin uninstall --yes", "plugin install --systemd"):
        as_nobody(line).refused(3, "home/", "permission denied")


def test_a_report_says_what_it_lacks(closed, as_nobody, run_in, shared):
    whole = closed()
    assert run_in(shared, "-k k report").code == 0  # the other user may not read the templates
    shutil.rmtree(whole)
    shutil.rmtree(shared / "old")
    closed("enclaves/talker", "private")
    said = as_nobody("-k k report")
    assert said.code == 3
    assert "This report is incomplete" in said.out
    for word in ("enclaves/talker", "private"):
        assert word in said.out
        assert word in said.err
    assert "0 participants" not in said.out
