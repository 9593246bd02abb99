"""The server, as clients meet it: who gets a certificate, and who does not."""

import base64
import json
import re
from dataclasses import replace
from datetime import UTC, datetime

import pytest
from cryptography.hazmat.primitives.serialization import Encoding, pkcs7

from pqsec_pki.certificates import Certificate
from pqsec_pki.enrolment import Bundle, pins_in_use, verify_bundle
from pqsec_pki.server import read_settings
from tests.unit.serving import HOST, Robot, Server

PKCS10 = "application/pkcs10"


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    folder = tmp_path_factory.mktemp("serve")
    made = Server(folder, datetime.now(UTC), renew="any-time", robots=5)
    with made.running(measured=True):
        yield made


def enrolled(server, folder, name):
    """A robot with its first bundle."""
    robot = Robot(server, folder, name)
    reply = server.ask(robot.request, token=server.token(name))
    assert reply.status == 200, reply
    return robot, Bundle.from_bytes(reply.body)


def test_a_token_gives_a_whole_bundle_once(server, tmp_path):
    robot, token = Robot(server, tmp_path / "a", "/fleet/r1"), server.token("/fleet/r1")
    reply = server.ask(robot.request, token=token)
    assert (reply.status, reply.headers["content-type"]) == (200, "application/vnd.pqsec.bundle")
    bundle = Bundle.from_bytes(reply.body)
    verify_bundle(bundle, pins_in_use(server.keystore), now=datetime.now(UTC))
    assert not bundle.has_keys
    assert reply.headers["etag"] == f'"{bundle.sha256}"'
    again = server.ask(robot.request, token=token)
    assert Bundle.from_bytes(again.body).sha256 == bundle.sha256
    other = server.ask(Robot(server, tmp_path / "b", "/fleet/r1").request, token=token)
    assert (other.status, other.detail) == (401, "the enrolment token is used up")
    identity = robot.identity(bundle)
    got = server.send("GET", "/pqsec/v1/bundle", identity=identity)
    assert Bundle.from_bytes(got.body).sha256 == bundle.sha256
    got = server.send(
        "GET", "/pqsec/v1/bundle", identity=identity, If_None_Match=got.headers["etag"]
    )
    assert (got.status, got.body) == (304, b"")


def test_a_token_is_used_by_a_request_that_another_token_admitted_before(server, tmp_path):
    """It never was: the ledger had one admission of a request, so each repetition issued again."""
    robot, lines = Robot(server, tmp_path / "a", "/fleet/r4"), server.keystore.ledger
    first, fleet = server.token("/fleet/r4"), server.token("/fleet/*")
    assert server.ask(robot.request, token=first).status == 200
    one = server.ask(robot.request, token=fleet)
    before = len(lines())
    again = server.ask(robot.request, token=fleet)
    assert (one.status, again.status, len(lines())) == (200, 200, before)
    assert one.headers["etag"] == again.headers["etag"]
    assert server.ask(robot.request, token=first).headers["etag"] == one.headers["etag"]
    other = server.ask(Robot(server, tmp_path / "b", "/fleet/r5").request, token=fleet)
    assert (other.status, other.detail) == (401, "the enrolment token is used up")


def test_est_gives_the_certificate_and_renews_it(server, tmp_path):
    robot = Robot(server, tmp_path, "/fleet/r2")
    body = base64.b64encode(robot.request.der)
    path = "/.well-known/est/fleet"
    reply = server.post(f"{path}/simpleenroll", body, PKCS10, token=server.token("/fleet/*"))
    assert reply.headers["content-type"] == "application/pkcs7-mime; smime-type=certs-only"
    [first] = certificates_in(reply)
    assert first.subject_name == "CN=/fleet/r2"
    [authority] = certificates_in(server.send("GET", f"{path}/cacerts"))
    assert authority.der == server.keystore.identity_ca.der
    old = robot.identity(server.bundle("/fleet/r2"))
    body = base64.encodebytes(robot.new().der)
    renewed = server.post(f"{path}/simplereenroll", body, PKCS10, identity=old)
    [second] = certificates_in(renewed)
    assert second.serial_number != first.serial_number
    again = server.post(f"{path}/simplereenroll", body, PKCS10, identity=old)
    assert certificates_in(again)[0].der == second.der
    late = server.post(
        f"{path}/simplereenroll", base64.b64encode(robot.new().der), PKCS10, identity=old
    )
    assert (late.status, late.detail) == (403, "this is not the current certificate of /fleet/r2")


