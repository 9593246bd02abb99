"""What comes to the server and its robots over a network: HTTP, bodies of EST, calls at the signer.

The front and the signer are the real ones, in this process: without sockets, and with a connection
of TLS that was made once. The clock stands, so that no certificate is due: nothing is issued, and a
call that is answered with a failure of the server is a finding.
"""

import base64
import json
import re
import tempfile
from contextlib import suppress
from functools import cache, lru_cache, partial
from http.client import HTTPResponse
from io import BytesIO
from ipaddress import ip_address
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import AttributeOID, NameOID
from twisted.internet.address import IPv4Address
from twisted.internet.error import ConnectionDone
from twisted.internet.task import Clock
from twisted.internet.testing import StringTransport
from twisted.python.failure import Failure

from pqsec_pki.certificates import Certificate, CertificateRequest
from pqsec_pki.domain import create_keystore, read_domain
from pqsec_pki.enrolment import Bundle, name_asked_for, pins_in_use, request
from pqsec_pki.errors import MalformedError, PqsecError, VerificationError
from pqsec_pki.est import (
    SCHEME,
    EnrolmentToken,
    EstClient,
    RequestSigner,
    ServerTrust,
    TlsIdentity,
    client_context,
    from_base64,
    peer_certificate,
    peer_chain,
    server_context,
    verify_est_request,
)
from pqsec_pki.est.client import ASKING_FAILS
from pqsec_pki.est.linking import channel_binding
from pqsec_pki.server.call import CallKind, SignerCall, packed, unpacked
from pqsec_pki.server.call_handling import CallHandler
from pqsec_pki.server.channel import Channels
from pqsec_pki.server.configuration import EnrolmentPolicy, ServerLimits
from pqsec_pki.server.front import Front
from pqsec_pki.server.limiting import Connections
from pqsec_pki.server.proxy_header import MOST_OCTETS, ProxyHeader
from pqsec_pki.server.token_lines import record_token
from pqsec_pki.server.waiting import WaitingRequests
from pqsec_pki.server.waiting_folder import RequestFolder
from tests.fuzz import mutation
from tests.some_keys import some_key
from tests.unit.keystores import DAY, NOW
from tests.unit.serving import DOMAIN
from tests.unit.tls_sides import HOST, connected, identity, pin

NAME = "/fleet/r1"
PROFILE = "transition"
FAILED = 500
ENOUGH = 20
"""Requests of one input: more on one connection are told to come later."""
STATUS = re.compile(rb"HTTP/1\.[01] (\d{3}) ")


@cache
def world():
    return World(Path(_home().name))


@cache
def _home():
    """It goes when Python ends."""
    return tempfile.TemporaryDirectory(prefix="pqsec-fuzz-")


class World:
    """A server, and a robot that has enrolled there with a token that is used up."""

    def __init__(self, folder):
        self.handler = _handler(folder)
        profile = self.handler.keystore.profile
        made = request(NAME, profile, folder / "robot")
        self.request, key = made.request, (made.path.parent / "key.pem").read_bytes()
        self.next = request(NAME, profile, folder / "next").request
        self.token = _token(self.handler.keystore)
        self.secret = {"token": self.token.id, "secret": self.token.secret}
        [answer] = self.handler.answers([self.asking(CallKind.REQUEST, **self.secret)])
        assert answer.status == 200, answer
        chain = Bundle.from_bytes(answer.body).enclaves[NAME]["cert.pem"]
        self.shown = {"certificate": Certificate.from_pem(chain).der}
        self.connection, _ = _connection(TlsIdentity.of(chain, key))
        self.bare, self.robots_end = _connection(None)
        files = {"cert.pem": chain, "key.pem": key}
        second = made.path.parent / "alt.key.pem"
        self.signer = RequestSigner.of(files | {"alt.key.pem": second.read_bytes()})

    def asking(self, kind, body=None, **options):
        """A call of the robot, with its first request."""
        body = self.request.der if body is None else body
        return SignerCall(kind=kind, address=HOST, body=body, **options)

    def answer(self, call):
        """What the signer answers; AssertionError if it fails, or issues something."""
        [answer] = self.answers([call])
        return answer

    def answers(self, calls):
        """Likewise, to calls that come at once: the ledger is read and verified once for them."""
        answers = self.handler.answers(calls)
        for call, answer in zip(calls, answers, strict=True):
            assert answer.status != FAILED, answer
            if call.kind.issues and answer.status == 200:
                assert answer.note.endswith(", again"), answer
        return answers


