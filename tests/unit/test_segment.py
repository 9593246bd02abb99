"""The switch of a segment, and the handshake messages that it counts."""

import os
import random
import socket
import struct
import subprocess
import sys

import pytest

from pqsec_pki.handshake import DataHolder, GenericMessage, MessageClass
from pqsec_pki.trial._handshake_traffic import HandshakeTraffic
from pqsec_pki.trial._switch import Switch
from pqsec_pki.trial.host_process import HostProcess, kernel_counters
from pqsec_pki.trial.network import alone
from pqsec_pki.trial.segment import Link, SegmentError, refuse_without_hosts, segment

GROUP = bytes.fromhex("01005e7f0001")
IPV4, ARP, IPV6 = (bytes.fromhex(each) for each in ("0800", "0806", "86dd"))
ONE, OTHER = b"\1" * 12, b"\2" * 12


def address(port):
    return b"\2\0\0\0" + port.to_bytes(2)


def frame(to, *, kind=IPV4, place=0, payload=b""):
    """An Ethernet frame from port 0; `place` are the flags and the offset of a fragment."""
    ip = struct.pack("!BBHHHBBH4s4s", 0x45, 0, 0, 0, place, 1, 17, 0, b"\n\x4d\0\1", b"\n\x4d\0\2")
    return to + address(0) + kind + ip + bytes(8) + payload


@pytest.fixture
def switch():
    """switch(ports, loss) and what each port gets."""
    opened = []

    def make(ports, loss=0.0, delay=0.0):
        pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM) for _ in range(ports)]
        opened.extend(pairs)
        for pair in pairs:
            for end in pair:
                end.settimeout(0)
        chance = random.Random(7)  # noqa: S311 -- a network's
        ports = [pair[0].fileno() for pair in pairs]
        return Switch(ports, loss, delay, chance), [pair[1] for pair in pairs]

    yield make
    for pair in opened:
        for end in pair:
            end.close()


def arrived(host):
    found = []
    while True:
        try:
            found.append(host.recv(1 << 16))
        except BlockingIOError:
            return found


def test_a_frame_goes_to_its_port_and_one_to_a_group_to_all_others(switch):
    made, hosts = switch(3)
    for to in (address(1), GROUP, address(9)):
        made.pass_on(0, frame(to))
    assert [len(arrived(each)) for each in hosts] == [0, 2, 1]
    assert (made.counts.frames, made.counts.deliveries) == (3, 3)


def test_what_is_neither_ip_nor_arp_does_not_pass(switch):
    made, hosts = switch(2)
    made.pass_on(0, frame(GROUP, kind=IPV6))
    made.pass_on(0, frame(GROUP, kind=ARP))
    assert len(arrived(hosts[1])) == 1
    assert made.counts.frames == 0


def test_each_way_loses_its_share_and_arp_is_never_lost(switch):
    made, hosts = switch(2, loss=0.1)
    got = 0
    for _ in range(10_000):
        made.pass_on(0, frame(address(1)))
        got += len(arrived(hosts[1]))
    assert made.counts.lost == 10_000 - got
    assert 900 < made.counts.lost < 1100  # 3.3 standard deviations, and the seed is fixed
    for _ in range(100):
        made.pass_on(0, frame(address(1), kind=ARP))
        got += len(arrived(hosts[1]))
    assert got == 10_100 - made.counts.lost


def test_fragments_are_frames_that_can_be_lost(switch):
    made, _ = switch(2)
    for place in (0x2000, 0x2010, 0x0020, 0x4000):  # first, middle, last; not to be fragmented
        made.pass_on(0, frame(address(1), place=place))
    assert (made.counts.frames, made.counts.fragments) == (4, 3)


def test_a_delayed_frame_is_not_delivered_at_once(switch):
    made, hosts = switch(2, delay=600.0)
    made.pass_on(0, frame(address(1)))
    made._deliver()
    assert arrived(hosts[1]) == []
    assert 0 < made._pause() <= 600


def datagram(message, *, fragment=None, order="<", writer="000201c3"):
    """An RTPS message that carries that sample, or its first fragment of so many bytes."""
    little = order == "<"
    ends = bytes.fromhex("000201c4") + bytes.fromhex(writer)
    number = struct.pack(f"{order}II", 0, 1)
    body = struct.pack(f"{order}HH", 0, 16) + ends + number
    if fragment:
        body += struct.pack(f"{order}IHHI", 1, 1, fragment, len(message)) + message[:fragment]
    else:
        body += message
    kind = 0x16 if fragment else 0x15
    head = struct.pack(f"{order}BBH", kind, 4 | little, len(body))
    timestamp = struct.pack(f"{order}BBHQ", 0x09, little, 8, 0)
    return b"RTPS" + bytes(16) + timestamp + head + body


