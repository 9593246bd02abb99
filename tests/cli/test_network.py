"""pqsec enrol, and renew --from, as a robot's user and its timer run them."""

import json
import os
import re
import shutil
import stat
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from pqsec_pki.algorithms import private_key_pem
from pqsec_pki.enrolment import Bundle, pins_in_use
from pqsec_pki.est import EnrolmentToken
from pqsec_pki.est.obtaining import etag, installed
from pqsec_pki.keystore import Keystore, layout
from pqsec_pki.lifecycle import Renewal, renew
from tests.longer import LONG
from tests.some_keys import some_key
from tests.unit.est_server import serving
from tests.unit.tls_sides import certificate, identity, pin

SYSTEMD = shutil.which("systemd-analyze")
ROBOT = "/fleet/robot1"
DAY = timedelta(days=1)
NOW = datetime.now(UTC).replace(microsecond=0)


@pytest.fixture
def keystore(pqsec, tmp_path):
    pqsec("-k k ca init --no-passphrase --profile pq").done()
    return Keystore.open(tmp_path / "k", to_change=True)


@pytest.fixture
def server(keystore):
    with serving(keystore) as running:
        running.now = NOW
        running.anybody = True
        yield running


@pytest.fixture
def token(server, keystore, tmp_path):
    """The token's file, which the server takes."""
    made_token = EnrolmentToken.new(
        server=server.url,
        server_pins=server.trust.pins,
        cas=pins_in_use(keystore),
        names=ROBOT,
        profile="pq",
        not_after=NOW + DAY,
    )
    path = tmp_path / "robot1.token"
    path.write_bytes(made_token.to_bytes())
    path.chmod(0o600)
    return made_token


@pytest.fixture
def enrolled(pqsec, token):
    return pqsec("enrol --token-file robot1.token --dir r").done()


def test_a_robot_enrols_and_its_timer_finds_nothing_to_do(pqsec, enrolled, server, tmp_path):
    assert enrolled.out.startswith(f"{ROBOT}  has a new certificate, until ")
    assert enrolled.err == ""
    assert len(server.receipts) == 1
    assert stat.S_IMODE((tmp_path / "r/server.json").stat().st_mode) == 0o600
    again = pqsec(f"renew --from {server.url} --dir r").done()
    assert again.out.startswith(f"{ROBOT}  is up to date, until ")
    assert len(server.receipts) == 1
    assert (
        "has a new certificate" in pqsec(f"renew --from {server.url} --dir r --due 9y").done().out
    )
    assert len(server.receipts) == 2
    assert "has a new certificate" in pqsec(f"renew --from {server.url} --dir r --rekey").done().out


def test_newer_documents_are_told(pqsec, enrolled, server, keystore):
    renew(keystore, keystore.unlock(None), [ROBOT], Renewal(), now=NOW + timedelta(seconds=1))
    server.now = NOW + DAY
    found = pqsec(f"renew --from {server.url} --dir r --json").done().json
    [one] = found["participants"]
    assert one["name"] == ROBOT
    assert one["changed"]


def test_the_secret_is_nowhere_but_in_its_file(pqsec, enrolled, token, tmp_path, server):
    server.reply = b"HTTP/1.1 500 x\r\n\r\n"
    said = pqsec("enrol --token-file robot1.token --dir r --force").err
    secret = token.secret.encode()
    found = [path for path in tmp_path.rglob("*") if path.is_file() and secret in path.read_bytes()]
    assert found == [tmp_path / "robot1.token"]
    assert token.secret not in said + enrolled.out + enrolled.err


def test_an_open_token_is_noted(pqsec, token, tmp_path):
    (tmp_path / "robot1.token").chmod(0o644)
    done = pqsec("enrol --token-file robot1.token --dir r").done()
    assert "robot1.token can be read by others: chmod 600 it" in done.err


def test_a_receipt_that_cannot_be_sent_is_noted(pqsec, token, server):
    def refuse(handler):
        if handler.path.endswith("receipts"):
            handler.problem(500, "full")
            return True
        return False

    server.reply = refuse
    done = pqsec("enrol --token-file robot1.token --dir r")
    assert done.code == 0
    assert "the server has no receipt yet" in done.err
    server.reply = None
    pqsec(f"renew --from {server.url} --dir r").done()
    assert len(server.receipts) == 1


