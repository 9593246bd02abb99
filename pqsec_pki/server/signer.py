"""The signer: the process that has the CA keys. It listens at a Unix socket, and at no network.

One connection has one call and one answer. It takes all calls that came, answers them together, and
then takes the next ones: under load many requests are one change of the keystore.
"""

import os
import pwd
import signal
import socket
import struct
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import field, replace
from pathlib import Path
from types import FrameType

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import FileVersion, disk_errors, file_version
from pqsec_pki.errors import FileError, MalformedError, PqsecError, UsageError
from pqsec_pki.server.answers import NOT_DONE
from pqsec_pki.server.call import SignerAnswer, SignerCall, unpacked
from pqsec_pki.server.call_handling import CallHandler
from pqsec_pki.server.events import Log

MOST = 64
"""Calls that are answered together: the last one waits for all of them."""
SECONDS = 5.0
"""For the octets of a call, which the process at the other end has when it connects."""
_BACKLOG = 1024
_PEER = struct.Struct("iII")
_POLL = 0.5
_LIST_POLL = 600.0


@dataclass(slots=True)
class SignerProcess:
    """Answers calls until it is stopped."""

    listener: socket.socket
    load: Callable[[dict[Path, FileVersion]], CallHandler]
    """Reads the configuration, and enters what it read; raises if there is a mistake."""
    users: frozenset[int]
    """Who may connect."""
    log: Log
    pass_on: Callable[[], None]
    """Lets the front read the configuration again too."""
    front_listens: Callable[[], bool]
    """Whether the front has its sockets; asked until it has."""
    handler: CallHandler = field(init=False)
    trouble: str = ""
    """Why files that were changed are not in force; empty if they are."""
    stopping: bool = False
    reloading: bool = False
    _in_use: bool = False
    """Whether the front listens. If it cannot, nothing is issued."""
    _list_after: float = 0.0
    """When the revocation list is looked at next."""
    _read: dict[Path, FileVersion] = field(default_factory=dict)
    """Versions of the domain's and factories' files that the signer last read, or tried to."""

    def __post_init__(self) -> None:
        self.handler = self.load(self._read)

    def run(self) -> None:
        """Answer calls until SIGTERM; SIGHUP reads the configuration again."""
        signal.signal(signal.SIGTERM, self._stop)
        signal.signal(signal.SIGINT, self._stop)
        signal.signal(signal.SIGHUP, self._reload)
        self.listener.settimeout(_POLL)
        while not self.stopping:
            if self.reloading:
                self.reloading = False
                self.pass_on()
                self._load("the configuration")
            links = self._arrived()
            self._follow()
            self._in_use = self._in_use or self.front_listens()
            if self._in_use:
                self._keep_list()
            self._serve(links)

    def _stop(self, _number: int, _frame: FrameType | None) -> None:
        self.stopping = True

    def _reload(self, _number: int, _frame: FrameType | None) -> None:
        self.reloading = True

    def _follow(self) -> None:
        """Read files again that were changed: rights that they take must not come back."""
        changed = [path for path, known in self._read.items() if file_version(path) != known]
        if changed:
            self._load(", ".join(str(each) for each in changed))

    def _keep_list(self) -> None:
        """Issue the revocation list that is needed, before the first call and from time to time."""
        if time.monotonic() < self._list_after:
            return
        self._list_after = time.monotonic() + _LIST_POLL
        try:
            if self.handler.keep_list():
                self.log({"event": "a revocation list was issued"})
        except PqsecError as error:
            self.log({"event": "no revocation list could be issued", "detail": str(error)})

    def _load(self, what: str) -> None:
        """Use what is in the files now; if that has a mistake, what was in them stays in force."""
        seen: dict[Path, FileVersion] = {}
        try:
            self.handler = self.load(seen)
            self.trouble = ""
            self.log({"event": f"{what} was read again"})
        except PqsecError as error:
            self.trouble = f"{what} is not changed: {error}"
            self.log({"event": f"{what} is not changed", "detail": str(error)})
        self._read = seen or self._read
        self._list_after = 0.0

    def _arrived(self) -> list[socket.socket]:
        """The connections that wait, after the first one came."""
        found: list[socket.socket] = []
        with suppress(TimeoutError, BlockingIOError):
            while len(found) < MOST:
                link, _ = self.listener.accept()
                found.append(link)
                self.listener.settimeout(0)
        self.listener.settimeout(_POLL)
        return found

    def _serve(self, links: Sequence[socket.socket]) -> None:
        asked = [(link, call) for link in links if (call := self._call(link))]
        if not asked:
            return
        for (link, _), answer in zip(
            asked, self._answers([each for _, each in asked]), strict=True
        ):
            with suppress(OSError), link:
                link.settimeout(SECONDS)
                link.sendall(replace(answer, trouble=self.trouble).to_bytes())

    def _answers(self, calls: Sequence[SignerCall]) -> list[SignerAnswer]:
        try:
            answers = self.handler.answers(calls)
        except Exception as error:  # noqa: BLE001 -- one call must not end the server
            known = isinstance(error, PqsecError)
            note = str(error) if known else traceback.format_exc()
            failed = SignerAnswer(status=503, detail=NOT_DONE, retry_after=10, note=note)
            answers = [failed] * len(calls)
        for call, answer in zip(calls, answers, strict=True):
            if answer.note:
                self.log(_line(call, answer))
        return answers

    def _call(self, link: socket.socket) -> SignerCall | None:
        """The call on the connection; None, and the connection is closed, if it is not allowed."""
        try:
            if _user(link) not in self.users:
                raise MalformedError("another user may not ask the signer")
            return SignerCall.of(*unpacked(_LinkReader(link, time.monotonic() + SECONDS).take))
        except (PqsecError, OSError) as error:
            self.log({"event": "a call is refused", "detail": str(error)})
            link.close()
            return None


