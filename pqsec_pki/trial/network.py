"""A loopback of one's own, and what passes over it.

Participants of a trial must not meet others on this machine, nor trials that run at the same
time. Where the system allows it, a trial has a network namespace to itself (namespaces(7)):
that takes root, as does seeing what is on the wire (packet(7)).
"""

import ctypes
import fcntl
import os
import socket
import struct
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from threading import Event, Thread
from typing import TypeVar

Result = TypeVar("Result")

_CLONE_NEWNET = 0x40000000
_SIOCSIFFLAGS = 0x8914
_IFF_UP = 1
_ETH_P_ALL = 3
_SOL_PACKET, _PACKET_STATISTICS = 263, 6
_SO_RCVBUFFORCE = 33
_LOOPBACK = b"lo"
_PAUSE = 0.2
_LARGEST = 1 << 16
_BUFFER = 32 << 20
"""Bytes that the kernel keeps until they are read."""


def alone(work: Callable[["Network"], Result]) -> Result:
    """`work`, done in a new network that has nothing but a loopback, if that may be had.

    Who is not root stays in the machine's network. Only processes and sockets that `work`
    begins itself, in the thread it runs in, are there. Whatever interrupts the caller asks
    `work` to end, and waits for it.
    """
    over = Event()
    # The namespace is the thread's; a process inherits that of the thread which starts it.
    with ThreadPoolExecutor(1) as thread:
        done = thread.submit(lambda: work(Network(_leave_the_network(), over)))
        try:
            return done.result()
        finally:
            over.set()


@dataclass(frozen=True, slots=True)
class Network:
    """Where `work` is done."""

    is_alone: bool
    """Whether nobody else can be in this network."""
    _over: Event

    def pause(self, seconds: float) -> bool:
        """Let time go by; False if it is time to end."""
        return not self._over.wait(seconds)


def _leave_the_network() -> bool:
    libc = ctypes.CDLL(None, use_errno=True)
    if os.geteuid() != 0 or libc.unshare(_CLONE_NEWNET) != 0:
        return False
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        fcntl.ioctl(any_socket, _SIOCSIFFLAGS, struct.pack("16sh22x", _LOOPBACK, _IFF_UP))
    return True


@dataclass(slots=True)
class Wire:
    """What was seen on the loopback."""

    text: bytes
    """What is looked for."""
    packets: int = 0
    lost: int = 0
    """Packets that came too fast to be looked at."""
    readable: int = 0
    """Those that had the text in the clear."""
    _over: Event = field(default_factory=Event, repr=False)

    def look(self, wire: socket.socket) -> None:
        while not self._over.is_set():
            try:
                packet = wire.recv(_LARGEST)
            except TimeoutError:
                continue
            self.packets += 1
            self.readable += self.text in packet
        statistics = wire.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8)
        self.lost = struct.unpack("II", statistics)[1]

    def stop(self) -> None:
        self._over.set()


@contextmanager
def watched(text: bytes) -> Iterator[Wire | None]:
    """The loopback of this thread's network, watched for `text`; None if that is forbidden."""
    try:
        seen = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(_ETH_P_ALL))
    except PermissionError:
        yield None
        return
    with seen:
        seen.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER)
        seen.bind((_LOOPBACK.decode(), 0))
        seen.settimeout(_PAUSE)
        wire = Wire(text)
        watcher = Thread(target=wire.look, args=[seen], daemon=True)
        watcher.start()
        try:
            yield wire
        finally:
            wire.stop()
            watcher.join()
