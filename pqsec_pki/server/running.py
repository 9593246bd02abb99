"""Runs the two processes: the front, which faces the network, and the signer, with the CA keys.

The front is started first, as a new program: no key is ever in its memory. If one of the two ends,
the other ends too.
"""

import gc
import os
import pwd
import resource
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from functools import partial
from pathlib import Path

from pqsec_pki._files import FileVersion, noted
from pqsec_pki._places import refuse_obeyed
from pqsec_pki._processes import end_with
from pqsec_pki.domain import read_domain
from pqsec_pki.errors import FileError, KeystoreError
from pqsec_pki.keystore import Authorities, Keystore, SeenLedger
from pqsec_pki.server.call_handling import CallHandler
from pqsec_pki.server.configuration import ServerSettings, read_settings
from pqsec_pki.server.events import log
from pqsec_pki.server.factories import read_factories
from pqsec_pki.server.signer import SignerProcess, listening, owned, users_of
from pqsec_pki.server.state_folder import state_held

_FIRST_GIVEN = 3
"""The file descriptor of the first socket that systemd passes (sd_listen_fds(3))."""
_BACKLOG = 1024
_SIGNER = "SERVE_SIGNER_PROCESS"
"""In the front that the signer started: the signer's process, with which it ends."""
_NOT_PASSED = ("PG", "PQSEC_")
"""Variables that the front does not get: they may have the password of the ledger's database."""
_COLLECTED = 700, 10, 10
"""Python's own thresholds of its garbage collector. Commands have a greater one, because they end:
with it, closed connections stayed in memory, 50 kB each, until there were thousands."""
_END = 10
"""Seconds that the front gets to finish its answers."""

Unlock = Callable[[Keystore], Authorities]


def run_signer(settings: ServerSettings, unlock: Unlock, clock: Callable[[], datetime]) -> None:
    """Answer the front's calls until SIGTERM. Errors as of `state_held` and `_answer`."""
    with state_held(settings):
        _answer(settings, unlock, clock)


def _answer(
    settings: ServerSettings,
    unlock: Unlock,
    clock: Callable[[], datetime],
    pass_on: Callable[[], None] = lambda: None,
    front_listens: Callable[[], bool] = lambda: True,
) -> None:
    """Answer calls, with the state folder held. Errors as of `Keystore.open` and `read_domain`.

    It reports to systemd that the service is ready when the front listens too.
    """
    keystore = Keystore.open(settings.keystore, to_change=True)
    load = partial(_handler, settings, unlock(keystore), SeenLedger(), clock)

    def ready() -> bool:
        if listens := front_listens():
            notify("READY=1", os.environ)
        return listens

    users = users_of(settings.front_user)
    stay()
    listener = listening(settings.socket, settings.front_user)
    with listener:
        SignerProcess(listener, load, users, log, pass_on, ready).run()
    with suppress(OSError):
        settings.socket.unlink()


def _handler(
    settings: ServerSettings,
    authorities: Authorities,
    ledger: SeenLedger,
    clock: Callable[[], datetime],
    seen: dict[Path, FileVersion],
) -> CallHandler:
    """The handler of calls by the files as they are now, whose versions go into `seen`."""
    found = read_settings(settings.path)
    keystore = Keystore.open(settings.keystore, to_change=True)
    cas = keystore.anchors.identity_cas
    with noted(seen):
        desired, factories = read_domain(found.domain), read_factories(found.factories, cas)
        waiting = found.waiting(keystore)  # elsewhere if the ledger is moved
    refuse_obeyed((found.path, *seen), "what the server issues")
    return CallHandler(
        keystore=keystore,
        authorities=authorities,
        desired=desired,
        clock=clock,
        waiting=waiting,
        policy=found.policy,
        factories=factories,
        revocation_list=found.revocation_list,
        seen=ledger,
    )


