"""Two servers with one ledger behind a balancer: each answers for both, also if one is killed."""

import threading
import time
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta

import pytest

from pqsec_pki.certificates import Reason
from pqsec_pki.enrolment import Bundle, pins_in_use
from pqsec_pki.errors import PqsecError
from pqsec_pki.est import EstClient, KeyTerms, KnownServer, ServerTrust, enrol, renew
from pqsec_pki.keystore import Keystore, audit
from pqsec_pki.lifecycle import renew_list, revoke
from pqsec_pki.server import read_settings
from pqsec_pki.server.call_handling import CallHandler
from tests.interop.balancing import HOST, balancer
from tests.unit.serving import Robot, Server

pytestmark = [pytest.mark.interop, pytest.mark.timeout(600)]

PATIENCE = 300


def clock():
    return datetime.now(UTC)


@contextmanager
def two(folder, cluster, robots):
    """Two servers that run: of two machines with a `cluster`, else of one keystore."""
    (folder / "a").mkdir()
    settings = {"renew": "any-time", "limits": {"requests_of_address": 10_000}}
    first = Server(folder / "a", clock() - timedelta(minutes=1), robots=robots, **settings)
    if cluster:
        first.cli("ledger", "move", cluster.address(cluster.database()).url)
    else:
        settings["keystore"] = str(first.root)
    second = first.second(folder / "b", **settings)
    with first.running(), second.running():
        yield first, second


@pytest.fixture(scope="module")
def servers(cluster, tmp_path_factory):
    with two(tmp_path_factory.mktemp("two"), cluster, 8) as made:
        yield made


def asked(server, robot, **options):
    reply = server.ask(robot.request, **options)
    assert reply.status == 200, reply
    return Bundle.from_bytes(reply.body)


def fetched(server, identity, **headers):
    return server.send("GET", "/pqsec/v1/bundle", identity=identity, **headers)


def until_lists_are(servers, listed):
    """A front gives an answer for everybody again for some seconds."""
    while any(each.send("GET", "/pqsec/v1/revocation-lists").body != listed for each in servers):
        time.sleep(0.5)  # the test has a time limit


@pytest.mark.slow
def test_each_server_answers_what_the_other_issued(servers, tmp_path):
    first, second = servers
    robot, token = Robot(first, tmp_path, "/fleet/r1"), first.token("/fleet/r1")
    bundle = asked(first, robot, token=token)
    assert asked(second, robot, token=token).sha256 == bundle.sha256
    held = robot.identity(bundle)
    tag = f'"{bundle.sha256}"'
    assert fetched(second, held, If_None_Match=tag).status == 304
    robot.new()
    renewed = asked(second, robot, identity=held)
    assert renewed.sha256 != bundle.sha256
    assert asked(first, robot, identity=held).sha256 == renewed.sha256
    got = fetched(first, robot.identity(renewed))
    assert Bundle.from_bytes(got.body).sha256 == renewed.sha256
    for each in servers:
        audit(each.keystore)
        assert len([one for one in each.keystore.ledger() if one.kind == "admission"]) == 2
        assert each.cli("check", check=False).returncode == 0


@pytest.mark.slow
def test_a_revocation_at_one_server_is_in_the_list_of_the_other(servers, tmp_path):
    first, second = servers
    robot = Robot(first, tmp_path, "/fleet/r2")
    held = robot.identity(asked(first, robot, token=first.token("/fleet/r2")))
    keystore = Keystore.open(first.root, to_change=True)
    revoke(keystore, keystore.unlock(None), ["/fleet/r2"], reason=Reason.SUPERSEDED, now=clock())
    listed = keystore.revocation_list_path.read_bytes()
    until_lists_are(servers, listed)
    assert fetched(second, held).status == 403
    third = Robot(second, tmp_path / "3", "/fleet/r3")
    found = asked(second, third, token=second.token("/fleet/r3"))
    assert found.enclaves["/fleet/r3"]["crl.pem"] == listed


def test_one_server_keeps_a_list_in_force_for_both(servers):
    year, handlers = timedelta(days=365), []
    for each in servers:
        keystore = Keystore.open(each.root, to_change=True)
        waiting = read_settings(each.config).waiting(keystore)
        handlers.append(
            CallHandler(
                *(keystore, keystore.unlock(None), None, clock, waiting), revocation_list=year
            )
        )
    renew_list(handlers[0].keystore, handlers[0].authorities, now=clock() - year, validity=year)
    assert [each.keep_list() for each in handlers] == [True, False]
    until_lists_are(servers, handlers[0].keystore.revocation_list_path.read_bytes())


