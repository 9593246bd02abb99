"""The server among clients that mean harm, and when it is killed: honest robots are served."""

import os
import pwd
import resource
import shutil
import signal
import socket
import stat
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID
from OpenSSL import SSL

from pqsec_pki.errors import FileError
from pqsec_pki.est import TlsIdentity
from pqsec_pki.server import read_settings
from pqsec_pki.server.configuration import ServerLimits
from pqsec_pki.server.limiting import Connections
from pqsec_pki.server.running import notify
from pqsec_pki.server.signer import listening
from pqsec_pki.server.state_folder import make_state
from tests.some_keys import some_key
from tests.unit.serving import HOST, PATIENCE, Robot, Server, received, reply_in
from tests.unit.tls_sides import certificate

ENEMY = "127.0.0.66"
TLS_FEATURE = x509.ObjectIdentifier("1.3.6.1.5.5.7.1.24")
LIMITS = {
    "seconds": 2,
    "body": 20_000,
    "connections_of_address": 20,
    "requests_of_address": 60,
}

PEM_TYPE = b"Content-Type: application/x-pem-file\r\n"


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    made = Server(tmp_path_factory.mktemp("serve"), datetime.now(UTC), limits=LIMITS)
    with made.running(measured=True):
        yield made


def counted(server, event):
    for line in server.page("/metrics", text=True).splitlines():
        if f'"{event}"' in line:
            return int(line.split()[-1])
    return 0


def until(question):
    """Wait until the answer is yes."""
    end = time.monotonic() + PATIENCE
    while not question() and time.monotonic() < end:
        time.sleep(0.05)
    assert question()


def test_connections_that_send_nothing_hold_nobody_up(server):
    before = counted(server, "too-many")
    with ExitStack() as stack:
        for _ in range(200):
            link = stack.enter_context(socket.socket())
            link.bind((ENEMY, 0))
            link.connect((HOST, server.port))
        assert server.send("GET", "/pqsec/v1/head").status == 200
        until(lambda: counted(server, "too-many") >= before + 180)
        until(lambda: counted(server, "late") >= 20)  # they are closed, although others wait
        assert server.send("GET", "/pqsec/v1/head", source=ENEMY).status == 200


@pytest.mark.parametrize(
    "said", [b"GET /pqsec", b"POST /pqsec/v1/requests HTTP/1.1\r\nHost: x\r\n"]
)
def test_a_request_that_comes_octet_by_octet_is_cut_off(server, said):
    before = counted(server, "late")
    with server.connect(source=ENEMY) as link:
        link.sendall(said)
        with suppress(SSL.Error, OSError):
            for _ in range(100):
                link.sendall(b"a")
                time.sleep(0.1)
    assert counted(server, "late") > before


@pytest.mark.parametrize(
    ("lines", "status"),
    [
        (["Content-Length: 1000000000"], 413),
        (["Content-Length: 20001"], 413),
        (["Transfer-Encoding: chunked"], 411),
        (["Content-Length: -1"], 400),
        (["Content-Length: 5", "Content-Length: 5"], 400),
        (["Content-Length: 5", "Transfer-Encoding: chunked"], 400),
        (["X: " + "a" * 20_000], None),
        (["A: b"] * 100, 400),
        (["no colon"], 400),
    ],
)
def test_a_header_decides_before_a_body_is_read(server, lines, status):
    first = ["POST /pqsec/v1/requests HTTP/1.1", "Host: x", "Content-Type: application/pkcs10"]
    with server.connect() as link, suppress(SSL.SysCallError):
        link.sendall("\r\n".join([*first, *lines, "", ""]).encode())
        found = received(link)
        assert (reply_in(found).status if found else None) == status


