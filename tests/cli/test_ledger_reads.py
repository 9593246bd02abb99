"""How often a command reads the ledger: once, and again only if it may have changed."""

import time

import pytest

from pqsec_pki.keystore import _copies, _ledger_file

DOMAIN = """\
profile: classical
participants:
  - {name: /talker, publish: [rt/chatter]}
  - {name: /third, publish: [rt/chatter]}
"""
CHANGES = (
    "renew /talker",
    "renew --all --validity 30d",
    "revoke /talker --yes",
    "permit /talker --publish rt/x --yes",
    "permit /talker --publish rt/x --yes; permit /talker --remove --publish rt/x --yes",
    "issue /third --publish rt/x",
    "ca crl",
)
OTHERS = (
    "renew /talker; revoke /talker --superseded --yes",
    "apply domain.yaml --yes",
    "status",
    "log",
    "check",
)


@pytest.fixture
def reads(monkeypatch):
    found, load = [], _ledger_file.load
    monkeypatch.setattr(_ledger_file, "load", lambda private: found.append(1) or load(private))
    return found


@pytest.fixture
def at(pqsec, keystore, tmp_path, reads, monkeypatch):
    """Runs commands, and returns how often the last one read the ledger, as a new process."""
    keystore("classical")
    (tmp_path / "domain.yaml").write_text(DOMAIN)

    def run(commands):
        for command in commands.split("; "):
            monkeypatch.setattr(_copies, "_copies", _copies._Copies())
            reads.clear()
            pqsec(f"-k k {command}").done()
        return len(reads)

    return run


@pytest.mark.parametrize("commands", [*CHANGES, *OTHERS])
def test_a_command_reads_the_ledger_once(at, commands, monkeypatch):
    now = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: now() + 10_000_000_000)  # long after all changes
    assert at(commands) == 1


@pytest.mark.parametrize("commands", CHANGES)
def test_a_change_reads_the_ledger_again_only_under_the_lock(at, commands, monkeypatch):
    """The times of its file may not show that another command changed it before the lock."""
    monkeypatch.setattr(_copies.CopyKey, "shows_changes_after", lambda *_: False)
    assert at(commands) <= 2