def test_files_of_another_machine_that_are_not_those_of_the_line_are_not_used(
    servers, cluster, tmp_path
):
    first, second = servers
    robot = Robot(first, tmp_path, "/other")
    held = robot.identity(asked(first, robot, token=first.token("/other")))
    line = next(each for each in first.keystore.ledger() if each.name == "/other")
    database = first.keystore.ledger_address.url.rpartition("?")[0].rpartition("/")[2]
    spoilt = f"UPDATE pqsec.files SET content = 'x' WHERE sha256 = '{line.sha256}'"  # noqa: S608
    cluster.sql(spoilt, database)
    reply = fetched(second, held)
    assert (reply.status, reply.detail) == (
        421,
        "this server does not have the newest files of /other: ask another",
    )
    assert not second.keystore.has("/other")
    assert fetched(first, held).status == 200
    known = KnownServer(server=f"https://{HOST}:{second.port}", trust=ServerTrust(first.pins()))
    with pytest.raises(PqsecError, match="ask another"):
        EstClient(server=known.server, trust=known.trust, identity=held).get("/pqsec/v1/bundle")
    with balancer(second.port, first.port) as port:
        asking = EstClient(server=f"https://{HOST}:{port}", trust=known.trust, identity=held)
        assert asking.get("/pqsec/v1/bundle").status == 200


@pytest.mark.slow
def test_of_two_servers_one_may_be_killed_in_the_middle(servers, tmp_path):
    enrolled_in_spite_of_kills(servers, tmp_path, [f"/fleet/r{number}" for number in range(4, 9)])


@pytest.mark.slow
@pytest.mark.parametrize("ledger", ["file", "postgresql"])
def test_of_two_servers_one_is_killed_again_and_again(cluster, tmp_path, ledger):
    names = [f"/fleet/r{number + 1}" for number in range(60)]
    with two(tmp_path, cluster if ledger == "postgresql" else None, len(names)) as servers:
        enrolled_in_spite_of_kills(servers, tmp_path, names)


def enrolled_in_spite_of_kills(servers, folder, names):
    """Each robot has one certificate in the end, for one use of its token."""
    first, second = servers
    with balancer(first.port, second.port) as port:
        fleet = Fleet(first, port, folder / "robots", names)
        fleet.start()
        for number in range(1, len(names) // 3 + 1):
            fleet.wait_for(number)
            servers[number % 2].kill()
            time.sleep(0.3 * (number % 3))
            servers[number % 2].start()
        fleet.join()
        assert fleet.failed == []
        for root in map(fleet.folder, names):
            [found] = renew(KnownServer.at(root), (), root, KeyTerms(), clock=clock)
            assert not isinstance(found, PqsecError), found
    lines = Keystore.open(first.root, to_change=True).ledger()
    issued = [each for each in lines if each.kind == "participant"]
    admitted = [each for each in lines if each.kind == "admission"]
    for found in (
        [each.name for each in issued if each.name in names],
        [name for each in admitted if (name := each.details["participant"]) in names],
    ):
        assert sorted(found) == sorted(names)
    assert len({each.serial for each in issued}) == len(issued)
    for each in servers:
        audit(Keystore.open(each.root, to_change=True))


class Fleet:
    """Robots that enrol through a balancer, two at once, however often they are refused."""

    def __init__(self, server, port, root, names):
        self.server, self.port, self.root = server, port, root
        self.left, self.failed, self.done = list(names), [], 0
        self.pins = pins_in_use(server.keystore)
        self.tokens = {name: server.token(name) for name in names}
        self.threads = [threading.Thread(target=self._run) for _ in range(2)]

    def folder(self, name):
        return self.root / name.strip("/").replace("/", "-")

    def start(self):
        for each in self.threads:
            each.start()

    def join(self):
        for each in self.threads:
            each.join(PATIENCE)
            assert not each.is_alive()

    def wait_for(self, count):
        """Until so many have enrolled."""
        until = time.monotonic() + PATIENCE
        while self.done < count:
            if time.monotonic() > until:
                pytest.fail(f"{self.done} of {count} have enrolled")
            time.sleep(0.01)

    def _run(self):
        while self.left:
            self._enrol(self.left.pop())
            self.done += 1

    def _enrol(self, name):
        token, url = self.tokens[name], f"https://{HOST}:{self.port}"
        trust, secret = ServerTrust(pins=token.server_pins), (token.id, token.secret)
        client = EstClient(server=url, trust=trust, secret=secret)
        terms = KeyTerms(profile=self.server.keystore.profile, pins=self.pins)
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until:
            try:
                enrol(client, name, self.folder(name), terms, clock=clock)
            except PqsecError as error:
                if error.exit_code != 3:  # no: that must not be
                    self.failed.append((name, str(error)))
                    return
                time.sleep(0.1)
            else:
                return
        self.failed.append((name, "too late"))