@pytest.mark.parametrize(
    "sent",
    [
        b"Content-Length: 20001\r\n\r\n" + b"x" * 20_001,
        b"Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n",
    ],
)
def test_a_refused_request_that_is_complete_keeps_no_connection_open(server, sent):
    with server.connect() as link:
        link.sendall(b"POST /pqsec/v1/requests HTTP/1.1\r\nHost: x\r\n" + sent)
        until(lambda: "pqsec_serve_connections 0\n" in server.page("/metrics", text=True))


@pytest.mark.parametrize(
    ("name", "status"), [(b"Authorization", 400), (b"Content-Type", 415), (b"If-None-Match", 415)]
)
def test_a_header_that_is_not_utf8_is_answered(server, name, status):
    """Twisted's headers are UTF-8 for it: it raised, and the connection was lost."""
    known = b"" if name == b"Content-Type" or status == 415 else PEM_TYPE
    with server.connect() as link:
        head = b"POST /pqsec/v1/requests HTTP/1.1\r\nHost: x\r\nConnection: close\r\n" + known
        link.sendall(head + b"Content-Length: 1\r\n" + name + b": \xff\r\n\r\nx")
        assert reply_in(received(link)).status == status


def test_a_client_certificate_that_only_openssl_reads_is_refused_in_words(server):
    _, key = certificate("ecdsa-p256", since=datetime.now(UTC))
    feature = x509.UnrecognizedExtension(TLS_FEATURE, bytes.fromhex("3003020104"))  # an unknown one
    shown = TlsIdentity.of(certificate_with(feature), key)
    reply = server.send("GET", "/pqsec/v1/bundle", identity=shown)
    assert (reply.status, "not a certificate" in reply.detail) == (400, True), reply
    assert "internal error" not in server.log


def certificate_with(extension):
    """A certificate in PEM of the key of `certificate`, by itself, with that extension."""
    key, now = some_key("ecdsa-p256", "server").handle, datetime.now(UTC)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "server")])
    made = (
        x509.CertificateBuilder(name, name, key.public_key(), 5, now, now + timedelta(9))
        .add_extension(extension, critical=False)
        .sign(key, hashes.SHA256())
    )
    return made.public_bytes(Encoding.PEM)


def test_the_front_runs_no_code_of_the_folder_where_the_server_is_started(tmp_path):
    """A user who could write there got the rights of the front's user, who may be the signer's."""
    server, others = Server(tmp_path, datetime.now(UTC), "classical"), tmp_path / "others"
    others.mkdir()
    (others / "twisted.py").write_text("raise SystemExit(7)")
    try:
        server.start(cwd=others)
    finally:
        server.stop()
    assert server.process.returncode == 0


def test_no_process_of_the_server_leaves_its_keys_in_a_core_file(server):
    pid = server.process.pid
    for each in (pid, *children(pid)):
        assert resource.prlimit(int(each), resource.RLIMIT_CORE) == (0, 0)


def children(pid):
    return Path(f"/proc/{pid}/task/{pid}/children").read_text().split()


def sockets_of(pid):
    """The names of its Unix sockets; those of abstract ones begin with @."""
    names = {}
    for line in Path("/proc/net/unix").read_text().splitlines()[1:]:
        parts = line.split()
        names |= {f"socket:[{parts[6]}]": parts[7]} if len(parts) > 7 else {}
    opened = set()
    for each in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(FileNotFoundError):  # closed meanwhile
            opened.add(str(each.readlink()))
    return [names[each] for each in opened if each in names]


def test_no_process_of_the_server_hears_who_may_not_write_to_its_sockets(tmp_path):
    """By an abstract one, which has no permissions, any local user kept the front from starting."""
    server = Server(tmp_path, datetime.now(UTC), "classical")
    with server.running():
        pid = server.process.pid
        found = {each for one in (pid, *children(pid)) for each in sockets_of(one)}
        modes = {stat.S_IMODE(Path(each).stat().st_mode) for each in found if each[0] == "/"}
    assert found == {f"{tmp_path}/state/{name}.sock" for name in ("front", "signer")}
    assert modes == {0o600}
    assert sorted(each.name for each in (tmp_path / "state").iterdir()) == []