def _handler(folder):
    domain = folder / "domain.yaml"
    domain.write_text(DOMAIN.format(profile=PROFILE))
    desired = read_domain(domain)
    keystore = create_keystore(desired, folder / "k", passphrase=None, now=NOW)
    waiting = WaitingRequests(RequestFolder(folder / "waiting"), 10)
    policy = EnrolmentPolicy(approval=True)
    return CallHandler(keystore, keystore.unlock(None), desired, lambda: NOW, waiting, policy)


def _token(keystore):
    made = EnrolmentToken.new(
        server=f"https://{HOST}",
        server_pins=frozenset({"0" * 64}),
        cas=pins_in_use(keystore),
        names=NAME,
        profile=PROFILE,
        not_after=NOW + DAY,
    )
    record_token(keystore, made, uses=1, replaces=False, now=NOW)
    return made


def _connection(shown):
    """Both ends of a connection where the robot showed its certificate, or none."""
    server = identity("ml-dsa-65")
    trust = ServerTrust(pins=frozenset({pin(server)}))
    return connected(server_context([server]), client_context(trust, HOST, shown))


# The signer's socket


def calls():
    here = world()
    asked = [
        here.asking(CallKind.REQUEST, **here.secret),
        here.asking(CallKind.ENROL, here.next.der, label="fleet", **here.secret),
        here.asking(CallKind.REENROL, here.next.der, **here.shown),
        here.asking(CallKind.BUNDLE, b"", **here.shown),
        here.asking(CallKind.RECEIPT, b"receipt", chain=(b"ca",), **here.shown),
        *(here.asking(kind, b"") for kind in CallKind if not kind.issues),
    ]
    return [each.to_bytes() for each in asked]


def take_call(data):
    call = SignerCall.of(*unpacked(reader(data)))
    assert SignerCall.of(*unpacked(reader(call.to_bytes()))) == call
    return world().answer(call)


def reader(data):
    """As the signer reads its socket."""
    rest = memoryview(data)

    def take(size):
        nonlocal rest
        if size > len(rest):
            raise MalformedError("the connection was closed")
        found, rest = bytes(rest[:size]), rest[size:]
        return found

    return take


def spoilt_call(data, rng, spoil):
    """One value of the header, or of the body, spoilt."""
    try:
        header, body = unpacked(reader(data))
    except PqsecError:
        return spoil(data)
    key = rng.choice([*header, "body", "all"])
    match key:
        case "all":
            return spoil(data)
        case "body":
            body = mutation.der(body, rng, spoil)
        case "kind":
            header[key] = rng.choice([*CallKind, "", None, [], 7])
        case "certificate":
            with suppress(ValueError):
                inner = base64.b64decode(str(header[key]))
                header[key] = _base64(mutation.der(inner, rng, spoil))
        case "chain":
            header[key] = rng.choice([[_base64(spoil(b"ca"))], None, "x", [1], [_base64(body)] * 9])
        case _:
            value = spoil(str(header[key]).encode(errors="replace")).decode(errors="replace")
            header[key] = rng.choice([value, value, None, 7, [], "\ud800"])
    return packed(header, body)


def _base64(data):
    return base64.b64encode(data).decode()


# Bodies of EST


def est_bodies():
    here = world()
    bound = challenged(here.connection)
    made = (here.request.der, here.next.der, bound)
    return [base64.encodebytes(each) for each in made]


def challenged(connection):
    """A request that is bound to the connection, with names of its own."""
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, NAME)])
    return (
        x509.CertificateSigningRequestBuilder()
        .subject_name(name)
        .add_attribute(
            AttributeOID.CHALLENGE_PASSWORD, base64.b64encode(channel_binding(connection))
        )
        .add_extension(x509.SubjectAlternativeName([x509.DNSName("r1")]), critical=False)
        .sign(some_key("ecdsa-p256").handle, hashes.SHA256())
        .public_bytes(Encoding.DER)
    )


def take_est(data):
    here = world()
    found = CertificateRequest.from_der(from_base64(data))
    for renews in (False, True):
        with suppress(VerificationError):
            verify_est_request(found, here.connection, renews=renews)
    return found.challenge_password, name_asked_for(found), _est_statuses(found.der)


@lru_cache(maxsize=1000)
def _est_statuses(der):
    """Of the answers to who shows a token, and to who shows a certificate."""
    here = world()
    asked = (CallKind.ENROL, here.secret), (CallKind.REENROL, here.shown)
    calls = [here.asking(kind, der, **options) for kind, options in asked]
    return [each.status for each in here.answers(calls)]


