"""The client against servers that do what they should not."""

import socket
import ssl
import threading
from contextlib import contextmanager, suppress
from datetime import timedelta

import pytest
from OpenSSL import SSL

from pqsec_pki.errors import PqsecError, VerificationError
from pqsec_pki.est import EstClient, ServerTrust, client, server_context
from tests.unit.est_server import serving
from tests.unit.tls_sides import HOST, certificate, identity, pin

PATH = "/pqsec/v1/bundle"


@pytest.fixture(scope="module")
def shown():
    return identity("ecdsa-p256")


@pytest.fixture
def server(shown):
    with serving(shown=shown) as running:
        yield running


def asking(server, **changes):
    return EstClient(**{"server": server.url, "trust": server.trust, **changes})


def replies(server, *parts, headers=(), status="200 OK"):
    lines = [f"HTTP/1.1 {status}", *headers, "", ""]
    server.reply = "\r\n".join(lines).encode() + b"".join(parts)


def test_an_answer_comes_whole(server):
    replies(
        server,
        b"x" * 100_000,
        headers=["Content-Length: 100000", "Date: Sat, 21 Nov 2026 12:00:00 GMT"],
    )
    answer = asking(server).get(PATH)
    assert answer.body == b"x" * 100_000
    assert answer.date.isoformat() == "2026-11-21T12:00:00+00:00"


def test_chunks_are_read_too(server):
    chunked = b"5\r\nabcde\r\n3\r\nfgh\r\n0\r\n\r\n"
    replies(server, chunked, headers=["Transfer-Encoding: chunked"])
    assert asking(server).get(PATH).body == b"abcdefgh"


def test_what_is_sent_is_what_the_server_gets(server):
    got = []

    def look(handler):
        got.append((handler.headers["Authorization"], handler.headers["Host"], handler.body))
        handler.answer(204, b"")
        return True

    server.reply = look
    body = bytes(200_000)
    asking(server, secret=("abc", "geheim")).post(PATH, body, "x/y")
    assert got == [("Basic YWJjOmdlaGVpbQ==", server.url.removeprefix("https://"), body)]


CUT = [
    (b"", []),
    (b"HTTP/1.1", None),
    (b"abc", ["Content-Length: 100"]),
    (b"5\r\nab", ["Transfer-Encoding: chunked"]),
    (b"zz\r\nab", ["Transfer-Encoding: chunked"]),
    (b"\x00" * 100, None),
    (b"SSH-2.0-OpenSSH\r\n", None),
]


@pytest.mark.parametrize(("body", "headers"), CUT)
def test_a_broken_answer_is_told(server, body, headers):
    if headers:
        replies(server, body, headers=headers)
    else:
        server.reply = body
    with pytest.raises(PqsecError, match="cannot reach https://") as refused:
        asking(server).get(PATH)
    assert "stays as it is" in refused.value.hint


@pytest.mark.parametrize("endless", ["Content-Length: 99999999999", "X: y"])
def test_an_answer_that_is_too_large_is_not_read(server, endless, monkeypatch):
    monkeypatch.setattr(client, "MAX_ANSWER", 1 << 16)
    replies(server, bytes(1 << 20), headers=[endless])
    with pytest.raises(PqsecError, match=r"more than 65536 bytes"):
        asking(server).get(PATH)


def test_many_and_long_headers_are_refused(server):
    for headers in (["A: b"] * 200, ["A: " + "b" * 100_000]):
        replies(server, headers=headers)
        with pytest.raises(PqsecError, match="cannot reach"):
            asking(server).get(PATH)


@pytest.mark.parametrize("status", ["301 Moved", "302 Found", "307 Temporary", "308 Permanent"])
def test_a_redirect_is_not_followed(server, status):
    replies(
        server, headers=[f"Location: {server.url}/elsewhere", "Content-Length: 0"], status=status
    )
    with pytest.raises(PqsecError, match="redirects are not followed"):
        asking(server).post(PATH, b"secret", "x/y")
    assert [path for _, path in server.seen] == [PATH]


@pytest.mark.parametrize(
    ("status", "code"), [(401, 1), (403, 1), (404, 1), (409, 1), (429, 3), (503, 3)]
)
def test_what_the_server_says_is_told_without_control_characters(server, status, code):
    def refuse(handler):
        handler.problem(status, "not \x1b[31m now" + "x" * 1000)
        return True

    server.reply = refuse
    with pytest.raises(PqsecError, match=r"says: refused: not \\u001b\[31m now") as refused:
        asking(server).get(PATH)
    assert refused.value.exit_code == code
    assert len(str(refused.value)) < 400


@pytest.mark.parametrize("body", [b"", b"[]", b"[" * 10_000, b"\xff", b'{"title": 5}', b"null"])
def test_problem_details_that_are_none(server, body):
    def refuse(handler):
        handler.answer(403, body, **{"Content-Type": "application/problem+json"})
        return True

    server.reply = refuse
    with pytest.raises(VerificationError, match=r"answers 403"):
        asking(server).get(PATH)


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("5", 5), ("0", 1), ("", 60), ("soon", 60), ("9" * 50, 60), ("86400", 3600), ("-3", 60)],
)
def test_when_to_come_again_has_limits(server, text, seconds):
    replies(server, headers=["Content-Length: 0", f"Retry-After: {text}"], status="202 Accepted")
    assert asking(server).post(PATH, b"", "x/y").retry_after == timedelta(seconds=seconds)


