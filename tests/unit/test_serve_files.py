"""What the server reads beside `serve.yaml` is used when it changes, and if it cannot be, told."""

import json
import os
import signal
import socket
import subprocess
import time
from datetime import UTC, datetime, timedelta

import pytest

from pqsec_pki.certificates import RevocationList
from pqsec_pki.errors import FileError, KeystoreError
from pqsec_pki.server import read_settings
from pqsec_pki.server.call import CallKind
from pqsec_pki.server.list_keeping import keep_list
from pqsec_pki.server.running import run_both
from pqsec_pki.server.state_folder import make_state
from tests.unit.factory import Maker
from tests.unit.keystores import DAY, NOW, made
from tests.unit.serving import DOMAIN, HOST, PATIENCE, Robot, Server
from tests.unit.test_serve_hostile import until

INVENTORY = "name,idevid\n/fleet/c1,acme:serialNumber=SN-1\n/fleet/c2,acme:serialNumber=SN-2\n"
CSV = "  - {csv: robots.csv, role: robot, request: requests/}\n"


@pytest.fixture(scope="module")
def maker():
    return Maker(datetime.now(UTC))


@pytest.fixture(scope="module")
def server(maker, tmp_path_factory):
    folder = tmp_path_factory.mktemp("serve")
    maker.put(folder)
    acme = {"cas": "acme.pem", "revocation_lists": ["root.crl", "line.crl"], "again": True}
    found = Server(folder, datetime.now(UTC), factories={"acme": acme}, revocation_list="365d")
    (folder / "robots.csv").write_text(INVENTORY)
    (folder / "domain.yaml").write_text(DOMAIN.format(profile="pq") + CSV)
    with found.running(measured=True):
        yield found


def in_force(server):
    return "pqsec_serve_configuration_in_force 1\n" in server.page("/metrics", text=True)


def status(server, name, folder):
    return server.ask(Robot(server, folder, name).request, token=server.token(name)).status


def test_each_line_of_the_log_is_an_event_in_json(server, tmp_path):
    """Of both processes; one says where the server listens."""
    assert status(server, "/fleet/r1", tmp_path / "a") == 200
    events = [json.loads(each) for each in server.log.splitlines()]
    assert all(datetime.fromisoformat(each["at"]) for each in events)
    [listens] = [each for each in events if each.get("event") == "the server listens"]
    assert listens["addresses"] == [f"127.0.0.1:{server.port}"]
    [issued] = [each for each in events if each.get("event") == CallKind.REQUEST]
    assert issued["status"] == 200


def test_a_new_line_of_an_inventory_counts_at_once(server, tmp_path):
    assert status(server, "/fleet/new", tmp_path / "a") == 403
    (server.folder / "robots.csv").write_text(f"{INVENTORY}/fleet/new,\n")
    assert status(server, "/fleet/new", tmp_path / "b") == 200
    (server.folder / "robots.csv").write_text(INVENTORY)
    assert status(server, "/fleet/new", tmp_path / "c") == 403
    assert f"{server.folder}/robots.csv was read again" in server.log


@pytest.mark.parametrize("name", ["robots.csv", "acme.pem", "line.crl"])
def test_a_file_with_a_mistake_leaves_the_old_one_in_force(server, maker, tmp_path, name):
    path = server.folder / name
    before = path.read_bytes()
    path.write_bytes(b"no, no\n")
    until(lambda: name in server.page("/readyz", text=True))
    assert (server.page("/readyz"), in_force(server)) == (200, False)
    device, robot = maker.device("SN-2"), Robot(server, tmp_path, "/fleet/c2")
    assert server.ask(robot.request, identity=device).status == 200
    assert server.log.count(f'{path} is not changed"') == 1  # it is read once
    path.unlink()
    until(lambda: server.log.count(f'{path} is not changed"') == 2)
    path.write_bytes(before)
    until(lambda: name not in server.page("/readyz", text=True))
    assert in_force(server)