def stay() -> None:
    """Prepare this process to run for long: it frees memory, and writes no core file.

    A core file would contain its keys.
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    gc.freeze()  # imported modules are never freed
    gc.set_threshold(*_COLLECTED)


def run_both(settings: ServerSettings, unlock: Unlock, clock: Callable[[], datetime]) -> None:
    """Run the front as a process of its own, and the signer in this one.

    FileError as of `state_held`; KeystoreError if the front ends by itself, as when it cannot
    listen.
    """
    with state_held(settings):
        _run_both(settings, unlock, clock)


def _run_both(settings: ServerSettings, unlock: Unlock, clock: Callable[[], datetime]) -> None:
    notices = _notices(settings)
    front = _started(settings)
    ended: list[int] = []

    def child_ended(*_: object) -> None:
        code = front.poll()
        if code is not None:
            ended.append(code)
            os.kill(os.getpid(), signal.SIGTERM)

    signal.signal(signal.SIGTERM, _give_up)  # until the signer can stop in order
    signal.signal(signal.SIGCHLD, child_ended)
    try:
        with notices, suppress(_GivenUpError):
            _answer(
                settings,
                unlock,
                clock,
                lambda: front.send_signal(signal.SIGHUP),
                lambda: _has_notice(notices),
            )
    finally:
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        _stop(front)
        with suppress(OSError):
            settings.notices.unlink()
    if any(ended):  # with 0 it was asked to end, as by who stops a whole service
        raise KeystoreError(f"the process that faces the network ended with {ended[0]}")


class _GivenUpError(BaseException):
    """SIGTERM came while the signer was starting."""


def _give_up(*_: object) -> None:
    raise _GivenUpError


def _notices(settings: ServerSettings) -> socket.socket:
    """The socket at which the front reports that it listens, as it would to systemd.

    It is in the state folder: an abstract socket has no permissions, so any process could fill it.
    """
    made = owned(socket.SOCK_DGRAM, settings.notices, settings.front_user)
    made.settimeout(0)
    return made


def end_with_signer() -> None:
    """Let the system end this front with the signer that started it, even if that is killed.

    Else it would keep the port, with keys of TLS, and no other could listen there.
    """
    if (signer := os.environ.get(_SIGNER, "")).isdecimal():
        end_with(int(signer))


def _has_notice(notices: socket.socket) -> bool:
    with suppress(BlockingIOError):
        return bool(notices.recv(64))
    return False


def _started(settings: ServerSettings) -> "subprocess.Popen[bytes]":
    # -P: else Python would look for modules in the folder where the server is started
    command = [sys.executable, "-P", "-m", "pqsec_pki", "serve", "--config", str(settings.path)]
    sockets = given_sockets(os.environ)
    passed = [each.fileno() for each in sockets]
    user = settings.front_user if os.geteuid() == 0 and settings.front_user else None
    groups: Sequence[str | int] | None = [] if user else None
    process = subprocess.Popen(  # noqa: S603 -- this program
        [*command, "--part", "front"],
        env={
            **{name: each for name, each in os.environ.items() if not name.startswith(_NOT_PASSED)},
            "NOTIFY_SOCKET": str(settings.notices.absolute()),
            _SIGNER: str(os.getpid()),
        },
        pass_fds=passed,
        user=user,
        group=pwd.getpwnam(user).pw_gid if user else None,
        extra_groups=groups,
    )
    for each in sockets:
        each.close()
    return process


def _stop(process: "subprocess.Popen[bytes]") -> None:
    with suppress(ProcessLookupError):
        process.terminate()
    try:
        process.wait(_END)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def given_sockets(environment: Mapping[str, str]) -> list[socket.socket]:
    """The sockets at which systemd listens for this process, or for its parent; FileError."""
    if environment.get("LISTEN_PID") not in {str(os.getpid()), str(os.getppid())}:
        return []
    count = environment.get("LISTEN_FDS", "")
    if not count.isdecimal():
        raise FileError("systemd passed no number of sockets (LISTEN_FDS)")
    found = []
    for number in range(_FIRST_GIVEN, _FIRST_GIVEN + int(count)):
        try:
            found.append(socket.socket(fileno=os.dup(number)))
        except OSError as error:
            raise FileError(f"what systemd passed is not a socket: {error.strerror}") from error
    return found


def bound(address: tuple[str, int]) -> socket.socket:
    """A socket that listens at that address; FileError if it cannot."""
    host, port = address
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(_BACKLOG)
    except OSError as error:
        listener.close()
        raise FileError(
            f"cannot listen at {host}:{port}: {error.strerror}",
            hint="change `listen`, or `status`, in serve.yaml, or end what listens there",
        ) from error
    listener.settimeout(0)
    return listener


def notify(state: str, environment: Mapping[str, str]) -> None:
    """Tell systemd that the service is ready (sd_notify(3))."""
    path = environment.get("NOTIFY_SOCKET", "")
    if path.startswith(("/", "@")):
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
            link.connect(f"\0{path[1:]}" if path.startswith("@") else path)
            link.sendall(state.encode())