def certificates_in(reply):
    assert reply.status == 200, reply
    found = pkcs7.load_der_pkcs7_certificates(base64.b64decode(reply.body))
    return [Certificate.from_pem(each.public_bytes(Encoding.PEM)) for each in found]


def test_attributes_say_which_keys(server):
    reply = server.send("GET", "/.well-known/est/csrattrs")
    assert (reply.status, reply.headers["content-type"]) == (200, "application/csrattrs")
    oid = bytes.fromhex("0609608648016503040312")  # id-ml-dsa-65
    assert oid in base64.b64decode(reply.body)


REFUSED = {
    "without anything": (401, "show an enrolment token, or a client certificate"),
    "a wrong secret": (401, "this enrolment token is not known here"),
    "an unknown token": (401, "this enrolment token is not known here"),
    "a token of another": (403, "the enrolment token is not for /other"),
    "not in the domain file": (403, "/fleet/r9 is not in the domain file"),
    "keys of the CA": (403, "the keys of /local are made by the CA"),
    "for an order": (403, "/ordered is enrolled by a registration authority's order"),
    "a revoked token": (401, "the enrolment token was revoked"),
    "not a request": (400, "not a DER"),
    "another's proof": (400, "no proof that the requester has the private key"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_nobody_else_gets_a_certificate(server, tmp_path, what):
    names = {
        "a token of another": "/other",
        "not in the domain file": "/fleet/r9",
        "keys of the CA": "/local",
        "for an order": "/ordered",
    }
    name = names.get(what, "/fleet/r3")
    token = server.token("/fleet/*" if what == "a token of another" else name)
    body = Robot(server, tmp_path, name).request.der
    match what:
        case "without anything":
            token = None
        case "a wrong secret":
            token = replace(token, secret=server.token(name).secret)
        case "an unknown token":
            token = replace(token, id="0" * 16)
        case "a revoked token":
            told = server.cli("enrolment-token", "revoke", token.id, "--config", "serve.yaml")
            assert told.stdout.endswith("  revoked\n")
        case "not a request":
            body = body[:-1]
        case "another's proof":
            body = body[:-1] + bytes([body[-1] ^ 1])
    status, detail = REFUSED[what]
    before = server.keystore.head
    reply = server.post("/pqsec/v1/requests", body, PKCS10, token=token)
    assert reply.status == status
    assert reply.detail.startswith(detail) or detail in reply.detail
    assert ("www-authenticate" in reply.headers) == (status == 401)
    assert server.keystore.head == before


def test_a_token_for_nobody_is_told_and_no_option_is_named_that_there_is_not(server):
    create = ("enrolment-token", "create", "/fleet/nobody", "--config", "serve.yaml", "-o", "n")
    assert "domain.yaml does not name /fleet/nobody" in server.cli(*create).stderr
    refused = server.cli(*create, check=False)
    assert (refused.returncode, "--force" in refused.stderr) == (3, False)


def test_hints_about_tokens_and_requests_work_as_they_are_pasted(server):
    """They lacked --config, without which each command is refused."""
    for words in (("enrolment-token", "revoke", "0" * 16), ("requests", "approve", "1234")):
        refused = server.cli(*words, "--config", "serve.yaml", check=False)
        [command] = re.findall("hint: .*`pqsec (.*)`", refused.stderr)
        server.cli(*command.split())


def test_a_token_that_could_not_replace_the_certificate_is_told_where_it_is_made(server, tmp_path):
    """Only the robot was told, when it came with the token."""
    enrolled(server, tmp_path, "/fleet/r3")

    def noted(name, *more):
        goal = tmp_path / f"{len(list(tmp_path.iterdir()))}.token"
        create = ("enrolment-token", "create", name, "--config", "serve.yaml", "-o", str(goal))
        return "/fleet/r3: there is a certificate" in server.cli(*create, *more).stderr

    assert noted("/fleet/r3")
    assert not noted("/fleet/r3", "--replace")
    assert not noted("/fleet/*")


def test_a_revoked_certificate_gets_nothing(server, tmp_path):
    robot, bundle = enrolled(server, tmp_path, "/other")
    identity = robot.identity(bundle)
    server.cli("revoke", "/other", "--yes")
    for reply in (
        server.send("GET", "/pqsec/v1/bundle", identity=identity),
        server.ask(robot.new(), identity=identity),
    ):
        assert (reply.status, reply.detail) == (403, "the client certificate was revoked")
    reply = server.ask(robot.new(), token=server.token("/*"))
    assert (reply.status, reply.detail) == (403, "/other was revoked")


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("GET", "/", 404),
        ("GET", "/.well-known/est", 404),
        ("GET", "/.well-known/est/../est/cacerts", 404),
        ("GET", "/.well-known/est/%66leet/cacerts", 404),
        ("GET", "/.well-known/est/cacerts/cacerts", 404),
        ("GET", "/.well-known/est/cacerts?x=1", 404),
        ("GET", "//.well-known/est/cacerts", 404),
        ("GET", "/.well-known/est/simpleenroll", 405),
        ("POST", "/.well-known/est/cacerts", 405),
        ("POST", "/.well-known/est/simpleenroll", 415),
        ("GET", "/pqsec/v1/bundle", 401),
        ("GET", "/pqsec/v1/head", 200),
    ],
)
def test_a_path_is_compared_and_not_decoded(server, method, path, status):
    assert server.send(method, path).status == status


