"""A server that runs, its domain, and a client that sends what it is told."""

import base64
import http.client
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager, suppress
from copy import copy
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from typing import NamedTuple

from OpenSSL import SSL

from pqsec_pki.certificates import Certificate
from pqsec_pki.domain import create_keystore, read_domain
from pqsec_pki.enrolment import Bundle, pins_in_use, request
from pqsec_pki.est import EnrolmentToken, ServerTrust, TlsIdentity, client_context, spki_pin
from pqsec_pki.keystore import Keystore
from pqsec_pki.server import read_settings, record_token
from tests.ports import free_port
from tests.running import clean_environment, measured_too, run_here
from tests.unit.tls_sides import certificate

ROOT = Path(__file__).parents[2]
HOST = "127.0.0.1"
PATIENCE = 60
HOUR = timedelta(hours=1)
DOMAIN = """
name: Lab
profile: {profile}
validity: 90d
roles:
  robot: {{publish: [rt$name/pose], subscribe: [rt/cmd]}}
groups: {{fleet: ["/fleet/*"], other: [/other]}}
participants:
  - {{name: "/fleet/r{{1..3}}", role: robot, request: requests/}}
  - {{name: /other, role: robot, request: requests/}}
  - {{name: /local, role: robot}}
  - {{name: /ordered, role: robot, order: orders/}}
"""


def make(folder, profile, now, robots):
    """A domain file, and its keystore."""
    domain = DOMAIN.format(profile=profile).replace("1..3", f"1..{robots}")
    (folder / "domain.yaml").write_text(domain)
    desired = read_domain(folder / "domain.yaml")
    create_keystore(desired, folder / "k", passphrase=None, now=now)
    run_here(["-k", "k", "apply", "domain.yaml", "--yes"], cwd=folder, env=clean_environment())


@cache
def made_once(profile, robots):
    """A folder with both, to be copied, not changed; it lasts as long as this process."""
    folder = tempfile.TemporaryDirectory()
    make(Path(folder.name), profile, datetime.now(UTC) - HOUR, robots)
    return folder


class Reply(NamedTuple):
    """An answer."""

    status: int
    headers: dict
    body: bytes

    @property
    def detail(self):
        return json.loads(self.body)["detail"]


