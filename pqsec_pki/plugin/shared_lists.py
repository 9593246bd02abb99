"""The newest revocation list of each CA, known to all workers of an agent.

A worker asks the agent before a list of its own applies, so the numbers of a CA's lists only grow
in all workers. The agent compares numbers and keeps the lists as files in memory; the workers
verify and parse them.
"""

import os
import socket
from collections.abc import Callable
from contextlib import suppress
from hashlib import sha256

from pqsec_pki.certificates import RevocationList
from pqsec_pki.errors import FileError
from pqsec_pki.plugin import channel
from pqsec_pki.plugin.lists import MAX_CAS, Issuer
from pqsec_pki.plugin.octets import MessageReader, MessageWriter

_NEWER, _SAME, _SHOW = "newer", "same", "show"
_NUMBER = 32
"""Octets: more than RFC 5280 5.2.3 lets a list's number have."""


def exchange_through(
    agent: socket.socket,
) -> Callable[[Issuer, RevocationList | None], RevocationList | None]:
    """A worker's side: a function that shows the agent a list and returns the newer of the two.

    FileError if the agent has ended; then the worker ends too.
    """

    def exchange(issuer: Issuer, own: RevocationList | None) -> RevocationList | None:
        number = own.number if own and own.number is not None else -1
        writer = MessageWriter()
        writer.raw(_name_of(issuer))
        writer.raw((number + 1).to_bytes(_NUMBER, "little"))
        kind, handle = _asked(agent, writer)
        if own and kind == _SHOW:
            try:
                file = _file_of(own.der)
            except OSError as error:
                raise FileError(f"no file for a revocation list: {error.strerror}") from error
            try:
                kind, handle = _asked(agent, writer, file)
            finally:
                os.close(file)
        if kind == _SHOW or (kind == _NEWER and handle is None):
            raise FileError("a revocation list got lost: too many files are open")
        return own if handle is None else RevocationList.from_der(_content(handle))

    return exchange


def _asked(agent: socket.socket, question: MessageWriter, *handles: int) -> tuple[str, int | None]:
    try:
        channel.put(agent, question, *handles)
        answer = channel.take(agent)
    except OSError:
        answer = None
    if answer is None:
        raise FileError("the agent has ended")
    return answer[0].text(), answer[1]


class ListStore:
    """The agent's side: the number and the file of the newest list of each CA."""

    def __init__(self) -> None:
        self._newest: dict[bytes, tuple[int, int]] = {}
        """Digest of the CA -> number and file; the most recently used CA is last."""

    def answer(self, worker: socket.socket, question: MessageReader, handle: int | None) -> None:
        """Send a worker a list that is newer than its own, or ask it to show its own."""
        issuer, number = question.raw(sha256().digest_size), question.raw(_NUMBER)
        shown = int.from_bytes(number, "little")
        known, file = self._newest.pop(issuer, (0, None))
        if handle is not None and shown > known:
            known, file, handle = shown, handle, file
        if handle is not None:  # the older of the two
            os.close(handle)
        if file is not None:
            self._newest[issuer] = known, file
        if len(self._newest) > MAX_CAS:
            os.close(self._newest.pop(next(iter(self._newest)))[1])
        newer = [file] if file is not None and known > shown else []
        kind = _NEWER if newer else _SHOW if known < shown else _SAME
        try:
            channel.put(worker, channel.message(kind), *newer)
        except OSError:  # it may have ended; if not, it must not wait for an answer
            with suppress(OSError):
                worker.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Forget all of them."""
        for _, file in self._newest.values():
            os.close(file)
        self._newest.clear()


def _name_of(issuer: Issuer) -> bytes:
    writer = MessageWriter()
    for part in issuer[:3]:
        writer.block(part)
    writer.number("B", issuer[3])
    return sha256(writer.octets).digest()


def _file_of(octets: bytes) -> int:
    handle = os.memfd_create("pqsec-list")
    with os.fdopen(handle, "wb", closefd=False) as file:
        file.write(octets)
    return handle


def _content(handle: int) -> bytes:
    """The content of the file, whose position is shared with other processes, and not used."""
    try:
        size, octets = os.fstat(handle).st_size, b""
        while part := os.pread(handle, size - len(octets), len(octets)):
            octets += part
        return octets
    finally:
        os.close(handle)