def message(kind, source=ONE, destination=OTHER):
    return GenericMessage(
        source=source + bytes(4),
        sequence=1,
        destination_participant=destination + bytes(4),
        class_id=MessageClass.HANDSHAKE,
        tokens=(
            DataHolder(f"DDS:Auth:PKI-DH:1.0+{kind}", binary_properties=(("x", bytes(5000)),)),
        ),
    ).encode()


def test_a_handshake_message_that_is_seen_again_is_a_repeat():
    seen = HandshakeTraffic()
    for kind in ("Req", "Req", "Reply", "Final", "AuthReq", "Req"):
        seen.see(datagram(message(kind), fragment=1300)[:548])
    seen.see(datagram(message("Req", OTHER, ONE)))
    assert (seen.messages, seen.repeats) == (4, 2)


def test_other_datagrams_are_not_counted():
    seen = HandshakeTraffic()
    whole = datagram(message("Req"))
    for each in (b"", b"RTPS", b"DNS", datagram(message("Req"), writer="000100c2")):
        seen.see(each)
    for end in range(0, 200, 3):
        seen.see(whole[:end])
    chance = random.Random(1)  # noqa: S311 -- damage
    for _ in range(5000):
        damaged = bytearray(whole[:400])
        damaged[chance.randrange(20, 400)] = chance.randrange(256)
        seen.see(bytes(damaged))
    HandshakeTraffic().see(b"RTPS" + bytes(500))
    assert seen.messages < 5000


def test_what_a_host_says_is_read_among_what_its_stack_prints():
    lines = (
        *("ready", "2025 [x] WARNING: lost", "joined 0 10.0", "reader 1 10.1", "writer 1 10.1"),
        *("reader 2 10.2", "reader 3 10.3", "writer 3 10.5", "writer 2 10.6", "writer 3 10.7"),
        *("reader x 1", "received 7 11", "received 9 12"),
    )
    with subprocess.Popen(
        [sys.executable, "-c", f"print({chr(10).join(lines)!r})"], stdout=subprocess.PIPE
    ) as process:
        host = HostProcess(process)
        while host.hear():
            pass
    assert host.met == [10.5, 10.5]
    assert (host.received, host.times("joined")) == (9, [10.0])
    assert "WARNING: lost" in host.log[0]


def test_the_kernel_counts_datagrams():
    assert kernel_counters(os.getpid())["OutDatagrams"] >= 0
    assert kernel_counters(2**22 + 1) == {}


@pytest.fixture
def hosts(requires):
    """Network namespaces with interfaces, which most containers may not make."""
    lacking = None
    try:
        refuse_without_hosts()
    except SegmentError as error:
        lacking = error
    requires(None if lacking else True, f"what hosts need ({lacking})", lacking and lacking.hint)


@pytest.mark.usefixtures("hosts")
def test_frames_that_the_switch_is_too_slow_for_are_counted(monkeypatch):
    """It never starts, and a queue of one frame is full at once."""
    monkeypatch.setattr("pqsec_pki.trial.segment._QUEUE", 1)

    def work(_):
        with segment(Link()) as ethernet:
            ethernet.add_host()
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
                sender.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
                for _ in range(1000):
                    sender.sendto(bytes(100), ("10.77.255.255", 7000))
            with subprocess.Popen(["sleep", "60"]) as process:
                found = kernel_counters(process.pid)
                process.kill()
            return found

    found = alone(work)
    assert found["OutDatagrams"] + found["QueueDrops"] >= 1000
    assert found["QueueDrops"] > 0


@pytest.mark.usefixtures("hosts")
def test_hosts_reach_each_other_over_the_switch_alone():
    """Two namespaces; the datagram is fragmented by the MTU."""

    def work(_):
        with segment(Link(mtu=576)) as ethernet:
            ends = []
            for _ in range(2):
                ethernet.add_host()
                ends.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            sender, receiver = ends
            receiver.bind(("10.77.0.2", 7000))
            receiver.settimeout(30)
            ethernet.connect()
            sender.sendto(bytes(1200), ("10.77.0.2", 7000))
            got = len(receiver.recv(2000))
            sender.close()
            receiver.close()
            return got, ethernet.counted()

    got, counted = alone(work)
    assert (got, counted["frames"], counted["fragments"], counted["lost"]) == (1200, 3, 3, 0)
