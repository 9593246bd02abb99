"""Two servers behind HAProxy, which checks their health and says whose each connection is."""

import shutil
import subprocess
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta

import pytest

from tests.ports import free_port
from tests.unit.serving import HOST, PATIENCE, Robot, Server
from tests.unit.test_serve_balancers import addresses
from tests.unit.test_serve_hostile import counted, until

pytestmark = [pytest.mark.interop, pytest.mark.timeout(300)]

BALANCER, HOME, ENEMY = "127.0.0.9", "127.0.0.5", "127.0.0.66"
MOST = 20
CONFIG = """
defaults
    mode tcp
    timeout connect 10s
    timeout client 60s
    timeout server 60s
frontend robots
    bind {host}:{port}
    unique-id-format %[uuid()]
    default_backend servers
backend servers
    source {balancer}
    option redispatch
    retries 5
    server first {host}:{first} check inter 200ms {options}
    server second {host}:{second} check inter 200ms {options}
"""


@pytest.fixture(scope="module")
def haproxy(requires):
    path = shutil.which("haproxy", path="/usr/sbin:/usr/local/sbin:/usr/bin")
    return requires(path, "HAProxy", "apt-get install haproxy")


@contextmanager
def balanced(program, folder, options):
    """Two servers with one keystore, and where HAProxy listens for both."""
    (folder / "a").mkdir()
    settings = {"proxy_from": BALANCER, "limits": {"requests_of_address": MOST}}
    first = Server(folder / "a", datetime.now(UTC) - timedelta(minutes=1), **settings)
    second = first.second(folder / "b", keystore=str(first.root), **settings)
    port, config = free_port(), folder / "haproxy.cfg"
    ports = {"port": port, "first": first.port, "second": second.port}
    config.write_text(CONFIG.format(host=HOST, balancer=BALANCER, options=options, **ports))
    with first.running(), second.running(), subprocess.Popen([program, "-f", config]) as process:
        try:
            yield first, second, port
        finally:
            process.terminate()
            process.wait(PATIENCE)


@pytest.mark.slow(but=1)
@pytest.mark.parametrize(
    "options",
    ["send-proxy", "send-proxy-v2", "send-proxy-v2 proxy-v2-options crc32c,unique-id"],
)
def test_robots_behind_haproxy_are_limited_one_by_one(haproxy, tmp_path, options):
    with balanced(haproxy, tmp_path, options) as (first, second, port):
        until(lambda: all(counted(each, "connections") > 3 for each in (first, second)))  # checks
        own, first.port = first.port, port
        asking = [first.send("GET", "/pqsec/v1/head", source=ENEMY).status for _ in range(3 * MOST)]
        assert set(asking) == {200, 429}
        robot, token = Robot(first, tmp_path / "robot"), first.token("/fleet/r1")
        assert first.ask(robot.request, token=token, source=HOME).status == 200
        first.kill()
        assert first.ask(robot.request, token=token, source=HOME).status == 200
        assert {HOME, ENEMY} == {*addresses(first), *addresses(second)}
        assert counted(second, "proxy-header") == 0
        first.port = own
