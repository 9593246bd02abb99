"""Requests that wait at servers with one ledger in PostgreSQL: they are at all of them."""

import json
from contextlib import suppress
from datetime import UTC, datetime, timedelta

import pytest

from pqsec_pki.algorithms import profile_named
from pqsec_pki.enrolment import Bundle
from pqsec_pki.enrolment import request as make_request
from pqsec_pki.errors import FileError, KeystoreError, MalformedError
from pqsec_pki.keystore import SharedRequests, audit
from pqsec_pki.server.waiting import WaitingRequests
from pqsec_pki.server.waiting_rows import RequestRows
from tests.interop.shared_ledger import create
from tests.unit.serving import Robot, Server
from tests.unit.test_serve_waiting import (
    HOME,
    Asked,
    test_a_full_room_gives_up_the_oldest_of_the_address_with_most,
    test_a_network_of_ipv6_is_one_client,
    test_eight_digits_of_a_digest_name_nothing,
    test_of_clients_with_one_request_each_who_asks_again_stays,
    test_who_asks_no_more_is_forgotten_after_a_month,
)

__all__ = [  # the rules are the same in a database
    "test_a_full_room_gives_up_the_oldest_of_the_address_with_most",
    "test_a_network_of_ipv6_is_one_client",
    "test_eight_digits_of_a_digest_name_nothing",
    "test_of_clients_with_one_request_each_who_asks_again_stays",
    "test_who_asks_no_more_is_forgotten_after_a_month",
]
pytestmark = [pytest.mark.interop, pytest.mark.timeout(300)]

LIST = ("requests", "list", "--config", "serve.yaml", "--json")


@pytest.fixture(scope="module")
def requests(tmp_path_factory):
    """Requests for one name."""
    folder = tmp_path_factory.mktemp("requests")
    profile = profile_named("classical")
    return [make_request("/r", profile, folder, force=True).request for _ in range(9)]


@pytest.fixture
def database(cluster):
    return cluster.database()


@pytest.fixture
def keystore(cluster, database, tmp_path):
    return create(tmp_path / "k", cluster.address(database))


@pytest.fixture
def asked(keystore):
    found = Asked(None, 0)
    found.waiting = WaitingRequests(RequestRows(SharedRequests(keystore.root)), 4)
    return found


def test_a_row_is_the_request_that_its_digest_names(asked, requests, cluster, database):
    first, second = requests[:2]
    asked.ask(first, HOME, "/r")
    [waits] = asked.waiting.all()
    assert (waits.name, waits.address, waits.received) == ("/r", HOME, asked.now)
    assert asked.waiting.request(waits).der == first.der
    cluster.sql(f"UPDATE pqsec.waiting SET request = '\\x{second.der.hex()}'", database)  # noqa: S608
    with pytest.raises(MalformedError, match="its SHA-256 is another one"):
        asked.waiting.request(waits)
    asked.waiting.remove(first.fingerprint)
    asked.waiting.remove(first.fingerprint)
    with pytest.raises(FileError, match="no longer waits"):
        asked.waiting.request(waits)


@pytest.mark.parametrize("change", ["known = '{}'", "known = '['", "asked = 'x'", "asked = ''"])
def test_a_row_that_is_not_a_request_is_told(asked, requests, cluster, database, change):
    asked.ask(requests[0], HOME, "/r")
    cluster.sql(f"UPDATE pqsec.waiting SET {change}", database)  # noqa: S608
    with pytest.raises(MalformedError, match="not a request that waits") as refused:
        asked.waiting.all()
    assert refused.value.where == f"request {requests[0].fingerprint}"


def test_what_is_sent_while_the_lines_are_held_waits_whatever_becomes_of_the_change(
    asked, requests, keystore
):
    with suppress(RuntimeError), keystore.hold():
        asked.ask(requests[0], HOME, "/r")
        raise RuntimeError
    assert asked.there == [requests[0].fingerprint]