def test_a_server_that_is_not_pinned_gets_no_secret(server):
    other = ServerTrust(pins=frozenset({"0" * 64}))
    with pytest.raises(VerificationError, match="not a pinned one"):
        asking(server, trust=other, secret=("a", "b")).get(PATH)
    assert server.seen == []


def test_no_proxy_is_asked(server, monkeypatch):
    for name in ("https_proxy", "HTTPS_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.setenv(name, "http://127.0.0.1:9")
    replies(server, headers=["Content-Length: 0"])
    assert asking(server).get(PATH).status == 200


def test_nobody_there_is_told():
    with socket.socket() as free:
        free.bind((HOST, 0))
        url = f"https://{HOST}:{free.getsockname()[1]}"
        with pytest.raises(PqsecError, match=r"cannot reach .*: connection refused") as refused:
            EstClient(server=url, trust=ServerTrust(pins=frozenset({"0" * 64}))).get(PATH)
    assert refused.value.exit_code == 3


@contextmanager
def slow(shown, *, handshake):
    """A server that says one byte after the other, in TLS or before it."""
    listening, done = socket.create_server((HOST, 0)), threading.Event()

    def drip():
        connected, _ = listening.accept()
        side = connected
        if handshake:
            side = SSL.Connection(server_context([shown]), connected)
            side.set_accept_state()
            side.do_handshake()
        with connected:
            for byte in b"HTTP/1.1 200 OK\r\n" + b"A: b\r\n" * 1000:
                if done.wait(0.05):
                    return
                try:
                    side.send(bytes([byte]) if handshake else b"\x16")
                except (OSError, SSL.Error):
                    return

    thread = threading.Thread(target=drip)
    thread.start()
    with listening:
        yield f"https://{HOST}:{listening.getsockname()[1]}"
        done.set()
        thread.join()


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("handshake", [True, False])
def test_a_server_that_drips_holds_nobody_beyond_the_limit(shown, handshake, monkeypatch):
    monkeypatch.setattr(client, "AGREEING", 1.0)
    monkeypatch.setattr(client, "ANSWERING", 0.5)
    trust = ServerTrust(pins=frozenset({pin(shown)}))
    with (
        slow(shown, handshake=handshake) as url,
        pytest.raises(PqsecError, match="cannot reach"),
    ):
        EstClient(server=url, trust=trust).get(PATH)


CONTINUE = b"HTTP/1.1 100 Continue\r\n\r\n"
CHUNKED = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"


@pytest.mark.slow(but=1)
@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    ("begin", "piece"),
    [(b"", CONTINUE), (CHUNKED, b"1\r\na\r\n"), (CHUNKED + b"0\r\n", b"X: y\r\n")],
)
def test_a_server_that_never_pauses_holds_nobody_beyond_the_limit(
    server, monkeypatch, begin, piece
):
    """There was always something to read: nobody looked at the clock."""

    def flood(handler):
        with suppress(SSL.Error):
            handler.wfile.write(begin)
            while True:
                handler.wfile.write(piece * 1000)
        return True

    server.reply = flood
    monkeypatch.setattr(client, "ANSWERING", 0.5)
    # From 3.14 on Python's own client counts interim answers and trailers.
    with pytest.raises(PqsecError, match=r"it takes too long|got more than"):
        asking(server).get(PATH)


def test_the_secret_is_in_no_repr():
    made = EstClient(
        server="https://a", trust=ServerTrust(frozenset({"0" * 64})), secret=("id", "geheim")
    )
    assert "geheim" not in repr(made)


@contextmanager
def classical_server(place):
    """A server of Python's ssl module, which has no GROUP on Debian 12; it says yes once."""
    chain, key = certificate("ecdsa-p256")
    for name, data in (("chain.pem", chain), ("key.pem", key)):
        (place / name).write_bytes(data)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(place / "chain.pem", place / "key.pem")
    context.set_ecdh_curve("prime256v1")
    listening, asked = socket.create_server((HOST, 0)), []

    def serve():
        connected, _ = listening.accept()
        with suppress(OSError), context.wrap_socket(connected, server_side=True) as tls:
            asked.append(tls.recv(1 << 16))
            tls.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 3\r\n\r\nyes")

    thread = threading.Thread(target=serve)
    thread.start()
    with listening:
        yield f"https://{HOST}:{listening.getsockname()[1]}", asked
        thread.join()


def test_a_server_without_post_quantum_key_agreement_gets_no_secret(shown, place):
    trust, secret = ServerTrust(pins=frozenset({pin(shown)})), ("a", "geheim")
    refused = pytest.raises(VerificationError, match="not on X25519MLKEM768")
    with classical_server(place) as (url, asked), refused:
        EstClient(server=url, trust=trust, secret=secret).get(PATH)
    assert asked in ([], [b""])
    with classical_server(place) as (url, asked):
        answer = EstClient(server=url, trust=trust, secret=secret, classical=True).get(PATH)
    assert answer.body == b"yes"
    assert b"Authorization: Basic " in asked[0]