def test_what_the_timer_gets_is_an_exit_code(pqsec, enrolled, server):
    url = f"renew --from {server.url} --dir r"
    for status, code in ((403, 1), (503, 3)):

        def refuse(handler, status=status):
            handler.problem(status, "no")
            return True

        server.reply = refuse
        pqsec(url).refused(code, f"{ROBOT}: ", "says: refused: no")
    pqsec("renew --from https://127.0.0.1:9 --dir r").refused(2, "say how to trust https")
    pqsec("renew --dir r").refused(2, "--dir needs --from", hint="--from URL names the server")
    pqsec(f"renew --from https://127.0.0.1:9 --server-pin {'0' * 64} --dir r").refused(
        3, "connection refused", hint="stays as it is"
    )


def test_an_approval_is_waited_for_by_the_next_run(pqsec, token, server):
    server.waiting = 1
    pqsec("enrol --token-file robot1.token --dir r").refused(
        3,
        "waits for an approval",
        hint=" --config serve.yaml` was run at the server, run the command again",
    )
    pqsec("enrol --token-file robot1.token --dir r").done()


def test_a_device_enrols_with_the_certificate_of_its_factory(pqsec, server, keystore, tmp_path):
    seen = []

    def look(handler):
        seen.append(handler.caller())
        return False

    server.reply = look
    chain, key = certificate("ecdsa-p256", owner="device")
    (tmp_path / "device.pem").write_bytes(chain)
    (tmp_path / "device.key").write_bytes(key)
    pins = pqsec("-k k ca show --pins").done().out.strip()
    line = f"enrol {server.url} --name {ROBOT} --factory-cert device.pem --factory-key device.key"
    pqsec(f"{line} --profile pq --dir r --server-pin {pin(server.shown)} {pins}").done()
    assert seen[0] == "device"


def test_a_server_is_known_by_a_ca_file(pqsec, keystore, tmp_path):
    authority, _ = certificate("ml-dsa-65", owner="ca", ca=True, since=NOW - DAY)
    (tmp_path / "ca.pem").write_bytes(authority)
    shown = identity("ml-dsa-65", issuer="ca", since=NOW - DAY)
    with serving(keystore, shown) as server:
        server.anybody, server.now = True, NOW
        line = f"enrol {server.url} --name {ROBOT} --profile pq --trust-first --dir r"
        pqsec(f"{line} --server-ca ca.pem").done()
        pqsec(f"renew --from {server.url} --dir r").done()


MEANINGLESS = {
    "enrol": "no server is named",
    "enrol https://a": "no participant is named",
    "enrol https://a --name /x": "no server is trusted: no pin and no CA is given",
    "enrol http://a --name /x": "not the URL of a server",
    "enrol https://a --name /x --server-pin zz": "is not a SHA-256 in hex",
    f"enrol https://a --name /x --server-pin {'0' * 64} --factory-cert k/pqsec.json": "need each",
    f"enrol https://a --name /x --server-ca k/pqsec.json --server-pin {'0' * 64}": "exclude",
    "enrol https://b --token-file robot1.token": "the token is for https://127.0.0.1",
    "renew --from https://a --dir r": "r has no server.json",
    "renew --from https://a --dir r --all": "--all is for a keystore",
    "renew --from https://a --dir r --validity 5d": "--validity is for a keystore",
    "renew --from https://a --dir r --keep-key": "--keep-key is for a keystore",
    "renew --dir r": "--dir needs --from",
    "renew --all --server-ca x": "--server-ca needs --from",
}


@pytest.mark.parametrize("line", MEANINGLESS)
def test_what_makes_no_sense_is_a_wrong_command_line(pqsec, token, line):
    pqsec(line).refused(2, MEANINGLESS[line])


def test_a_token_for_several_needs_a_name(pqsec, token, tmp_path):
    value = json.loads(token.to_bytes())
    (tmp_path / "robot1.token").write_text(json.dumps({**value, "names": "/fleet/*"}))
    pqsec("enrol --token-file robot1.token --dir r").refused(
        2, "no participant is named, one of the token's /fleet/*", hint="--name NAME"
    )
    pqsec(f"enrol --token-file robot1.token --dir r --name {ROBOT}").done()