class Server:
    """`pqsec serve` in a folder, with the clock of the machine."""

    def __init__(self, folder, now, profile="pq", *, robots=3, **settings):
        self._in(folder)
        self.create(profile, now, robots)
        pairs = [certificate(kind, since=now) for kind in ("ml-dsa-65", "ecdsa-p256")]
        for number, (chain, key) in enumerate(pairs):
            (folder / f"{number}.pem").write_bytes(chain)
            (folder / f"{number}.key").write_bytes(key)
        self.configure(**settings)

    def _in(self, folder):
        self.folder, self.port, self.status_port = folder, free_port(), free_port()
        self.root, self.config, self.process = folder / "k", folder / "serve.yaml", None

    def second(self, folder, **settings):
        """A second server: with a copy of everything, or of all but the keystore that is named."""
        made = copy(self)
        shutil.copytree(self.folder, folder, symlinks=True)
        made._in(folder)
        made.root = Path(settings.get("keystore", made.root))
        made.configure(**settings)
        return made

    def create(self, profile, now, robots=3):
        """Make the domain and its keystore: a copy of one, unless it is of another time."""
        if datetime.now(UTC) - now < HOUR:
            made = made_once(profile, robots).name
            shutil.copytree(made, self.folder, symlinks=True, dirs_exist_ok=True)
        else:
            make(self.folder, profile, now, robots)

    def configure(self, **settings):
        value = {
            "url": f"https://{HOST}:{self.port}",
            "listen": [f"{HOST}:{self.port}"],
            "status": f"{HOST}:{self.status_port}",
            "keystore": "k",
            "domain": "domain.yaml",
            "tls": [{"chain": f"{n}.pem", "key": f"{n}.key"} for n in (0, 1)],
            **settings,
        }
        self.config.write_text(json.dumps(value))

    @property
    def keystore(self):
        return Keystore.open(self.root)

    def bundle(self, name):
        """The bundle of a participant, as the keystore has it now."""
        return Bundle.of(self.keystore, [name], now=datetime.now(UTC))

    def cli(self, *words, check=True):
        """A command in its folder, in this process."""
        given = clean_environment(PQSEC_KEYSTORE=str(self.root))
        done = subprocess.CompletedProcess(words, *run_here(words, cwd=self.folder, env=given))
        assert not check or done.returncode == 0, done.stderr
        return done

    def token(self, names, *, uses=1, replaces=False, validity=timedelta(hours=1)):
        """A new token, as `pqsec enrolment-token create` makes it."""
        settings, now = read_settings(self.config), datetime.now(UTC)
        keystore = Keystore.open(self.root, to_change=True)
        made = EnrolmentToken.new(
            server=settings.url,
            server_pins=self.pins(),
            cas=pins_in_use(keystore),
            names=names,
            profile=keystore.profile.name,
            not_after=now + validity,
        )
        record_token(keystore, made, uses=uses, replaces=replaces, now=now)
        return made

    @contextmanager
    def running(self, *, measured=False):
        self.start(measured=measured)
        try:
            yield self
        finally:
            self.stop()

    @property
    def command(self):
        """What runs it."""
        return [sys.executable, "-P", "-m", "pqsec_pki", "serve", "--config", str(self.config)]

    def start(self, *, cwd=None, measured=False):
        """Start it. If it is measured, for coverage, its start takes more than twice as long."""
        given = {**os.environ, **(measured_too() if measured else {})}
        with (self.folder / "log").open("ab") as log:
            self.process = subprocess.Popen(
                self.command, stderr=log, stdout=log, env=given, start_new_session=True, cwd=cwd
            )
        until = time.monotonic() + PATIENCE
        while self.page("/readyz") != 200:
            if self.process.poll() is not None or time.monotonic() > until:
                self.kill()
                raise AssertionError(self.log)
            time.sleep(0.05)

    def stop(self):
        """Stop it; returns its exit code."""
        with suppress(ProcessLookupError):
            self.process.send_signal(signal.SIGTERM)
        return self.process.wait(PATIENCE)

    def reload(self):
        """Have both processes read `serve.yaml` again."""
        self.process.send_signal(signal.SIGHUP)

    def kill(self):
        """Kill both processes, as a power cut does."""
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait(PATIENCE)

    @property
    def log(self):
        return (self.folder / "log").read_text()

    def page(self, path, *, text=False):
        """The status, or the text, of a page about its health; 0 if it does not answer."""
        link = http.client.HTTPConnection(HOST, self.status_port, timeout=PATIENCE)
        try:
            link.request("GET", path)
            found = link.getresponse()
            return found.read().decode() if text else found.status
        except (OSError, http.client.HTTPException):
            return 0
        finally:
            link.close()

    @contextmanager
    def connect(self, identity=None, *, source=HOST, classical=False, before=b""):
        """A connection after the handshake; `before` is sent before it, as a balancer does."""
        trust = ServerTrust(pins=self.pins())
        context = client_context(trust, HOST, identity, classical=classical)
        with socket.create_connection((HOST, self.port), PATIENCE, (source, 0)) as plain:
            plain.settimeout(None)
            plain.sendall(before)
            link = SSL.Connection(context, plain)
            link.set_connect_state()
            link.do_handshake()
            yield link

    def pins(self):
        chains = (self.folder / "0.pem", self.folder / "1.pem")
        return frozenset(spki_pin(Certificate.from_pem(each.read_bytes())) for each in chains)

    def send(  # noqa: PLR0913 -- by name
        self,
        method,
        path,
        body=b"",
        *,
        identity=None,
        token=None,
        source=HOST,
        before=b"",
        **headers,
    ):
        """The answer to one request on a connection of its own."""
        named = {"Host": HOST, "Connection": "close"}
        if method == "POST":
            named["Content-Length"] = str(len(body))
        if token:
            named["Authorization"] = basic(token)
        named |= {key.replace("_", "-"): value for key, value in headers.items()}
        lines = [f"{method} {path} HTTP/1.1", *(f"{key}: {value}" for key, value in named.items())]
        with self.connect(identity, source=source, before=before) as link:
            link.sendall("\r\n".join([*lines, "", ""]).encode() + body)
            return reply_in(received(link))

    def post(self, path, body, media_type, **options):
        return self.send("POST", path, body, Content_Type=media_type, **options)

    def ask(self, made, **options):
        """The answer to a request for a bundle."""
        return self.post("/pqsec/v1/requests", made.pem, "application/x-pem-file", **options)


def basic(token):
    return "Basic " + base64.b64encode(f"{token.id}:{token.secret}".encode()).decode()


def received(link):
    """All that comes until the connection is closed."""
    found = b""
    while True:
        try:
            found += link.recv(1 << 16)
        except (SSL.ZeroReturnError, SSL.SysCallError, ConnectionError):
            return found


def reply_in(data):
    head, _, body = data.partition(b"\r\n\r\n")
    first, *lines = head.decode().split("\r\n")
    pairs = (line.split(": ", 1) for line in lines)
    return Reply(int(first.split()[1]), {key.lower(): value for key, value in pairs}, body)


class Robot:
    """A robot's folder, with its newest request and what it was given."""

    def __init__(self, server, folder, name="/fleet/r1"):
        self.server, self.root, self.name = server, Path(folder), name
        self.new()

    def new(self):
        """Make new keys and a request for them."""
        made = request(self.name, self.server.keystore.profile, self.root, force=True)
        self.request, self.key = made.request, (made.path.parent / "key.pem").read_bytes()
        return self.request

    def identity(self, bundle):
        """What it shows in TLS: the certificate of that bundle, with the newest key."""
        return TlsIdentity.of(bundle.enclaves[self.name]["cert.pem"], self.key)
