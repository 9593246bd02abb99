"""The server, where several people approve new certificates, or registration authorities order."""

from datetime import UTC, datetime

import pytest

from pqsec_pki.enrolment import Bundle
from tests.unit.approving import make_key
from tests.unit.serving import Robot, Server

pytestmark = pytest.mark.slow

APPROVERS = "approvals: {required: 2, of: {alice: alice.pub.pem, bob: bob.pub.pem}}\n"


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    folder = tmp_path_factory.mktemp("serve")
    made = Server(folder, datetime.now(UTC), "classical", renew="any-time", approval=True)
    for name in ("alice", "bob"):
        make_key(folder, name)
    domain = folder / "domain.yaml"
    domain.write_text(domain.read_text() + APPROVERS)
    made.cli("apply", "--yes", check=False)
    with made.running():
        yield made


def planned(server, *options):
    """What two people approved is issued."""
    plan = server.folder / "plan.json"
    server.cli("plan", "-o", str(plan), "--key", "alice.pem", "--force", *options, check=False)
    server.cli("approve", str(plan), "--key", "bob.pem", "--yes", "--force")
    server.cli("apply", str(plan), "--yes", check=False)


def decided(server, word, request):
    return server.cli("requests", word, request.fingerprint, "--config", "serve.yaml")


def kinds(server):
    return [each.kind for each in server.keystore.ledger()]


def test_a_robot_waits_until_a_plan_was_approved_and_gets_what_it_issued(server, tmp_path):
    """It got 500, since the server may issue nothing by itself."""
    robot, token = Robot(server, tmp_path, "/fleet/r1"), server.token("/fleet/r1")
    before = kinds(server)
    for _ in range(2):
        reply = server.ask(robot.request, token=token)
        assert (reply.status, reply.headers["retry-after"]) == (202, "60")
    assert kinds(server) == before
    done = decided(server, "approve", robot.request)
    assert "2 of alice, bob: now `pqsec plan" in done.stderr
    assert server.ask(robot.request, token=token).status == 202
    assert kinds(server) == [*before, "request-approval"]
    planned(server)
    replies = [server.ask(robot.request, token=token) for _ in range(2)]
    assert [each.status for each in replies] == [200, 200]
    assert replies[0].headers["etag"] == replies[1].headers["etag"]
    assert kinds(server)[-3:] == ["participant", "permissions", "admission"]
    other = server.ask(Robot(server, tmp_path / "other", "/fleet/r1").request, token=token)
    assert (other.status, other.detail) == (401, "the enrolment token is used up")
    renews(server, robot, Bundle.from_bytes(replies[0].body))


def renews(server, robot, first):
    """Its new key waits in the same way, and its other files stay the newest for it meanwhile."""
    identity = robot.identity(first)
    new = robot.new()
    assert server.ask(new, identity=identity).status == 202
    assert server.send("GET", "/pqsec/v1/bundle", identity=identity).status == 200
    decided(server, "approve", new)
    planned(server, "--new-keys")
    reply = server.ask(new, identity=identity)
    assert reply.status == 200
    second = Bundle.from_bytes(reply.body).enclaves[robot.name]["cert.pem"]
    assert second != first.enclaves[robot.name]["cert.pem"]
    assert kinds(server)[-1] == "permissions"


def test_who_has_only_the_request_that_was_planned_waits_for_a_decision(server, tmp_path):
    """What is answered is no secret; but nobody said that this one may have it."""
    request = Robot(server, tmp_path, "/other").request
    (server.folder / "requests").mkdir(exist_ok=True)
    (server.folder / "requests/other.csr").write_bytes(request.pem)
    planned(server)
    assert kinds(server)[-1] == "permissions"
    assert server.ask(request).status == 202
    decided(server, "approve", request)
    assert server.ask(request).status == 200


def test_a_refused_request_stays_refused(server, tmp_path):
    robot, token = Robot(server, tmp_path, "/fleet/r3"), server.token("/fleet/r3")
    assert server.ask(robot.request, token=token).status == 202
    decided(server, "refuse", robot.request)
    reply = server.ask(robot.request, token=token)
    assert (reply.status, reply.detail) == (403, "the request was refused")


@pytest.fixture(scope="module")
def ordering(tmp_path_factory):
    """A server whose keystore has performed orders for two robots."""
    folder = tmp_path_factory.mktemp("ordering")
    made = Server(folder, datetime.now(UTC), "classical", renew="any-time")
    domain = folder / "domain.yaml"
    domain.write_text(domain.read_text() + "  - {name: /revoked, role: robot, order: orders/}\n")
    make_key(folder, "line")
    granted = "--allow-name /ordered --allow-name /revoked --role robot --max-count 2 --validity 9d"
    made.cli("ra", "add", "line", "--key", "line.pub.pem", *granted.split())
    (folder / "orders").mkdir()
    made.robots = {name: Robot(made, folder / name, f"/{name}") for name in ("ordered", "revoked")}
    with made.running():
        for name, robot in made.robots.items():
            reply = made.ask(robot.request, token=made.token(f"/{name}"))
            assert (reply.status, "authority's order" in reply.detail) == (403, True)
            (folder / f"{name}.csr").write_bytes(robot.request.pem)
            made.cli(
                *("sign-request", "export", f"{name}.csr", "--grant", "line.grant"),
                *("--key", "line.pem", "-o", f"orders/{name}.order"),
            )
        made.cli("apply", "--yes", check=False)
        yield made


def test_the_ordered_request_gets_what_the_order_issued(ordering, tmp_path):
    """With a token it got a second certificate, beside that of the order."""
    robot, lines = ordering.robots["ordered"], len(ordering.keystore.ledger())
    token = ordering.token("/ordered")
    for shown in (None, token):
        reply = ordering.ask(robot.request, token=shown)
        assert (reply.status, len(ordering.keystore.ledger())) == (200, lines + 1)
    bundle = Bundle.from_bytes(reply.body)
    assert bundle.sha256 == ordering.bundle("/ordered").sha256
    other = Robot(ordering, tmp_path, "/ordered").request
    assert [ordering.ask(other, token=each).status for each in (None, token)] == [401, 409]
    identity = robot.identity(bundle)
    assert ordering.send("GET", "/pqsec/v1/bundle", identity=identity).status == 200
    first, second = robot.request, robot.new()
    assert ordering.ask(second, identity=identity).status == 200
    assert ordering.ask(first).status == 401
    identity = robot.identity(ordering.bundle("/ordered"))
    assert ordering.ask(robot.new(), identity=identity).status == 200


def test_what_was_ordered_and_revoked_is_given_to_nobody(ordering):
    request = ordering.robots["revoked"].request
    assert ordering.ask(request).status == 200
    ordering.cli("revoke", "/revoked", "--yes")
    reply = ordering.ask(request)
    assert (reply.status, reply.detail) == (403, "/revoked was revoked")