@pytest.fixture(scope="module")
def asking(tmp_path_factory):
    limits = {"waiting": 4}
    made = Server(
        tmp_path_factory.mktemp("asking"), datetime.now(UTC), approval=True, limits=limits
    )
    with made.running(measured=True):
        yield made


def decided(server, word, request):
    words = (word, request.fingerprint[:16], "--config", "serve.yaml", "--json")
    done = server.cli("requests", *words)
    return [each["sha256"] for each in json.loads(done.stdout)["requests"]]


def test_a_request_without_a_token_waits_for_a_decision(asking, tmp_path):
    robot = Robot(asking, tmp_path, "/fleet/r1")
    for _ in range(2):
        reply = asking.ask(robot.request)
        assert (reply.status, reply.headers["retry-after"]) == (202, "60")
        assert robot.request.fingerprint in reply.body.decode()
    head = asking.keystore.head
    rows = asking.cli("requests", "list", "--config", "serve.yaml", "--format", "csv").stdout
    assert rows.startswith("name,sha256,address,received,asked,replaces\n")
    assert len(rows.splitlines()) == 2
    listed = json.loads(asking.cli("requests", "list", "--config", "serve.yaml", "--json").stdout)
    [waits] = listed["requests"]
    assert (waits["sha256"], waits["replaces"]) == (robot.request.fingerprint, False)
    assert asking.keystore.head == head
    assert decided(asking, "approve", robot.request) == [robot.request.fingerprint]
    listed = json.loads(asking.cli("requests", "list", "--config", "serve.yaml", "--json").stdout)
    [approved] = listed["approved"]
    assert (listed["requests"], approved["sha256"]) == ([], robot.request.fingerprint)
    told = asking.cli("requests", "list", "--config", "serve.yaml").stdout
    assert re.search(r"no request waits\n\nNAME .* UNTIL\n/fleet/r1 ", told)
    replies = [asking.ask(robot.request) for _ in range(2)]
    assert [each.status for each in replies] == [200, 200]
    assert replies[0].headers["etag"] == replies[1].headers["etag"]
    told = asking.cli("requests", "list", "--config", "serve.yaml").stdout
    assert told == "no request waits\n"
    others = [robot.new() for _ in range(2)]
    assert [asking.ask(each).status for each in others] == [202, 202]
    told = asking.cli("requests", "list", "--config", "serve.yaml")
    assert told.stdout.count("  its key\n") == 2
    refused = asking.cli(
        "requests",
        "approve",
        *(each.fingerprint for each in others),
        *("--config", "serve.yaml"),
        check=False,
    )
    assert (refused.returncode, "one request for /fleet/r1" in refused.stderr) == (2, True)
    stays, other = others
    assert decided(asking, "approve", stays) == [stays.fingerprint]
    told = asking.cli("requests", "list", "--config", "serve.yaml").stdout
    assert told.startswith("no request waits\n")  # the other would replace what is approved
    assert [asking.ask(each).status for each in (stays, other)] == [200, 202]
    assert decided(asking, "refuse", other) == [other.fingerprint]
    reply = asking.ask(other)
    assert (reply.status, reply.detail) == (403, "the request was refused")