def test_a_role_that_only_reads_lines_gets_no_requests(asked, requests, keystore, cluster):
    asked.ask(requests[0], HOME, "/r")
    reader = f"reader{keystore.ledger_address.url.rpartition('?')[0][-6:]}"
    cluster.sql(f"CREATE ROLE {reader} LOGIN")
    settings = keystore.root / "pqsec.json"
    settings.write_text(settings.read_text().replace("officer@", f"{reader}@"))
    with pytest.raises(KeystoreError, match="permission denied"):
        asked.waiting.all()


@pytest.fixture(scope="module", params=["postgresql", "file"])
def servers(cluster, tmp_path_factory, request):
    """Two servers: of two machines with one ledger, or of one keystore."""
    folder, settings = tmp_path_factory.mktemp("two"), {"approval": True}
    (folder / "a").mkdir()
    if request.param == "file":
        settings["requests"] = str(folder / "requests")
    first = Server(folder / "a", datetime.now(UTC) - timedelta(minutes=1), **settings)
    if request.param == "file":
        settings["keystore"] = str(first.root)
    else:
        first.cli("ledger", "move", cluster.address(cluster.database()).url)
    second = first.second(folder / "b", **settings)
    with first.running(), second.running():
        yield first, second


def listed(server):
    return json.loads(server.cli(*LIST).stdout)


def test_a_request_that_waits_at_one_server_waits_at_the_other(servers, tmp_path):
    """`requests list` showed those of one server, and a robot at the other waited twice."""
    first, second = servers
    robot = Robot(first, tmp_path)
    assert first.ask(robot.request).status == 202
    [waits] = listed(second)["requests"]
    assert waits["sha256"] == robot.request.fingerprint
    assert second.ask(robot.request).status == 202
    [again] = listed(first)["requests"]
    assert again["received"] == waits["received"]
    assert again["asked"] >= waits["asked"]
    second.cli("requests", "approve", waits["sha256"], "--config", "serve.yaml")
    for each in servers:
        assert listed(each)["requests"] == []
        assert [one["sha256"] for one in listed(each)["approved"]] == [waits["sha256"]]
    bundle = Bundle.from_bytes(first.ask(robot.request).body)
    assert Bundle.from_bytes(second.ask(robot.request).body).sha256 == bundle.sha256
    for each in servers:
        assert listed(each) == {"version": 1, "requests": [], "approved": []}
        audit(each.keystore)


@pytest.mark.slow(but=1)
def test_a_request_that_is_refused_at_one_server_is_refused_at_the_other(servers, tmp_path):
    first, second = servers
    robot = Robot(second, tmp_path, "/fleet/r2")
    assert second.ask(robot.request).status == 202
    first.cli("requests", "refuse", robot.request.fingerprint, "--config", "serve.yaml")
    assert [each.ask(robot.request).status for each in servers] == [403, 403]
    assert listed(second)["requests"] == []


@pytest.mark.slow(but=1)
def test_a_stranger_has_its_share_of_all_servers_once(servers, tmp_path):
    """Three requests of a name wait, whichever servers got them."""
    made = [Robot(servers[0], tmp_path / str(number), "/fleet/r3").request for number in range(5)]
    for number, each in enumerate(made):
        assert servers[number % 2].ask(each).status == 202
    found = [each["sha256"] for each in listed(servers[0])["requests"]]
    assert len(found) == 3
    assert made[-1].fingerprint in found


@pytest.mark.slow
def test_requests_of_a_ledger_that_is_moved_while_its_server_runs_wait_where_it_is(
    cluster, tmp_path
):
    """They went on to the folder, where `requests list` did not look any more."""
    server = Server(tmp_path, datetime.now(UTC) - timedelta(minutes=1), "classical", approval=True)
    robots = [Robot(server, tmp_path / f"r{number}", "/fleet/r1") for number in range(3)]
    address = cluster.address(cluster.database()).url
    with server.running():
        for each, goal in zip(robots, (None, address, "sqlite"), strict=True):
            if goal:
                server.cli("ledger", "move", goal)
            assert server.ask(each.request).status == 202
            assert each.request.fingerprint in [one["sha256"] for one in listed(server)["requests"]]