def spoilt_est(data, rng, spoil):
    """The request within, or the text."""
    try:
        inner = from_base64(data)
    except PqsecError:
        return spoil(data)
    if rng.randint(0, 7):
        return base64.encodebytes(mutation.der(inner, rng, spoil))
    return spoil(data)


# HTTP


def http_requests():
    here = world()
    basic = _base64(f"{here.token.id}:{here.token.secret}".encode())
    known = f"Authorization: Basic {basic}\r\n"
    est = base64.encodebytes(here.next.der)
    return [
        _http("POST /pqsec/v1/requests", here.request.pem, "application/x-pem-file", known),
        _http("POST /pqsec/v1/requests", here.next.der, "application/pkcs10"),
        _http("POST /.well-known/est/fleet/simpleenroll", est, "application/pkcs10", known),
        _http("POST /.well-known/est/simplereenroll", est, "application/pkcs10"),
        _http("POST /pqsec/v1/receipts", b"receipt", "application/vnd.pqsec.receipt"),
        _http("GET /.well-known/est/cacerts"),
        _http("HEAD /pqsec/v1/head", more="Connection: close\r\n"),
        _http("GET /pqsec/v1/bundle", more='If-None-Match: "0"\r\n') * 2,
        _signed("GET", "/pqsec/v1/bundle", b"", ""),
        _signed("POST", "/pqsec/v1/requests", here.next.pem, "application/x-pem-file"),
    ]


def _http(line, body=b"", media="", more=""):
    sent = f"Content-Type: {media}\r\nContent-Length: {len(body)}\r\n" if media else ""
    return f"{line} HTTP/1.1\r\nHost: {HOST}\r\n{sent}{more}\r\n".encode() + body


def _signed(method, path, body, media):
    headers = world().signer.headers(world().robots_end, method, path, body)
    more = "".join(f"{name}: {value}\r\n" for name, value in headers.items())
    return _http(f"{method} {path}", body, media, more)


class Direct:
    """The signer, asked without a socket, and once for the same call: the clock stands."""

    open = 0
    trouble = ""

    def ask(self, call, then):
        then(_answer(call.to_bytes()))


@lru_cache(maxsize=1000)
def _answer(call):
    return world().answer(SignerCall.of(*unpacked(reader(call))))


class Wire(StringTransport):
    """A connection with TLS below it; who signs requests shows no certificate there."""

    signs = False

    def getHandle(self):  # noqa: N802 -- Twisted's name
        return world().bare if self.signs else world().connection


# What the client showed in TLS is the same for each input.
_chain = cache(peer_chain)


@cache
def _peer(connection):
    found = peer_certificate(connection)
    return found.der if found else b""