def test_an_old_approval_replaces_no_certificate_that_was_issued_since(asking, tmp_path):
    forgotten = Robot(asking, tmp_path / "a", "/other").request
    assert asking.ask(forgotten).status == 202
    assert decided(asking, "approve", forgotten) == [forgotten.fingerprint]
    robot = Robot(asking, tmp_path / "b", "/other")
    assert asking.ask(robot.request, token=asking.token("/other")).status == 200
    reply = asking.ask(forgotten)
    assert (reply.status, "got a certificate since" in reply.detail) == (403, True)


def test_a_robot_that_was_approved_too_late_is_told_how_to_ask_again(asking, tmp_path):
    """Its operator read "send a new request", and each run of the command sent the old one."""
    pins = [f"--server-pin={each}" for each in asking.pins()]
    pins += asking.cli("ca", "show", "--pins").stdout.split()
    url = f"https://{HOST}:{asking.port}"
    line = ("enrol", url, "--name", "/other", "--profile", "pq", "--dir", tmp_path / "a", *pins)
    assert asking.cli(*line, check=False).returncode == 3
    first = waiting_request(asking)
    assert decided(asking, "approve", first) == [first.fingerprint]
    token = asking.token("/other", replaces=True)
    assert asking.ask(Robot(asking, tmp_path / "b", "/other").request, token=token).status == 200
    late = asking.cli(*line, "--wait", "1m", check=False)
    assert (late.returncode, "got a certificate since the request" in late.stderr) == (1, True)
    assert "make a new request: `pqsec enrol --force`" in late.stderr
    assert asking.cli(*line, "--force", check=False).returncode == 3
    decided(asking, "approve", waiting_request(asking))
    assert "/other  has a new certificate" in asking.cli(*line, "--wait", "1m").stdout


def waiting_request(server):
    """The only one that waits for a decision about /other."""
    waiting = read_settings(server.config).waiting(server.keystore)
    [waits] = [each for each in waiting.all() if each.name == "/other"]
    return waiting.request(waits)


def test_who_asks_most_keeps_nobody_out(asking, tmp_path):
    """Four requests of a stranger kept everybody out for a month."""
    robot, stranger = (Robot(asking, tmp_path / each, "/fleet/r3") for each in ("a", "b"))
    for name in ("/fleet/r2", "/fleet/r3"):
        stranger.name = name
        for _ in range(3):
            assert asking.ask(stranger.new(), source="127.0.0.66").status == 202
    assert asking.ask(robot.request).status == 202
    for _ in range(3):
        assert asking.ask(stranger.new(), source="127.0.0.66").status == 202
    listed = asking.cli("requests", "list", "--config", "serve.yaml", "--json").stdout
    found = json.loads(listed)["requests"]
    assert (len(found), robot.request.fingerprint in [each["sha256"] for each in found]) == (
        4,
        True,
    )
    assert asking.ask(robot.new(), token=asking.token("/fleet/r3")).status == 200