def test_strangers_use_up_the_limit_of_a_label_for_strangers_only(tmp_path):
    home = "127.0.0.5"
    limits = {"requests_of_label": 3}
    server = Server(tmp_path, datetime.now(UTC), "classical", limits=limits)
    with server.running():
        robot = Robot(server, tmp_path / "robot")
        asked = server.ask(robot.request, token=server.token("/fleet/r1"), source=home)
        assert asked.status == 200
        strangers = [server.send("GET", "/pqsec/v1/head", source=ENEMY).status for _ in range(9)]
        assert 429 in strangers
        assert server.ask(robot.request, source=home).status == 401


def test_too_many_requests_are_refused_for_their_address_only(server, tmp_path):
    sent = 1
    # A slow machine sends more of them: the limit is one for each second.
    while (refused := server.send("GET", "/nothing", source="127.0.0.77")).status == 404:
        sent += 1
    assert (refused.status, sent > 50) == (429, True)
    assert int(refused.headers["retry-after"]) >= 1
    reply = server.ask(Robot(server, tmp_path).request, token=server.token("/fleet/r1"))
    assert reply.status == 200


def test_who_connects_too_often_is_not_heard_any_more():
    """Each connection is a handshake of TLS for the server."""
    connections = Connections(ServerLimits(requests_of_address=2))
    assert [connections.admits(ENEMY) for _ in range(5)] == [True] * 4 + [False]
    assert connections.admits(HOST)


def test_connections_of_a_unix_socket_have_their_number_back_when_they_are_closed():
    """Such a socket has no address: after 50 connections nobody was served."""
    connections = Connections(ServerLimits(connections_of_address=1, connections=1))
    for _ in range(3):
        assert connections.admits("")
        connections.opened("one", "")
        connections.idle("one")
        assert not connections.admits("")
        connections.busy("one")
        assert connections.to_close() is None
        connections.idle("one")
        assert connections.to_close() == "one"
    assert connections.total == 0


def test_a_stolen_token_gives_nothing_after_the_robot(server, tmp_path):
    robot, token = Robot(server, tmp_path / "a", "/fleet/r2"), server.token("/fleet/r2")
    assert server.ask(robot.request, token=token).status == 200
    thief = Robot(server, tmp_path / "b", "/fleet/r2")
    other, unrooted = server.token("/fleet/*", uses=2), server.token("r*")  # that is /r*
    head = server.keystore.head
    assert server.ask(thief.request, token=token, source=ENEMY).status == 401
    refused = server.ask(thief.request, token=other, source=ENEMY)
    assert (refused.status, "must be made with --replace" in refused.detail) == (409, True)
    assert server.ask(Robot(server, tmp_path / "c", "/other").request, token=other).status == 403
    assert server.ask(thief.request, token=unrooted, source=ENEMY).status == 403
    assert server.keystore.head == head


def test_one_use_is_one_use_for_all_at_once(server, tmp_path):
    token, done = server.token("/fleet/r3"), []
    robots = [Robot(server, tmp_path / str(each), "/fleet/r3") for each in range(6)]
    threads = [
        threading.Thread(target=lambda r=each: done.append(server.ask(r.request, token=token)))
        for each in robots
    ]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    statuses = sorted(each.status for each in done)
    assert statuses[0] == 200
    assert set(statuses[1:]) <= {401, 503}


def test_a_new_configuration_leaves_open_connections_alone(tmp_path):
    made = Server(tmp_path, datetime.now(UTC))
    with made.running(measured=True), made.connect() as link:
        domain = tmp_path / "domain.yaml"
        domain.write_text(domain.read_text().replace("r{1..3}", "r{1..9}"))
        made.process.send_signal(signal.SIGHUP)
        until(lambda: made.log.count("the configuration was read again") == 2)
        link.sendall(b"GET /pqsec/v1/head HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n")
        assert reply_in(received(link)).status == 200
        robot = Robot(made, tmp_path / "robot", "/fleet/r9")
        assert made.ask(robot.request, token=made.token("/fleet/r9")).status == 200
        domain.write_text("not: a domain")
        made.process.send_signal(signal.SIGHUP)
        until(lambda: "the configuration is not changed" in made.log)
        assert made.ask(robot.request, token=made.token("/fleet/r9", replaces=True)).status == 200
    assert made.process.returncode == 0


