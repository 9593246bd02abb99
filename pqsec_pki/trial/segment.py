"""Network namespaces as hosts on one Ethernet, with a switch that loses and delays frames.

Each host has a TAP device (Documentation/networking/tuntap.rst in Linux); the other ends belong to
the switch (`_switch.py`), a process. So loss, delay and the counts need neither nft nor tc, and
mean the same on every machine.
"""

import fcntl
import json
import os
import secrets
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import PqsecError
from pqsec_pki.trial.network import alone, new_network

HOSTS = 200
"""The most hosts of a segment."""
_TUN = Path("/dev/net/tun")
_INTERFACE = b"eth0"
_TUNSETIFF = 0x400454CA
_IFF_TAP, _IFF_NO_PI = 0x0002, 0x1000
_IFF_UP, _IFF_MULTICAST = 0x1, 0x1000
_SIOCSIFFLAGS, _SIOCSIFADDR, _SIOCSIFNETMASK = 0x8914, 0x8916, 0x891C
_SIOCSIFMTU, _SIOCSIFHWADDR, _SIOCSIFTXQLEN = 0x8922, 0x8924, 0x8943
_ARPHRD_ETHER = 1
_QUEUE = 10_000
"""Frames of a host that wait for the switch; if there are more, they are lost unintentionally."""
_IPV6 = Path("/proc/sys/net/ipv6/conf/all/disable_ipv6")
_WAYS = (
    "run it as root or in a user namespace (unshare --user --map-root-user pqsec bench ...);"
    f" a container also needs the capability NET_ADMIN and the device {_TUN}"
)


class SegmentError(PqsecError):
    """Network namespaces or their interfaces cannot be created, or the switch has ended."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """What happens to a frame between two hosts."""

    loss: float = 0.0
    """The probability that it is lost, from 0 to 1."""
    delay: float = 0.0
    """Seconds until it arrives."""
    mtu: int = 1500
    """The longest IP packet in it, in bytes."""


class Segment:
    """Hosts on one Ethernet."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._ports: list[int] = []
        self._switch: subprocess.Popen[bytes] | None = None

    def add_host(self) -> None:
        """Create a host, and put the calling thread into its namespace; SegmentError."""
        number = len(self._ports)
        try:
            if not new_network():
                raise SegmentError("this process may not create network namespaces", hint=_WAYS)
            self._ports.append(_port(number, self._link.mtu))
        except OSError as error:
            raise SegmentError(
                f"{_TUN}: the interface of a host cannot be created: {error.strerror}", hint=_WAYS
            ) from None

    def connect(self) -> None:
        """Start the switch; frames that hosts sent before wait for it."""
        link, seed = self._link, secrets.randbits(32)
        words = (link.loss, link.delay, seed, *self._ports)
        self._switch = subprocess.Popen(  # noqa: S603 -- this interpreter
            [sys.executable, "-I", "-m", "pqsec_pki.trial._switch", *map(str, words)],
            cwd="/",
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            pass_fds=self._ports,
            start_new_session=True,
        )

    def counted(self) -> Mapping[str, int | float]:
        """What the switch has counted until now (`_switch.Counts`); SegmentError if it ended."""
        if not (self._switch and self._switch.stdin and self._switch.stdout):
            raise SegmentError("the hosts are not connected")
        try:
            self._switch.stdin.write(b"\n")
            counted: dict[str, int | float] = json.loads(self._switch.stdout.readline())
        except (BrokenPipeError, ValueError):
            raise SegmentError(f"the switch has ended: {self._switch.wait()}") from None
        return counted

    def disconnect(self) -> None:
        """Stop the switch."""
        if self._switch:
            self._switch.kill()
            self._switch.communicate()
        for port in self._ports:
            os.close(port)


def refuse_without_hosts() -> None:
    """SegmentError if this process may not create hosts; before anything else takes time."""
    with segment(Link()) as made:
        alone(lambda _: made.add_host())


@contextmanager
def segment(link: Link) -> Iterator[Segment]:
    """A segment without hosts, which is removed when the block ends.

    A namespace belongs to a thread, so all hosts are added in a thread that ends after them:
    see `network.alone`.
    """
    made = Segment(link)
    try:
        yield made
    finally:
        made.disconnect()


def _port(number: int, mtu: int) -> int:
    """The switch's end of a new interface in the namespace of this thread, which is up."""
    port = os.open(_TUN, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        fcntl.ioctl(port, _TUNSETIFF, _request(struct.pack("H", _IFF_TAP | _IFF_NO_PI)))
        if _IPV6.exists():
            _IPV6.write_text("1")  # its own messages would only add to the counts
        _configure(number, mtu)
    except OSError:
        os.close(port)
        raise
    return port


def _configure(number: int, mtu: int) -> None:
    """Address 10.77.x.y/16 and an Ethernet address that ends in the number of the port."""
    two = struct.pack("!H", number)
    address, mask = bytes([10, 77]) + struct.pack("!H", number + 1), bytes([255, 255, 0, 0])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        for request, value in (
            (_SIOCSIFHWADDR, struct.pack("H", _ARPHRD_ETHER) + b"\x02\0\0\0" + two),
            (_SIOCSIFMTU, struct.pack("i", mtu)),
            (_SIOCSIFTXQLEN, struct.pack("i", _QUEUE)),
            (_SIOCSIFADDR, struct.pack("HH4s", socket.AF_INET, 0, address)),
            (_SIOCSIFNETMASK, struct.pack("HH4s", socket.AF_INET, 0, mask)),
            (_SIOCSIFFLAGS, struct.pack("H", _IFF_UP | _IFF_MULTICAST)),
        ):
            fcntl.ioctl(any_socket, request, _request(value))


def _request(value: bytes) -> bytes:
    """A struct ifreq (netdevice(7))."""
    return struct.pack("16s24s", _INTERFACE, value)