def _line(call: SignerCall, answer: SignerAnswer) -> dict[str, object]:
    return {
        "event": call.kind,
        "address": call.address,
        "status": answer.status,
        "detail": answer.note,
    }


@dataclass(slots=True)
class _LinkReader:
    link: socket.socket
    until: float

    def take(self, size: int) -> bytes:
        """Exactly `size` octets; MalformedError if they do not come in time."""
        found = bytearray()
        while len(found) < size:
            self.link.settimeout(max(0.001, self.until - time.monotonic()))
            more = self.link.recv(min(size - len(found), 1 << 20))
            if not more:
                raise MalformedError("the connection was closed")
            found += more
        return bytes(found)


def listening(path: Path, front_user: str = "") -> socket.socket:
    """A socket that listens at `path`; as of `owned`."""
    listener = owned(socket.SOCK_STREAM, path, front_user)
    listener.listen(_BACKLOG)
    return listener


def owned(kind: socket.SocketKind, path: Path, front_user: str = "") -> socket.socket:
    """A socket at `path`, for its owner, or also for its group; FileError if it cannot be made.

    For root the group is that of `front_user`.
    """
    made = socket.socket(socket.AF_UNIX, kind)
    before = os.umask(0o117 if front_user else 0o177)
    try:
        with disk_errors(path):
            path.unlink(missing_ok=True)
            made.bind(str(path))
            give_to(path, front_user)
    except BaseException:
        made.close()
        raise
    finally:
        os.umask(before)
    return made


def give_to(path: Path, front_user: str) -> None:
    """Let the group of `front_user`, if there is one, have `path`; only root can."""
    if front_user and os.geteuid() == 0:
        os.chown(path, -1, pwd.getpwnam(front_user).pw_gid)


def users_of(front_user: str) -> frozenset[int]:
    """The users who may ask: this process's, and `front_user`; UsageError if there is none."""
    if not front_user:
        return frozenset({os.getuid()})
    try:
        return frozenset({os.getuid(), pwd.getpwnam(front_user).pw_uid})
    except KeyError:
        raise UsageError(f"front_user: the system has no user {front_user}") from None


def _user(link: socket.socket) -> int:
    found = link.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size)
    return int(_PEER.unpack(found)[1])


def ask(path: Path, call: SignerCall) -> SignerAnswer:
    """The signer's answer, for callers that may block; FileError if no signer listens there."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as link:
        link.settimeout(SECONDS)
        try:
            link.connect(str(path))
            link.sendall(call.to_bytes())
            return SignerAnswer.of(*unpacked(_LinkReader(link, time.monotonic() + SECONDS).take))
        except OSError as error:
            raise FileError(f"the signer does not answer at {path}: {error}") from error