@pytest.mark.parametrize(("how", "code"), [(signal.SIGTERM, 0), (signal.SIGKILL, 3)])
def test_a_front_that_was_asked_to_end_is_no_error(tmp_path, how, code):
    """systemd asks all processes of a service to end, and the front is often quicker."""
    made = Server(tmp_path, datetime.now(UTC), "classical")
    made.start()
    pid = made.process.pid
    [front] = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    os.kill(int(front), how)
    assert made.process.wait(PATIENCE) == code, made.log


def test_a_front_ends_with_its_killed_signer_and_the_next_server_can_listen(tmp_path):
    """As when memory runs out. It would keep the port, and keys of TLS."""
    made = Server(tmp_path, datetime.now(UTC), "classical")
    made.start()
    pid = made.process.pid
    [front] = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    made.process.kill()
    made.process.wait(PATIENCE)
    until(lambda: not Path(f"/proc/{front}").exists())
    made.start()
    assert made.stop() == 0


def test_the_front_of_another_user_may_ask_whatever_the_umask_is(tmp_path):
    front = pwd.getpwnam("nobody")
    settings = Server(tmp_path, datetime.now(UTC), "classical", front_user=front.pw_name).config
    before = os.umask(0o077)
    try:
        make_state(read_settings(settings))
        listening(tmp_path / "state/signer.sock", front.pw_name).close()
    finally:
        os.umask(before)
    found = [(tmp_path / "state" / each).stat() for each in (".", "signer.sock")]
    assert [stat.S_IMODE(each.st_mode) for each in found] == [0o750, 0o660]
    own = front.pw_gid if os.geteuid() == 0 else os.getegid()
    assert [each.st_gid for each in found] == [own, own]


def test_requests_do_not_wait_where_others_may_write(tmp_path):
    """A pipe there, named as a request, stopped the signer for ever."""
    made = Server(tmp_path, datetime.now(UTC), "classical", requests="shared")
    (tmp_path / "shared").mkdir()
    (tmp_path / "shared").chmod(0o777)
    with pytest.raises(FileError, match="requests cannot wait there: anybody may write there"):
        make_state(read_settings(made.config))


def test_rights_that_the_domain_file_takes_do_not_come_back_with_a_renewal(tmp_path):
    made = Server(tmp_path, datetime.now(UTC), renew="any-time")
    with made.running():
        robot = Robot(made, tmp_path / "robot", "/fleet/r1")
        assert made.ask(robot.request, token=made.token("/fleet/r1")).status == 200
        identity = robot.identity(made.bundle("/fleet/r1"))
        domain = tmp_path / "domain.yaml"
        domain.write_text(domain.read_text().replace(", subscribe: [rt/cmd]", ""))
        assert made.ask(robot.new(), identity=identity).status == 200
        permissions = made.bundle("/fleet/r1").enclaves["/fleet/r1"]["permissions.p7s"]
        assert (b"rt/fleet" in permissions, b"rt/cmd" in permissions) == (True, False)


def test_the_process_that_faces_the_network_gets_no_password(tmp_path, monkeypatch):
    monkeypatch.setenv("PGPASSWORD", "secret of the database")
    with Server(tmp_path, datetime.now(UTC)).running() as made:
        children = Path(f"/proc/{made.process.pid}/task/{made.process.pid}/children").read_text()
        found = [Path(f"/proc/{each}/environ").read_bytes() for each in children.split()]
    assert found
    assert not any(b"secret of the database" in each for each in found)