def test_a_new_revocation_list_of_a_factory_counts_at_once(server, maker, tmp_path):
    device, robot = maker.device("SN-1", serial=7), Robot(server, tmp_path, "/fleet/c1")
    assert server.ask(robot.request, identity=device).status == 200
    (server.folder / "line.crl").write_bytes(maker.revoked("line", 7))
    reply = server.ask(robot.new(), identity=device)
    assert (reply.status, "revoked" in reply.detail) == (403, True)


def test_mistakes_in_serve_yaml_are_told_by_both_processes(server):
    text = server.config.read_text()
    server.config.write_text("{")
    server.reload()
    until(lambda: server.page("/readyz", text=True).count("the configuration is not changed") == 2)
    server.config.write_text(text)
    server.reload()
    until(lambda: server.page("/readyz", text=True) == "ready\n")
    assert in_force(server)


def test_the_first_list_is_there_before_the_first_question(server):
    reply = server.send("GET", "/pqsec/v1/revocation-lists")
    found = RevocationList.from_pem(reply.body)
    assert found.next_update - found.this_update >= timedelta(days=365)
    assert server.send("GET", "/pqsec/v1/head").status == 200


def test_the_next_list_is_issued_when_a_third_is_left(tmp_path):
    keystore = made(tmp_path / "k", "classical")
    authorities = keystore.unlock(None)

    def kept(days):
        return keep_list(keystore, authorities, 30 * DAY, now=NOW + days * DAY)

    assert [kept(days) for days in (1, 2, 20, 22, 23)] == [True, False, False, True, False]
    assert keystore.revocation_list.number == 2


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give files to others")
@pytest.mark.parametrize("mode", [0o777, 0o1777, 0o770])
def test_where_others_can_write_the_signer_does_not_listen(tmp_path, mode):
    """Somebody's socket in the place of the signer's got the tokens of robots."""
    config, state = tmp_path / "serve.yaml", tmp_path / "state"
    tls = "tls: [{chain: c, key: k}]"
    config.write_text(f"url: https://x\nkeystore: k\ndomain: d\n{tls}\n")
    settings = read_settings(config)
    make_state(settings)
    assert state.stat().st_mode & 0o777 == 0o700
    os.chown(state, -1, 65534)
    state.chmod(mode)
    with pytest.raises(FileError, match="may write there") as refused:
        make_state(settings)
    assert refused.value.hint == f"chmod go-w {state}"
    state.chmod(0o750)
    make_state(settings)


@pytest.fixture
def signals():
    """`run_both` takes SIGTERM, since its process ends with it."""
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)


@pytest.mark.timeout(60)
def test_a_server_that_cannot_listen_issues_no_list(tmp_path, signals):
    """It issued one before it found its port taken, and ended without a word while it started."""
    made = Server(tmp_path, datetime.now(UTC), "classical", revocation_list="365d")
    with socket.create_server((HOST, made.status_port)):
        done = subprocess.run(made.command, capture_output=True, text=True, check=False)
        with pytest.raises(KeystoreError, match="faces the network ended with 3"):
            run_both(read_settings(made.config), lambda _: time.sleep(60), lambda: NOW)
    assert (done.returncode, "cannot listen at" in done.stderr) == (3, True)
    assert "crl" not in {each.kind for each in made.keystore.ledger()}


@pytest.mark.timeout(120)
@pytest.mark.parametrize("part", ["both", "signer"])
def test_a_second_server_by_mistake_leaves_the_first_its_socket(tmp_path, part):
    """It took the signer's socket and ended: the first answered no robot until it was restarted."""
    made = Server(tmp_path, datetime.now(UTC), "classical")
    with made.running():
        again = [*made.command, "--part", part]
        done = subprocess.run(again, capture_output=True, text=True, check=False, timeout=PATIENCE)
        assert (done.returncode, "another server uses this folder" in done.stderr) == (3, True)
        robot = Robot(made, tmp_path / "robot", "/fleet/r1")
        assert made.ask(robot.request, token=made.token("/fleet/r1")).status == 200
