"""A small server of pqsec's protocol in a thread, for tests of the robot: it trusts its tests."""

import hashlib
import io
import json
import subprocess
import sys
import threading
import traceback
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from OpenSSL import SSL

from pqsec_pki.certificates import CertificateRequest
from pqsec_pki.enrolment import Bundle
from pqsec_pki.est import (
    CERTIFICATE_HEADER,
    SCHEME,
    ServerTrust,
    peer_certificate,
    server_context,
    verify_signed,
)
from pqsec_pki.keystore import Keystore
from tests.unit.enrolling import answered
from tests.unit.killing import NOW
from tests.unit.tls_sides import HOST, identity, pin


class Incoming(io.RawIOBase):
    def __init__(self, tls):
        self.tls = tls

    def readable(self):
        return True

    def readinto(self, buffer):
        try:
            data = self.tls.recv(len(buffer))
        except SSL.Error:
            return 0
        buffer[: len(data)] = data
        return len(data)


class TlsSocket:
    """What http.server needs of a socket."""

    def __init__(self, context, connected):
        self.connected = connected
        self.tls = SSL.Connection(context, connected)
        self.tls.set_accept_state()

    def makefile(self, _mode, _buffering=-1):
        return io.BufferedReader(Incoming(self.tls))

    def sendall(self, data):
        self.tls.sendall(data)

    def end(self):
        with suppress(SSL.Error):
            self.tls.shutdown()
        self.connected.close()


class Server(ThreadingHTTPServer):
    """Its fields are what a test changes and looks at."""

    def __init__(self, keystore=None, shown=None):
        self.shown = shown or identity("ml-dsa-65")
        super().__init__((HOST, 0), Handler)
        self.keystore, self.now = keystore, NOW
        self.answers, self.receipts, self.seen = {}, [], []
        self.errors = []
        self.secrets, self.waiting, self.anybody = {}, 0, False
        self.reply = None
        """In place of an answer: bytes that are sent, or a function of (handler)."""

    @property
    def url(self):
        return f"https://{HOST}:{self.server_port}"

    @property
    def trust(self):
        return ServerTrust(pins=frozenset({pin(self.shown)}))

    def finish_request(self, request, client_address):
        stream = TlsSocket(server_context([self.shown]), request)
        try:
            stream.tls.do_handshake()
            self.RequestHandlerClass(stream, client_address, self)
        except SSL.Error:
            pass
        finally:
            stream.end()

    def handle_error(self, request, client_address):
        self.errors.append(traceback.format_exc())


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def log_message(self, *_):
        pass

    def do_GET(self):
        self.server.seen.append((self.command, self.path))
        self.body = b""
        if self.special():
            return
        name = self.caller()
        if not name:
            self.problem(401, "who are you")
            return
        keystore = Keystore.open(self.server.keystore.root)
        bundle = Bundle.of(keystore, [name], now=self.server.now, keys=False)
        tag = f'"{bundle.sha256}"'
        if self.headers["If-None-Match"] == tag:
            self.answer(304, b"", ETag=tag)
        else:
            self.answer(200, bundle.to_bytes(), ETag=tag)

    def do_POST(self):
        self.server.seen.append((self.command, self.path))
        self.body = self.rfile.read(int(self.headers["Content-Length"]))
        if self.special():
            return
        if self.path.endswith("receipts"):
            self.server.receipts.append(self.body)
            self.answer(204, b"")
            return
        digest = hashlib.sha256(self.body).hexdigest()
        request = CertificateRequest.from_pem(self.body)
        allowed = self.headers["Authorization"] in self.server.secrets or self.caller()
        allowed = allowed or self.server.anybody
        if not (allowed or digest in self.server.answers):
            self.problem(401, "this token is unknown or used up")
        elif self.server.waiting:
            self.server.waiting -= 1
            self.answer(202, b"", **{"Retry-After": "1"})
        else:
            if digest not in self.server.answers:
                keystore = Keystore.open(self.server.keystore.root, to_change=True)
                self.server.secrets.pop(self.headers["Authorization"], None)
                made = answered(keystore, request, now=self.server.now)
                self.server.answers[digest] = made.to_bytes()
            self.answer(200, self.server.answers[digest])

    def special(self):
        reply = self.server.reply
        if callable(reply):
            return reply(self)
        if reply is not None:
            self.wfile.write(reply)
            self.close_connection = True
        return reply is not None

    def caller(self):
        scheme, _, signatures = (self.headers["Authorization"] or "").partition(" ")
        if scheme == SCHEME:
            found = verify_signed(
                self.request.tls,
                method=self.command,
                path=self.path,
                body=self.body,
                certificates=self.headers.get_all(CERTIFICATE_HEADER),
                signatures=signatures,
            )
        else:
            found = peer_certificate(self.request.tls)
        return found and found.subject_name.removeprefix("CN=")

    def problem(self, status, detail):
        body = json.dumps({"title": "refused", "detail": detail}).encode()
        self.answer(status, body, **{"Content-Type": "application/problem+json"})

    def answer(self, status, body, **headers):
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)


@contextmanager
def serving(keystore=None, shown=None):
    """A server that runs as long as the block."""
    server = Server(keystore, shown)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
    assert server.errors == []


@contextmanager
def serving_outside(root):
    """URL and trust of such a server in a process of its own, which issues to anybody."""
    command = [sys.executable, "-m", __name__, str(root)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            url, found = process.stdout.readline().split()
            yield url, ServerTrust(pins=frozenset({found}))
        finally:
            process.kill()


if __name__ == "__main__":
    with serving(Keystore.open(Path(sys.argv[1]))) as own:
        own.anybody = True
        print(own.url, pin(own.shown), flush=True)
        threading.Event().wait()
