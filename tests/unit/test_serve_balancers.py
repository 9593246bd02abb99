"""The server behind TCP balancers: PROXY headers say whose a connection is, of balancers alone."""

import json
import socket
import time
from contextlib import ExitStack
from datetime import UTC, datetime
from ipaddress import ip_address

import pytest
from OpenSSL import SSL

from pqsec_pki.errors import InvalidDocumentError, MalformedError
from pqsec_pki.est import ServerTrust, client_context
from pqsec_pki.server import read_settings
from pqsec_pki.server.addresses import is_in, network
from pqsec_pki.server.proxy_header import MOST_OCTETS, ProxyHeader
from tests.unit.serving import HOST, PATIENCE, Robot, Server
from tests.unit.test_serve_hostile import counted, until

BALANCER, SECOND, STRANGER = "127.0.0.9", "127.0.0.10", "127.0.0.66"
ROBOT, OTHER, SIX = "192.0.2.17", "192.0.2.18", "2001:db8::17"
SIGNATURE = b"\r\n\r\n\0\r\nQUIT\n"
LIMITS = {"seconds": 2, "connections": 30, "connections_of_address": 4, "requests_of_address": 20}


def text(client, family="TCP4", goal="198.51.100.1"):
    return f"PROXY {family} {client} {goal} 51234 8443\r\n".encode()


def binary(client, *, command=0x21, family=None, rest=b""):
    octets = ip_address(client).packed
    family = family or (0x11 if len(octets) == 4 else 0x21)
    body = octets + bytes(len(octets)) + b"\xc8\x22\x20\xfb" + rest
    return framed(body, command, family)


def framed(body, command=0x21, family=0x11):
    return SIGNATURE + bytes([command, family]) + len(body).to_bytes(2) + body


TLVS = b"\x04\x00\x03xyz" + b"\x20\x01\x00" + b"\x05" * 256
"""As a balancer sends them: nothing in them is used."""
UNIX = bytes(216)
LOCAL = framed(b"", 0x20, 0)
TAKEN = [
    (text(ROBOT), ROBOT),
    (text(SIX, "TCP6", "::1"), SIX),
    (b"PROXY UNKNOWN\r\n", ""),
    (b"PROXY UNKNOWN ffff::1 ffff::2 65535 65535\r\n", ""),
    (b"PROXY UNKNOWN ".ljust(105, b"x") + b"\r\n", ""),
    (b"PROXY TCP4 192.0.2.17 192.0.2.1 0 65535\r\n", ROBOT),
    (binary(ROBOT), ROBOT),
    (binary(SIX), SIX),
    (binary(ROBOT, rest=TLVS), ROBOT),
    (binary(ROBOT, rest=bytes(MOST_OCTETS - 16 - 12)), ROBOT),
    (LOCAL, ""),
    (binary(ROBOT, command=0x20), ""),  # no client speaks there, whatever the addresses say
    (framed(b"", 0x20, 0xFF), ""),
    (framed(b"", 0x21, 0), ""),
    (framed(UNIX, 0x21, 0x31), ""),
    (binary(ROBOT, family=0x12), ""),  # UDP
]
"""Headers, and the clients in them."""
REFUSED = [
    b"GET / HTTP/1.1\r\n",
    b"\x16\x03\x01",  # TLS
    b"proxy TCP4 1.2.3.4 1.2.3.4 1 1\r\n",
    b"PROXY\r\n",
    b"PROXY \r\n",
    b"PROXY TCP4\r\n",
    b"PROXY TCP5 1.2.3.4 1.2.3.4 1 1\r\n",
    b"PROXY  TCP4 1.2.3.4 1.2.3.4 1 1\r\n",
    b"PROXY TCP4 1.2.3.4 1.2.3.4 1\r\n",
    b"PROXY TCP4 1.2.3.4 1.2.3.4 1 1 1\r\n",
    b"PROXY TCP4 1.2.3.4 1.2.3.4 1 65536\r\n",
    b"PROXY TCP4 1.2.3.4 1.2.3.4 01 1\r\n",
    b"PROXY TCP4 1.2.3.4 1.2.3.4 -1 1\r\n",
    b"PROXY TCP4 1.2.3.04 1.2.3.4 1 1\r\n",
    b"PROXY TCP4 1.2.3 1.2.3.4 1 1\r\n",
    b"PROXY TCP4 ::1 ::1 1 1\r\n",
    b"PROXY TCP4 1.2.3.4\n 1.2.3.4 1 1\r\n",
    b"PROXY TCP4 \xd9\xa1.2.3.4 1.2.3.4 1 1\r\n",
    b"PROXY TCP6 1.2.3.4 1.2.3.4 1 1\r\n",
    b"PROXY TCP6 fe80::1%eth0 ::1 1 1\r\n",
    b"PROXY TCP6 ::1 fe80::1%eth0 1 1\r\n",
    b"PROXY TCP6 ::1 nowhere 1 1\r\n",
    b"PROXY UNKNOWN ".ljust(107, b"x"),
    b"PROXY TCP4 1.2.3.4 1.2.3.4 1 1\n" + b" " * 107,
    binary(ROBOT, command=0x22),
    binary(ROBOT, command=0x11),
    binary(ROBOT, family=0x41),
    binary(ROBOT, family=0x13),
    framed(bytes(11)),
    framed(bytes(35), 0x21, 0x21),
    framed(UNIX[1:], 0x21, 0x31),
    SIGNATURE + b"\x20\x00" + (MOST_OCTETS - 15).to_bytes(2),
    SIGNATURE + b"\x20\x00\xff\xff",
]


