"""The server, where several people approve new certificates, or registration authorities order."""

from datetime import UTC, datetime, timedelta

import pytest

from pqsec_pki.algorithms import load_private_key
from pqsec_pki.certificates import CertificateRequest, certificate_request
from pqsec_pki.enrolment import Bundle
from pqsec_pki.server import APPROVAL, decide, read_settings
from tests.unit.approving import make_key
from tests.unit.serving import Robot, Server

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
    with made.running(measured=True):
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
    past = datetime.now(UTC) - timedelta(days=40)  # what was issued is there, however late it is
    settings = read_settings(server.config)
    decide(server.keystore, settings, [request.fingerprint], APPROVAL, now=past)
    assert server.ask(request).status == 200


def test_a_refused_request_stays_refused(server, tmp_path):
    robot, token = Robot(server, tmp_path, "/fleet/r3"), server.token("/fleet/r3")
    assert server.ask(robot.request, token=token).status == 202
    decided(server, "refuse", robot.request)
    reply = server.ask(robot.request, token=token)
    assert (reply.status, reply.detail) == (403, "the request was refused")


def test_who_shows_nothing_gets_what_was_approved_and_then_planned(server, tmp_path):
    request = Robot(server, tmp_path, "/fleet/r3").request
    assert server.ask(request).status == 202
    decided(server, "approve", request)
    planned(server)
    assert server.ask(request).status == 200


def test_a_refused_renewal_is_asked_for_anew(server, tmp_path):
    """The robot sent the refused request for ever, until its certificate ended."""
    name, token, root = "/fleet/r2", server.token("/fleet/r2"), tmp_path / "r"
    (tmp_path / "token").write_bytes(token.to_bytes())
    enrol = ("enrol", "--token-file", tmp_path / "token", "--name", name, "--dir", root)
    renew = ("renew", "--from", token.server, "--dir", root, "--rekey")
    wait(server, *enrol)
    decided(server, "approve", sent(root))
    planned(server)
    server.cli(*enrol)
    wait(server, *renew)
    refused = sent(root)
    decided(server, "refuse", refused)
    wait(server, *renew)
    wait(server, *renew)
    assert sent(root).spki != refused.spki
    decided(server, "approve", sent(root))
    planned(server, "--new-keys")
    assert f"{name}  has a new certificate" in server.cli(*renew).stdout


def wait(server, *words):
    """The command says that its request waits."""
    done = server.cli(*words, check=False)
    assert (done.returncode, "waits for an approval" in done.stderr) == (3, True), done.stderr


def sent(root):
    [path] = root.rglob("request.csr")
    return CertificateRequest.from_pem(path.read_bytes())


ROLES = (("revoked", "robot"), ("boss", "chief"))


@pytest.fixture(scope="module")
def ordering(tmp_path_factory):
    """A server whose keystore has performed orders for two robots."""
    folder = tmp_path_factory.mktemp("ordering")
    made = Server(folder, datetime.now(UTC), "classical", renew="any-time")
    domain = folder / "domain.yaml"
    head, _, rest = domain.read_text().partition("groups:")
    own = "".join(f"  - {{name: /{name}, order: orders/, role: {role}}}\n" for name, role in ROLES)
    domain.write_text(f"{head}  chief: {{publish: [rt/cmd]}}\ngroups:{rest}{own}")
    make_key(folder, "line")
    granted = "--allow-name /ordered --allow-name /revoked --role robot --max-count 2 --validity 9d"
    made.cli("ra", "add", "line", "--key", "line.pub.pem", *granted.split())
    (folder / "orders").mkdir()
    made.robots = {name: Robot(made, folder / name, f"/{name}") for name in ("ordered", "revoked")}
    with made.running(measured=True):
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


def test_a_renewal_gives_no_other_rights_than_the_order_did(ordering):
    """Within its grant for robots, a registration authority got the rights of the chief so."""
    folder, robot = ordering.folder, Robot(ordering, ordering.folder / "boss", "/boss")
    granted = "--allow-name /boss --role robot --max-count 1 --validity 9d"
    ordering.cli("ra", "add", "line2", "--key", "line.pub.pem", *granted.split())
    (folder / "boss.csr").write_bytes(robot.request.pem)
    words = "sign-request export boss.csr --grant line2.grant --key line.pem -o boss.order"
    ordering.cli(*words.split())
    ordering.cli("sign-request", "sign", "boss.order", "-o", "answer", "--ra-only")
    ordering.cli("renew", "/boss")  # with the rights that it has
    first = robot.identity(ordering.bundle("/boss"))
    same = certificate_request("/boss", load_private_key(robot.key))
    lines = len(ordering.keystore.ledger())
    for asked, shown in (
        (robot.new(), {"identity": first}),
        (same, {"token": ordering.token("/**")}),
    ):
        reply = ordering.ask(asked, **shown)
        words = "/boss was enrolled by an order with other rights than the domain file has"
        assert (reply.status, words in reply.detail) == (403, True)
    assert len(ordering.keystore.ledger()) == lines + 1  # the token
    decided = ordering.token("/boss", replaces=True)  # by who may change the domain file
    assert ordering.ask(robot.request, token=decided).status == 200