def test_a_robot_of_several_participants_enrols_them_at_once(pqsec, token, server, tmp_path):
    value = json.loads(token.to_bytes())
    (tmp_path / "robot1.token").write_text(json.dumps({**value, "names": "/fleet/*"}))
    ask = "enrol --token-file robot1.token --dir r --name /fleet/a --name /fleet/b"
    done = pqsec(f"{ask} --name /fleet/a").done()
    assert re.findall(r"^(/fleet/.)  has a new", done.out, re.MULTILINE) == ["/fleet/a", "/fleet/b"]
    assert len(server.receipts) == 1

    def refuse(handler):
        if b"CERTIFICATE REQUEST" in handler.body:
            handler.problem(403, "no")
            return True
        return False

    server.reply = refuse
    said = pqsec(f"{ask} --name /fleet/c")
    assert (said.code, "/fleet/a  is up to date" in said.out) == (1, True)
    assert "pqsec: error: /fleet/c: " in said.err


def test_a_key_that_tls_does_not_have_is_told(pqsec, server, tmp_path):
    chain, _ = certificate("ecdsa-p256", owner="device")
    (tmp_path / "device.pem").write_bytes(chain)
    key = private_key_pem(some_key("mldsa44-ed25519-sha512"))
    (tmp_path / "device.key").write_bytes(key)
    line = f"enrol {server.url} --name {ROBOT} --factory-cert device.pem --factory-key device.key"
    pqsec(f"{line} --server-pin {'0' * 64}").refused(2, "device.key: TLS has no")


@pytest.mark.parametrize("line", ["enrol https://a --name /x", "renew --from https://a"])
def test_without_the_library_the_way_to_it_is_told(process, tmp_path, line):
    (tmp_path / "OpenSSL.py").write_text("raise ModuleNotFoundError(name='OpenSSL')")
    path = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    process(line, PYTHONPATH=path).refused(
        3, "needs the library pyOpenSSL", hint="pip install 'pyopenssl>=26.4,<27'"
    )


def test_the_bundle_of_the_server_has_the_tag_that_the_robot_computes(enrolled, keystore, tmp_path):
    opened = Keystore.open(keystore.root)
    bundle = Bundle.of(opened, [ROBOT], now=NOW, keys=False)
    files = installed(tmp_path / "r")[ROBOT]
    assert etag(ROBOT, {layout.FIRST: files}, now=NOW) == f'"{bundle.sha256}"'


# The timer of examples/enrolment-network

UNITS = Path(__file__).parents[2] / "examples/enrolment-network"
UNIT = "pqsec-renew-robot"


def unit(kind):
    """The settings of the example's unit."""
    lines = (UNITS / f"{UNIT}.{kind}").read_text().splitlines()
    return dict(line.split("=", 1) for line in lines if re.match(r"\w+=", line))


def test_the_service_of_a_robot_renews_and_reaches_no_other_folder(pqsec, enrolled, server):
    service = unit("service")
    program, line = service["ExecStart"].split(" ", 1)
    assert program == "/usr/bin/pqsec"
    assert service["ReadWritePaths"] == "/etc/dds"
    line = line.replace("https://enrol.example:8443", server.url).replace("/etc/dds", "r")
    assert "is up to date" in pqsec(line).done().out


def test_robots_do_not_come_at_once(pqsec):
    timer = unit("timer")
    assert (timer["RandomizedDelaySec"], timer["FixedRandomDelay"]) == ("6h", "yes")
    assert timer["Persistent"] == "yes"


@pytest.mark.interop
@pytest.mark.skipif(not (LONG or SYSTEMD), reason="in .ci/long: it installs Debian's systemd")
def test_the_units_are_as_systemd_wants_them(tmp_path, requires):
    tool = requires(SYSTEMD, "systemd-analyze", "apt-get install systemd")
    units = [tmp_path / f"{UNIT}.{kind}" for kind in ("service", "timer")]
    for path in units:
        text = (UNITS / path.name).read_text().replace("/usr/bin/pqsec", sys.executable)
        path.write_text(text)
    done = subprocess.run(
        [tool, "verify", "--man=no", *units], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout + done.stderr) == (0, "")