@pytest.mark.parametrize(("header", "client"), TAKEN)
def test_a_header_is_read_to_its_end_and_not_further(header, client):
    for behind in (b"", b"\x16\x03\x01"):
        assert ProxyHeader.of(header + behind) == ProxyHeader(len(header), client)
    assert all(ProxyHeader.of(header[:size]) is None for size in range(len(header)))


@pytest.mark.parametrize("data", REFUSED)
def test_what_is_not_a_header_is_refused_without_more_of_it(data):
    with pytest.raises(MalformedError):
        ProxyHeader.of(data)


@pytest.mark.parametrize(
    ("address", "found"),
    [
        ("192.0.2.10", True),
        ("::ffff:192.0.2.10", True),  # a socket for both versions of IP gives it so
        ("192.0.2.11", False),
        ("2001:db8::99", True),
        ("2001:db8:0:1::", False),
        ("fe80::1%eth0", True),
        ("", False),
    ],
)
def test_an_address_is_of_a_balancer_whatever_it_is_written_as(address, found):
    named = ("192.0.2.10", "2001:db8::/64", "fe80::1")
    assert is_in(address, map(network, named)) == found


@pytest.mark.parametrize(
    "value", ["192.0.2.10/24", "0.0.0.0/0", "::/0", "balancer.example", "::ffff:192.0.2.1", ""]
)
def test_what_names_no_balancer_or_all_addresses_is_refused(tmp_path, value):
    config = tmp_path / "serve.yaml"
    keys = {"url": "https://x", "keystore": "k", "domain": "d", "tls": [{"chain": "c", "key": "k"}]}
    config.write_text(json.dumps(keys | {"proxy_from": [value]}))
    with pytest.raises(InvalidDocumentError, match="the network of a balancer"):
        read_settings(config)


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    settings = {"proxy_from": [BALANCER], "limits": LIMITS, "approval": True}
    made = Server(tmp_path_factory.mktemp("serve"), datetime.now(UTC), **settings)
    with made.running(measured=True):
        yield made


def head(server, before, source=BALANCER):
    """The status that a client of the balancer gets; 0 for none."""
    try:
        reply = server.send("GET", "/pqsec/v1/head", source=source, before=before)
    except (SSL.Error, OSError):
        return 0
    return reply.status


def addresses(server):
    """From which requests came, by the log."""
    lines = map(json.loads, server.log.splitlines())
    return [each["address"] for each in lines if "method" in each]


def refused(server, before, source=BALANCER):
    """Whether the connection is closed without a word of TLS."""
    with socket.create_connection((HOST, server.port), PATIENCE, (source, 0)) as link:
        link.sendall(before)
        try:
            return not link.recv(1)
        except ConnectionError:
            return True


@pytest.mark.parametrize(
    ("before", "client"),
    [
        (text("192.0.2.1"), "192.0.2.1"),
        (binary("192.0.2.2", rest=TLVS), "192.0.2.2"),
        (binary(SIX), SIX),
        (LOCAL, BALANCER),
        (b"PROXY UNKNOWN\r\n", BALANCER),
    ],
)
def test_the_log_has_the_address_in_the_header(server, before, client):
    assert head(server, before) == 200
    assert addresses(server)[-1] == client


def test_limits_of_requests_are_of_the_robot_and_not_of_the_balancer(server):
    """All robots behind a balancer shared the limits of its address."""
    found = [head(server, text(ROBOT)) for _ in range(LIMITS["requests_of_address"] + 5)]
    assert 429 in found
    assert head(server, binary(OTHER)) == 200


def test_limits_of_connections_are_of_the_robot_and_not_of_the_balancer(server):
    with ExitStack() as stack:
        for _ in range(LIMITS["connections_of_address"]):
            stack.enter_context(server.connect(source=BALANCER, before=text("192.0.2.3")))
        assert head(server, text("192.0.2.3")) == 0
        assert head(server, text("192.0.2.4")) == 200