@pytest.mark.slow
@pytest.mark.parametrize("moment", [0.01, 0.05, 0.1, 0.2])
def test_after_a_kill_the_same_request_has_one_answer(tmp_path, moment):
    made = Server(tmp_path, datetime.now(UTC))
    made.start()
    robot, token = Robot(made, tmp_path / "robot"), made.token("/fleet/r1")

    def ask():
        with suppress(SSL.Error, OSError, ValueError, IndexError):
            made.ask(robot.request, token=token)

    asking = threading.Thread(target=ask)
    asking.start()
    time.sleep(moment)
    made.kill()
    asking.join()
    with made.running():
        replies = [made.ask(robot.request, token=token) for _ in range(2)]
        assert [each.status for each in replies] == [200, 200]
        assert replies[0].headers["etag"] == replies[1].headers["etag"]
    lines = [each for each in made.keystore.ledger() if each.name == "/fleet/r1"]
    assert [each.kind for each in lines] == ["participant", "permissions"]


@pytest.mark.parametrize("name", ["notify", "pqsec@site", "@pqsec@{}"])
def test_readiness_is_told_at_the_socket_that_is_named(tmp_path, name):
    """With an `@` in its path the front was taken for one that does not listen."""
    name = name.format(os.getpid())
    path = name if name.startswith("@") else str(tmp_path / name)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notices:
        notices.bind(f"\0{path[1:]}" if path.startswith("@") else path)
        notices.settimeout(0)
        notify("READY=1", {"NOTIFY_SOCKET": path})
        assert notices.recv(100) == b"READY=1"


def test_two_services_share_a_socket_that_systemd_made(tmp_path):
    made = Server(tmp_path, datetime.now(UTC))
    command = [sys.executable, "-m", "pqsec_pki", "serve", "--config", str(made.config), "--part"]
    handed = 'exec 3<&"$0"; LISTEN_PID=$$ LISTEN_FDS=1 exec "$@"'
    with socket.socket() as listener, (tmp_path / "log").open("wb") as log:
        listener.bind((HOST, 0))
        listener.listen()
        made.port = listener.getsockname()[1]
        number = listener.fileno()
        front = subprocess.Popen(
            ["bash", "-c", handed, str(number), *command, "front"], pass_fds=[number], stderr=log
        )
        notices = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        notices.bind(str(tmp_path / "notify"))
        notices.settimeout(PATIENCE)
        given = {**os.environ, "NOTIFY_SOCKET": str(tmp_path / "notify")}
        signer = subprocess.Popen([*command, "signer"], stderr=log, env=given)
    try:
        with notices:
            assert notices.recv(100) == b"READY=1"
        assert (tmp_path / "state/signer.sock").is_socket()
        until(lambda: made.page("/readyz") == 200)
        robot = Robot(made, tmp_path / "robot")
        assert made.ask(robot.request, token=made.token("/fleet/r1")).status == 200
        signer.send_signal(signal.SIGTERM)
        assert signer.wait(PATIENCE) == 0
        reply = made.ask(robot.new(), token=made.token("/fleet/r2"))
        assert (reply.status, reply.headers["retry-after"]) == (503, "10")
        assert (made.page("/healthz"), made.page("/readyz")) == (200, 503)
    finally:
        signer.kill()
        front.send_signal(signal.SIGTERM)
        assert front.wait(PATIENCE) == 0
        signer.wait(PATIENCE)


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
@pytest.mark.parametrize("unit", ["pqsec-serve.service", "pqsec-signer.service"])
def test_the_units_are_exposed_to_little(unit):
    folder = Path(__file__).parents[2] / "examples/serve"
    command = ["systemd-analyze", "security", "--offline=yes", "--threshold=15", folder / unit]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    text = (folder / unit).read_text()
    words = text.split("ExecStart=/opt/pqsec/bin/pqsec ")[1].splitlines()[0].split()
    assert words[:1] == ["serve"]
    assert ("PrivateNetwork=yes" in text) == ("signer" in unit)
