"""The switch of a segment: `python -m pqsec_pki.trial._switch LOSS DELAY SEED PORT...`.

The ports are open TAP devices. A frame goes to the port that its destination address ends in, and
to all others if that is a group. On the way to each port, IP packets are lost with the probability
LOSS, so each fragment of a datagram is; all are delayed by DELAY seconds. ARP is never lost: the
kernel would repeat it only after a second, and the result would be about ARP. It runs before other
processes if it may (sched(7)): hosts that wait for it repeat messages, and so delay it more. For
each line on stdin it prints its counts as a line of JSON. It ends when stdin does.
"""

import json
import os
import random
import struct
import sys
import time
from collections import deque
from contextlib import suppress
from dataclasses import asdict, field
from select import EPOLLIN, epoll
from typing import NamedTuple

from pqsec_pki._dataclass import dataclass
from pqsec_pki.trial._handshake_traffic import HandshakeTraffic

_LARGEST = 1 << 16
_BURST = 64
"""Frames of one port that are read before the others get their turn."""
_PAUSE = 1.0
_IPV4, _ARP = b"\x08\x00", b"\x08\x06"
_TYPE = slice(12, 14)
_HEADER = 14


class _Delayed(NamedTuple):
    """A frame on its way."""

    due: float
    port: int
    frame: bytes


@dataclass(slots=True)
class Counts:
    """Counts of frames and messages."""

    frames: int = 0
    """IP packets that hosts sent; a packet to a multicast group counts once."""
    bytes: int = 0
    """Bytes of these packets, with their Ethernet headers."""
    fragments: int = 0
    """Frames with a part of a datagram that was too long for one frame."""
    deliveries: int = 0
    """One for each port that a frame should reach."""
    lost: int = 0
    """Deliveries that were lost on purpose."""
    handshake_messages: int = 0
    """Requests, replies and finals, each of them once for a pair."""
    handshake_repeats: int = 0
    """Handshake messages that were sent again."""
    cpu: float = 0.0
    """Seconds of the processor that the switch took."""


@dataclass(slots=True)
class Switch:
    """The ports, and what is on its way between them."""

    ports: list[int]
    loss: float
    delay: float
    random: random.Random
    counts: Counts = field(default_factory=Counts)
    _traffic: HandshakeTraffic = field(default_factory=HandshakeTraffic)
    _delayed: deque[_Delayed] = field(default_factory=deque)

    def serve(self, requests: int) -> None:
        """Pass frames until `requests`, where a line asks for the counts, ends."""
        numbers = {port: number for number, port in enumerate(self.ports)}
        with epoll() as ready:
            for file in (requests, *self.ports):
                ready.register(file, EPOLLIN)
            while True:
                for file, _ in ready.poll(self._pause()):
                    if file != requests:
                        self._read(numbers[file])
                    elif os.read(requests, 1):
                        self._report()
                    else:
                        return
                self._deliver()

    def _report(self) -> None:
        counts, traffic = self.counts, self._traffic
        counts.handshake_messages, counts.handshake_repeats = traffic.messages, traffic.repeats
        counts.cpu = time.process_time()
        print(json.dumps(asdict(counts)), flush=True)  # noqa: T201 -- to the segment

    def _pause(self) -> float:
        """Seconds until a frame is due."""
        return max(0.0, self._delayed[0].due - time.monotonic()) if self._delayed else _PAUSE

    def _read(self, number: int) -> None:
        with suppress(BlockingIOError):
            for _ in range(_BURST):
                self.pass_on(number, os.read(self.ports[number], _LARGEST))

    def _deliver(self) -> None:
        now = time.monotonic()
        while self._delayed and self._delayed[0].due <= now:
            _, port, frame = self._delayed.popleft()
            self._write(port, frame)

    def pass_on(self, source: int, frame: bytes) -> None:
        """A frame that the host `source` sent."""
        kind = frame[_TYPE]
        if kind == _IPV4:
            self._count(frame)
        elif kind != _ARP:
            return
        for number in self._destinations(source, frame):
            if kind == _IPV4:
                self.counts.deliveries += 1
                if self.loss and self.random.random() < self.loss:
                    self.counts.lost += 1
                    continue
            if self.delay:
                due = time.monotonic() + self.delay
                self._delayed.append(_Delayed(due, self.ports[number], frame))
            else:
                self._write(self.ports[number], frame)

    def _destinations(self, source: int, frame: bytes) -> list[int]:
        if frame[0] & 1:  # a group (IEEE 802.3, 3.2.3)
            return [number for number in range(len(self.ports)) if number != source]
        number = int.from_bytes(frame[4:6])
        return [number] if number < len(self.ports) else []

    def _count(self, frame: bytes) -> None:
        counts = self.counts
        counts.frames += 1
        counts.bytes += len(frame)
        (place,) = struct.unpack_from("!H", frame, _HEADER + 6)
        if place & 0x3FFF:  # more fragments follow, or it is not the first (RFC 791, 3.1)
            counts.fragments += 1
        if not place & 0x1FFF:
            length = 4 * (frame[_HEADER] & 15)
            self._traffic.see(frame[_HEADER + length + 8 :])

    @staticmethod
    def _write(port: int, frame: bytes) -> None:
        with suppress(OSError):  # the host has ended
            os.write(port, frame)


def main(loss: str, delay: str, seed: str, *ports: str) -> None:
    """Serve until stdin ends."""
    with suppress(OSError):  # only root may
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    chance = random.Random(int(seed))  # noqa: S311 -- of a network, not of a key
    Switch([*map(int, ports)], float(loss), float(delay), chance).serve(sys.stdin.fileno())


if __name__ == "__main__":
    main(*sys.argv[1:])
