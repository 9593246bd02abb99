"""Runs a trial in its own network namespace, and captures its packets.

Participants of a trial must not discover other participants on this machine, or other trials.
If the system allows it, a trial has its own network namespace (namespaces(7)). That needs root,
as does capturing packets (packet(7)).
"""

import ctypes
import fcntl
import os
import socket
import struct
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import field
from pathlib import Path
from threading import Event, Thread
from typing import TypeVar

from pqsec_pki._dataclass import dataclass

Result = TypeVar("Result")

_CLONE_NEWNET = 0x40000000
_OWN_NETWORK = Path("/proc/thread-self/ns/net")
_SIOCSIFFLAGS = 0x8914
_IFF_UP = 1
_ETH_P_ALL = 3
_SOL_PACKET, _PACKET_STATISTICS = 263, 6
_SO_RCVBUFFORCE = 33
_LOOPBACK = b"lo"
_PAUSE = 0.2
_LARGEST = 1 << 16
_BUFFER = 32 << 20
"""Bytes that the kernel buffers until they are read."""


def alone(work: Callable[["Network"], Result]) -> Result:
    """The result of `work`, run in a new network with only a loopback if that is possible.

    Without root it runs in the machine's network. Only processes and sockets that `work` creates
    in its own thread are in the new network. If the caller is interrupted, `work` is asked to
    end, and waited for.
    """
    over = Event()
    # A namespace belongs to a thread; a process inherits it from the thread that starts it.
    with ThreadPoolExecutor(1) as thread:
        done = thread.submit(lambda: work(Network(new_network(), over)))
        try:
            return done.result()
        finally:
            over.set()


@dataclass(frozen=True, slots=True)
class Network:
    """The network in which `work` runs."""

    is_alone: bool
    """Whether no other process can be in this network."""
    _over: Event

    def pause(self, seconds: float) -> bool:
        """Wait; False if `work` is asked to end."""
        return not self._over.wait(seconds)


def new_network() -> bool:
    """Put this thread into a new network, whose loopback is up; False without the permissions."""
    libc = ctypes.CDLL(None, use_errno=True)
    with _OWN_NETWORK.open() as before:
        if os.geteuid() != 0 or libc.unshare(_CLONE_NEWNET) != 0:
            return False
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
                request = struct.pack("16sh22x", _LOOPBACK, _IFF_UP)
                fcntl.ioctl(any_socket, _SIOCSIFFLAGS, request)
        except PermissionError:  # a container may have SYS_ADMIN without NET_ADMIN
            libc.setns(before.fileno(), _CLONE_NEWNET)
            return False
    return True


@dataclass(slots=True)
class Wire:
    """Counts of the packets on the loopback."""

    text: bytes
    """The text to search for."""
    packets: int = 0
    lost: int = 0
    """Packets that the kernel dropped before they were read."""
    readable: int = 0
    """Packets with the text unencrypted."""
    _over: Event = field(default_factory=Event, repr=False)

    def capture(self, wire: socket.socket) -> None:
        while not self._over.is_set():
            try:
                packet = wire.recv(_LARGEST)
            except TimeoutError:
                continue
            self.packets += 1
            self.readable += self.text in packet
        with suppress(OSError):  # qemu-user does not pass it on
            statistics = wire.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8)
            self.lost = struct.unpack("II", statistics)[1]

    def stop(self) -> None:
        self._over.set()


@contextmanager
def watched(text: bytes) -> Iterator[Wire | None]:
    """Capture the loopback of this thread's network for `text`; None if that is forbidden."""
    try:
        seen = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(_ETH_P_ALL))
    except PermissionError:
        yield None
        return
    with seen:
        try:
            seen.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER)
        except PermissionError:  # root of a user name space: as much as the system allows
            seen.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        seen.bind((_LOOPBACK.decode(), 0))
        seen.settimeout(_PAUSE)
        wire = Wire(text)
        watcher = Thread(target=wire.capture, args=[seen], daemon=True)
        watcher.start()
        try:
            yield wire
        finally:
            wire.stop()
            watcher.join()