def take_http(data):
    limits = ServerLimits(requests_of_address=ENOUGH)
    connections, front = Connections(limits), Front(Direct(), limits, json.dumps)
    factory = Channels(
        Clock(),
        seconds=15,
        classical=True,
        buffered=limits.buffered,
        connections=connections,
        most=front.most,
        answer=front.answer,
        count=front.count,
    )
    peer = IPv4Address("TCP", HOST, 1)
    channel, wire = factory.buildProtocol(peer), Wire(peerAddress=peer)
    wire.signs = SCHEME.encode() in data
    connection = wire.getHandle()
    channel.peer, channel.peer_chain = partial(_peer, connection), partial(_chain, connection)
    channel.makeConnection(wire)
    for part in (data[: len(data) // 2], data[len(data) // 2 :]):
        if not wire.disconnecting:
            channel.dataReceived(part)
    channel.connectionLost(Failure(ConnectionDone()))
    sent = wire.value()
    assert sent[:5] in {b"", b"HTTP/"}, sent[:50]
    assert str(FAILED) not in STATUS.findall(sent)
    assert factory.kept.total == 0
    return sent


def spoilt_http(data, rng, spoil):
    """A line of the header, or the body with a length that is right; or the octets as they are."""
    head, end, body = data.partition(b"\r\n\r\n")
    lines = head.split(b"\r\n")
    at = rng.randrange(len(lines))
    match rng.choice(["line", "line", "drop", "double", "swap", "body", "body", "all", "twice"]):
        case "line":
            lines[at] = spoil(lines[at])
        case "drop":
            del lines[at]
        case "double":
            lines.insert(at, rng.choice(lines))
        case "swap":
            lines[at] = rng.choice(HEADERS)
        case "body":
            body = rng.choice([mutation.in_pem, spoilt_est])(body, rng, spoil)
            lines = [each for each in lines if not each.lower().startswith(b"content-length")]
            lines.append(b"Content-Length: %d" % len(body))
        case "twice":
            return data * rng.choice([2, 3, 20])
        case "all":
            return spoil(data)
    return b"\r\n".join(lines) + end + body


HEADERS = [
    *(b"Content-Length: 0", b"Content-Length: -1", b"Content-Length: 99999999999999999999"),
    *(b"Content-Length: +5", b"Content-Length: 5, 5", b"Transfer-Encoding: chunked"),
    *(b"Transfer-Encoding: identity", b"Expect: 100-continue", b"Upgrade: h2c"),
    *(b"Authorization: Basic", b"Authorization: Basic \xff", b"Authorization: Basic Og=="),
    *(b"Content-Type: multipart/form-data; boundary=x", b"Connection: upgrade", b" folded: x"),
    *(b"Authorization: PQSEC ,", b"Authorization: PQSEC AAAA,AAAA", b"PQSEC-Certificate: AA=="),
    *(b"If-None-Match: *", b"Host", b":", b"", b"A" * 20_000, b"PRI * HTTP/2.0"),
    *(b"GET /pqsec/v1/head HTTP/0.9", b"GET http://x/pqsec/v1/head HTTP/1.1", b"GET * HTTP/1.1"),
]


# PROXY headers of balancers


def proxy_headers():
    begin, ports = b"\r\n\r\n\0\r\nQUIT\n", b"\xc8\x22\x20\xfb"
    return [
        b"PROXY TCP4 192.0.2.17 198.51.100.1 51234 8443\r\n\x16",
        b"PROXY TCP6 2001:db8::17 ::ffff:192.0.2.1 51234 8443\r\n",
        b"PROXY UNKNOWN ffff::1 ffff::2 1 2\r\n",
        begin + b"\x21\x11\0\x13" + bytes(range(8)) + ports + b"\x04\0\x04abcd\x16",
        begin + b"\x21\x21\0\x24" + bytes(range(32)) + ports,
        begin + b"\x21\x31\0\xd8" + bytes(216),
        begin + b"\x20\0\0\0",
    ]


def take_proxy_header(data):
    """A header is what it is with less behind it, and none with an octet less."""
    found = ProxyHeader.of(data)
    if found is None:
        assert len(data) < MOST_OCTETS
        raise MalformedError("more is to come")
    assert ProxyHeader.of(data[: found.length]) == found
    assert ProxyHeader.of(data[: found.length - 1]) is None
    if found.client:
        assert str(ip_address(found.client)) == found.client
    return found


def spoilt_proxy_header(data, _rng, spoil):
    """As the octets are: it has no check sum, and fields at fixed places."""
    return spoil(data)


# Answers of a server, at a robot


def http_answers():
    problem = b'{"title": "No", "detail": "why not", "status": 403}'
    return [
        b"HTTP/1.1 200 OK\r\nContent-Length: 3\r\nDate: Sat, 21 Nov 2026 12:00:00 GMT\r\n\r\nabc",
        b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n3\r\nabc\r\n0\r\n\r\n",
        b"HTTP/1.1 202 Accepted\r\nRetry-After: 60\r\nContent-Length: 0\r\n\r\n",
        b"HTTP/1.1 304 Not Modified\r\nETag: x\r\n\r\n",
        b"HTTP/1.1 403 No\r\nContent-Type: application/problem+json\r\n"
        b"Content-Length: %d\r\n\r\n%s" % (len(problem), problem),
    ]


class Received:
    """What http.client reads of a connection."""

    def __init__(self, data):
        self._data = data

    def makefile(self, _mode):
        return BytesIO(self._data)


def take_http_answer(data):
    client = EstClient(server=f"https://{HOST}", trust=ServerTrust(frozenset({"0" * 64})))
    try:
        response = HTTPResponse(Received(data))
        response.begin()
        return client._answer(response)
    except ASKING_FAILS as error:
        raise client._unanswered(error) from None


def take_real_answer(data):
    """As above; the one that says no is real too."""
    try:
        return take_http_answer(data)
    except VerificationError as error:
        return error


TARGETS = {
    "http": (take_http, http_requests, spoilt_http),
    "http-answer": (take_real_answer, http_answers, spoilt_http),
    "est": (take_est, est_bodies, spoilt_est),
    "proxy-header": (take_proxy_header, proxy_headers, spoilt_proxy_header),
    "signer-call": (take_call, calls, spoilt_call),
}
"""{name: (what takes bytes, real bytes that it takes, how they are best spoilt)}"""