def test_a_request_that_waits_has_the_address_in_the_header(server, tmp_path):
    robot = Robot(server, tmp_path)
    assert server.ask(robot.request, source=BALANCER, before=binary("192.0.2.5")).status == 202
    [waits] = json.loads(server.cli("requests", "list", "--config", "serve.yaml", "--json").stdout)[
        "requests"
    ]
    assert waits["address"] == "192.0.2.5"


def test_a_header_from_an_address_that_is_not_named_is_not_read(server):
    """Who could send one there would have any address: of others, and none of their limits."""
    for before in (text("192.0.2.6"), binary("192.0.2.6"), LOCAL):
        assert head(server, before, source=STRANGER) == 0
    assert head(server, b"", source=STRANGER) == 200
    assert addresses(server)[-1] == STRANGER
    assert "192.0.2.6" not in addresses(server)


@pytest.mark.parametrize("before", [*REFUSED, b"PROXY TCP4 1.2.3.4 1.2.3.4 1 1\r\n" * 2])
def test_a_balancer_without_a_right_header_is_refused_and_the_log_says_why(server, before):
    events, twice = counted(server, "proxy-header"), before.count(b"1 1\r\nPROXY")
    assert head(server, before) == 0  # TLS comes behind
    assert counted(server, "proxy-header") == events + 1 - twice  # the second one is broken TLS
    if not twice:
        assert refused(server, before)
        told = json.loads(server.log.splitlines()[-1])
        assert (told["event"], told["address"]) == ("a balancer is refused", BALANCER)
        assert "PROXY header" in told["detail"]


@pytest.mark.parametrize("before", [b"", b"PROXY TCP4 1", SIGNATURE, binary(ROBOT, rest=TLVS)[:-1]])
def test_a_header_that_does_not_end_in_time_is_cut_off(server, before):
    late = counted(server, "late")
    assert refused(server, before)
    assert counted(server, "late") > late


def test_the_time_of_a_header_ends_with_it(server):
    """Else it would cut the robot off in the middle of a later request."""
    late = counted(server, "late")
    assert head(server, text("192.0.2.10")) == 200
    time.sleep(LIMITS["seconds"] + 0.5)
    assert counted(server, "late") == late


def test_a_header_that_comes_octet_by_octet_has_one_time(server):
    late = counted(server, "late")
    with socket.create_connection((HOST, server.port), PATIENCE, (BALANCER, 0)) as link:
        link.settimeout(0.1)
        for octet in binary(ROBOT, rest=bytes(4000)):
            try:
                link.sendall(bytes([octet]))
                if not link.recv(1):
                    break
            except TimeoutError:
                continue
            except ConnectionError:
                break
    assert counted(server, "late") > late


def test_connections_without_a_header_hold_no_robot_up(server):
    """They have no client yet, so they count for the balancer, and are closed for robots first."""
    closed = counted(server, "closed-for-others")
    with ExitStack() as stack:
        for _ in range(3 * LIMITS["connections"]):
            link = stack.enter_context(socket.socket())
            link.bind((BALANCER, 0))
            link.connect((HOST, server.port))
            link.sendall(b"PROXY ")
        until(lambda: counted(server, "closed-for-others") >= closed + 2 * LIMITS["connections"])
        assert head(server, text("192.0.2.7")) == 200
        assert head(server, b"", source=SECOND) == 200
    until(lambda: "pqsec_serve_connections 0\n" in server.page("/metrics", text=True))


@pytest.mark.parametrize("apart", [False, True])
def test_tls_may_begin_in_the_segment_of_the_header(server, apart):
    context = client_context(ServerTrust(pins=server.pins()), HOST)
    tls = SSL.Connection(context, None)
    tls.set_connect_state()
    with pytest.raises(SSL.WantReadError):
        tls.do_handshake()
    sent = binary("192.0.2.8") + tls.bio_read(1 << 16)
    with socket.create_connection((HOST, server.port), PATIENCE, (BALANCER, 0)) as link:
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for part in [sent[:7], sent[7:20], sent[20:]] if apart else [sent]:
            link.sendall(part)
        assert link.recv(3) == b"\x16\x03\x03"


def test_who_is_a_balancer_is_read_again(server):
    settings = json.loads(server.config.read_text())
    server.config.write_text(json.dumps(settings | {"proxy_from": f"{SECOND}/31"}))
    server.reload()
    until(lambda: '"the configuration was read again"' in server.log)
    assert head(server, text("192.0.2.9"), source=SECOND) == 200
    assert head(server, text("192.0.2.9")) == 0
    assert head(server, b"") == 200
