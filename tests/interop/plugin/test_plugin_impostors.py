"""What the library makes of something else that listens where its agent should."""

import os
import shlex
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from pqsec_pki.plugin import LIBRARY, NAMES, agent_status, stop_agent
from pqsec_pki.plugin.building import command, compiler
from tests.interop.cyclone import Participant, RefusedError, participant

pytestmark = pytest.mark.interop

PATIENCE_MS = 3000


def _answer(octets):
    def behave(guest):
        guest.sendall(octets)
        _silence(guest)

    return behave


def _silence(guest):
    while guest.recv(1 << 16):  # until the other side has had enough
        pass


def _framed(body):
    return len(body).to_bytes(4, "little") + body


WELCOME = _framed(b"\0")
REASON = b"\1" + _framed(b"another version")
BEHAVIOURS = {
    "hangs up": (lambda guest: None, "the agent is gone"),
    "says nothing": (_silence, f"does not answer within {PATIENCE_MS} ms"),
    "says half": (_answer(WELCOME[:3]), f"does not answer within {PATIENCE_MS} ms"),
    "says no": (_answer(_framed(REASON)), "another version"),
    "says nothing understood": (_answer(_framed(b"\1\xff\xff\xff\xff")), "is malformed"),
    "says too much": (_answer(b"\xff" * 9), "the agent is gone"),
    "says yes and then less": (_answer(WELCOME + _framed(b"\0\0\0")), "is malformed"),
    "says yes and then more": (_answer(WELCOME + _framed(bytes(900))), "is malformed"),
    "gives a result there is not": (_answer(WELCOME + _framed(b"\0\6" + bytes(35))), "malformed"),
}


@contextmanager
def listening(shim, behave):
    """A process listens there and does this with each connection."""
    stop_agent(shim.place)
    shim.place.prepare()
    shim.place.socket.unlink(missing_ok=True)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(shim.place.socket))
        listener.listen()
        listener.settimeout(5)
        over = threading.Event()

        def serve():
            while not over.is_set():
                with suppress(OSError):
                    guest, _ = listener.accept()
                    with guest, suppress(OSError):
                        guest.settimeout(5)
                        behave(guest)

        server = threading.Thread(target=serve)
        server.start()
        try:
            yield
        finally:
            over.set()
            with socket.socket(socket.AF_UNIX) as last:
                last.connect(str(shim.place.socket))
            server.join()
            shim.place.socket.unlink()


@pytest.mark.slow(but=2)
@pytest.mark.parametrize("how", BEHAVIOURS)
def test_an_agent_that_is_none_is_refused_with_the_reason(shim, labs, monkeypatch, how):
    monkeypatch.setenv("PQSEC_AGENT_TIMEOUT", str(PATIENCE_MS))
    behave, words = BEHAVIOURS[how]
    with (
        listening(shim, behave),
        pytest.raises(RefusedError, match=words),
        participant(shim.folder, labs("pq").alice),
    ):
        pass


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be somebody else")
def test_an_agent_of_another_user_is_refused(shim, labs):
    """It hears nothing, least of all a password."""
    stop_agent(shim.place)
    shim.place.prepare()
    with socket.socket(socket.AF_UNIX) as listener:
        shim.place.socket.unlink(missing_ok=True)
        listener.bind(str(shim.place.socket))
        other = os.fork()
        if other == 0:  # who listens is who called listen()
            os.setuid(65534)
            listener.listen()
            guest, _ = listener.accept()
            os._exit(len(guest.recv(1 << 16)) > 0)
        with (
            pytest.raises(RefusedError, match="is another user's"),
            participant(shim.folder, labs("pq").alice),
        ):
            pass
        assert os.waitpid(other, 0)[1] == 0
    shim.place.socket.unlink()


@pytest.mark.parametrize("mode", [0o755, 0o770])
def test_a_folder_that_others_can_enter_is_refused(shim, labs, mode):
    shim.place.prepare()
    before = shim.place.folder.stat().st_mode & 0o777
    shim.place.folder.chmod(mode)
    try:
        with (
            pytest.raises(RefusedError, match="is not a folder of this user's alone"),
            participant(shim.folder, labs("pq").alice),
        ):
            pass
    finally:
        shim.place.folder.chmod(before)


def test_a_host_that_ignores_signals_starts_an_agent_that_does_not(shim, labs):
    stop_agent(shim.place)
    before = signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        with participant(shim.folder, labs("pq").alice):
            process = shim.wait_for_agent()
    finally:
        signal.signal(signal.SIGTERM, before)
    os.kill(process, signal.SIGTERM)
    end = time.monotonic() + 60
    while agent_status(shim.place) and time.monotonic() < end:
        time.sleep(0.01)
    assert agent_status(shim.place) is None


@pytest.mark.slow
def test_a_starter_that_does_not_end_is_waited_for_as_long_as_any_call(
    shim, labs, tmp_path, monkeypatch
):
    """An agent listens, but who started it stays: the participant is made all the same."""
    starter, stays = tmp_path / "python", tmp_path / "process"
    python = shlex.quote(sys.executable)
    starter.write_text(f'#!/bin/sh\n{python} "$@"\necho $$ > {stays}\nexec sleep 3600\n')
    starter.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(starter))
    subprocess.run(command(compiler(), tmp_path / LIBRARY), check=True)
    for name in NAMES:
        (tmp_path / name).symlink_to(LIBRARY)
    stop_agent(shim.place)
    monkeypatch.setenv("PQSEC_AGENT_TIMEOUT", "3000")
    with participant(tmp_path, labs("pq").alice):
        process = int(stays.read_text())
        assert "sleep" in Path(f"/proc/{process}/comm").read_text()
        os.kill(process, signal.SIGKILL)


def test_a_participant_beside_one_whose_agent_was_lost_has_a_new_one(shim, labs):
    """It is made at once, though nobody noticed the loss."""
    lab = labs("pq")
    with participant(shim.folder, lab.alice) as first:
        first.join(0)
        shim.kill_agent()
        second = Participant(first._authentication, first._access, lab.bob, "")
        assert all(second.join(0))
