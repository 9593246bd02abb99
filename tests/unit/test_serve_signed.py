"""Robots whose keys TLS does not have sign what they ask, and attacks on that."""

import base64
import re
from datetime import UTC, datetime, timedelta

import pytest

from pqsec_pki.algorithms import load_private_key
from pqsec_pki.certificates import Certificate
from pqsec_pki.documents import DomainSet
from pqsec_pki.enrolment import Bundle, pins_in_use, validate_csrs
from pqsec_pki.errors import PqsecError
from pqsec_pki.est import (
    EstClient,
    KeyTerms,
    KnownServer,
    NotSignedError,
    RequestSigner,
    ServerTrust,
    client_context,
    deliver_receipt,
    enrol,
    renew,
    server_context,
    verify_signed,
)
from pqsec_pki.est.obtaining import installed
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue
from tests.fuzz.messages import PAIR
from tests.fuzz.people import DAY, KEYS_OF, NOW, authority, keys
from tests.fuzz.people import enrolled as person
from tests.some_keys import some_key
from tests.unit.serving import HOST, ROOT, Robot, Server, received, reply_in
from tests.unit.tls_sides import connected, identity, pin

PEM, PKCS10 = "application/x-pem-file", "application/pkcs10"
REQUESTS, BUNDLE = "/pqsec/v1/requests", "/pqsec/v1/bundle"
REFERENCE = ROOT / "docs/reference/rfc7030.md"
AGO = timedelta(days=200)


def clock():
    return datetime.now(UTC)


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    folder = tmp_path_factory.mktemp("signed")
    made = Server(folder, clock() - AGO, "hybrid", robots=6, renew="any-time")
    with made.running(measured=True):
        yield made


def signer_of(robot, certificate):
    return RequestSigner(certificate, (load_private_key(robot.key),))


def enrolled(server, folder, name):
    """A robot, and what it signs with."""
    robot = Robot(server, folder, name)
    reply = server.ask(robot.request, token=server.token(name))
    assert reply.status == 200, reply
    pem = Bundle.from_bytes(reply.body).enclaves[name]["cert.pem"]
    return robot, signer_of(robot, Certificate.from_pem(pem))


@pytest.fixture(scope="module")
def alice(server, tmp_path_factory):
    return enrolled(server, tmp_path_factory.mktemp("alice"), "/fleet/r1")


@pytest.fixture(scope="module")
def bob(server, tmp_path_factory):
    return enrolled(server, tmp_path_factory.mktemp("bob"), "/fleet/r2")


def send(link, method, path, body, headers):
    named = {"Host": HOST, "Connection": "close", "Content-Type": PEM, **headers}
    if body:
        named["Content-Length"] = len(body)
    pairs = [
        (key, each)
        for key, value in named.items()
        for each in (value if isinstance(value, list) else [value])
    ]
    lines = [f"{method} {path} HTTP/1.1", *(f"{key}: {value}" for key, value in pairs), "", ""]
    link.sendall("\r\n".join(lines).encode() + body)
    return reply_in(received(link))


def asked(server, signer, method, path, body=b""):
    """The answer to a request that is signed as it shall be."""
    with server.connect() as link:
        return send(link, method, path, body, signer.headers(link, method, path, body))


def test_a_robot_with_composite_keys_lives_with_its_server(server, tmp_path):
    name, token = "/fleet/r3", server.token("/fleet/r3")
    trust, secret = ServerTrust(pins=token.server_pins), (token.id, token.secret)
    client = EstClient(server=token.server, trust=trust, secret=secret)
    terms = KeyTerms(profile=server.keystore.profile, pins=pins_in_use(server.keystore))
    first = enrol(client, name, tmp_path, terms, clock=clock)
    deliver_receipt(tmp_path)
    for rekey in (False, True):
        [done] = renew(KnownServer.at(tmp_path), (), tmp_path, KeyTerms(), clock=clock, rekey=rekey)
        assert not isinstance(done, PqsecError), done
        assert done.renewed == rekey
        deliver_receipt(tmp_path)
    assert done.certificate.spki != first.certificate.spki
    assert installed(tmp_path)[name]["cert.pem"] == done.certificate.pem
    kinds = [each.kind for each in server.keystore.ledger() if each.name == name]
    assert kinds.count("participant") == kinds.count("receipt") == 2


def test_a_signed_renewal_gives_a_certificate_and_the_same_again(server, tmp_path):
    robot, signer = enrolled(server, tmp_path, "/fleet/r4")
    body = robot.new().pem
    replies = [asked(server, signer, "POST", REQUESTS, body) for _ in range(2)]
    assert [each.status for each in replies] == [200, 200]
    first, second = (Bundle.from_bytes(each.body).sha256 for each in replies)
    assert first == second
    late = asked(server, signer, "POST", REQUESTS, robot.new().pem)
    assert (late.status, late.detail) == (403, "this is not the current certificate of /fleet/r4")


def other_connection(server, link, signer, body):
    with server.connect() as other:
        return send(link, "POST", REQUESTS, body, signer.headers(other, "POST", REQUESTS, body))


def other_body(server, link, signer, body):
    del server
    return send(link, "POST", REQUESTS, body + b"\n", signer.headers(link, "POST", REQUESTS, body))


def other_path(server, link, signer, body):
    del server
    return send(link, "POST", REQUESTS, body, signer.headers(link, "POST", BUNDLE, body))


def other_method(server, link, signer, body):
    del server, body
    return send(link, "HEAD", BUNDLE, b"", signer.headers(link, "GET", BUNDLE, b""))


ELSEWHERE = [other_connection, other_body, other_path, other_method]


@pytest.mark.parametrize("attack", ELSEWHERE, ids=lambda each: each.__name__)
def test_a_signature_is_of_no_use_for_another_request(server, alice, attack):
    robot, signer = alice
    before = server.keystore.head
    with server.connect() as link:
        reply = attack(server, link, signer, robot.new().pem)
    assert reply.status == 401
    assert not reply.body or "is not signed for this connection" in reply.detail
    assert server.keystore.head == before


def repeated(headers, key):
    return {**headers, key: [headers[key]] * 2}


FORMS = {
    "another's key": lambda headers, bob: {**headers, "Authorization": bob["Authorization"]},
    "another's certificate": lambda headers, bob: {
        **headers,
        "PQSEC-Certificate": bob["PQSEC-Certificate"],
    },
    "no certificate": lambda headers, _: {"Authorization": headers["Authorization"]},
    "two certificates": lambda headers, _: repeated(headers, "PQSEC-Certificate"),
    "two headers": lambda headers, _: repeated(headers, "Authorization"),
    "no signature": lambda headers, _: {**headers, "Authorization": "PQSEC "},
    "two signatures": lambda headers, bob: {
        **headers,
        "Authorization": headers["Authorization"] + "," + bob["Authorization"].split()[1],
    },
    "not base64": lambda headers, _: {**headers, "Authorization": "PQSEC !!!!"},
    "no certificate at all": lambda headers, _: {**headers, "PQSEC-Certificate": "AAAA"},
}


@pytest.mark.parametrize("form", FORMS)
def test_only_the_holder_of_the_certificate_signs(server, alice, bob, form):
    body, before = alice[0].new().pem, server.keystore.head
    with server.connect() as link:
        mine, his = (each.headers(link, "POST", REQUESTS, body) for _, each in (alice, bob))
        reply = send(link, "POST", REQUESTS, body, FORMS[form](mine, his))
    assert reply.status in {400, 401}
    assert server.keystore.head == before


def test_a_robot_signs_for_its_own_name_only(server, alice, bob):
    reply = asked(server, bob[1], "POST", REQUESTS, alice[0].new().pem)
    assert (reply.status, reply.detail) == (403, "the client certificate is not for /fleet/r1")


def test_est_knows_no_signed_requests(server, alice):
    path = "/.well-known/est/simplereenroll"
    body = base64.b64encode(alice[0].new().der)
    with server.connect() as link:
        headers = alice[1].headers(link, "POST", path, body)
        reply = send(link, "POST", path, body, headers | {"Content-Type": PKCS10})
    assert (reply.status, reply.detail[:16]) == (400, "a signed request")


def test_who_shows_a_client_certificate_signs_for_nobody_else(server, alice, bob):
    """A relay with a certificate of its own could pass on what another one signed."""
    robot, signer = alice
    body, before = robot.new().pem, server.keystore.head
    own = identity("ecdsa-p256", owner="mallory")
    with server.connect(own) as link:
        reply = send(link, "POST", REQUESTS, body, signer.headers(link, "POST", REQUESTS, body))
    assert (reply.status, reply.detail) == (
        400,
        "a signed request is for paths of pqsec, and without a client certificate",
    )
    assert server.keystore.head == before


def test_a_revoked_robot_signs_in_vain(server, tmp_path):
    robot, signer = enrolled(server, tmp_path, "/fleet/r5")
    assert asked(server, signer, "GET", BUNDLE).status == 200
    server.cli("revoke", "/fleet/r5", "--yes")
    for each in (("GET", BUNDLE), ("POST", REQUESTS, robot.new().pem)):
        reply = asked(server, signer, *each)
        assert (reply.status, reply.detail) == (403, "the client certificate was revoked")


def test_an_expired_certificate_signs_in_vain(server, tmp_path):
    robot = Robot(server, tmp_path, "/fleet/r6")
    keystore = Keystore.open(server.root, to_change=True)
    keys = validate_csrs([robot.request], keystore.profiles, names=["/fleet/r6"])["/fleet/r6"]
    spec = ParticipantSpec(
        name="/fleet/r6", domains=DomainSet.of(0), validity=timedelta(days=30), keys=keys
    )
    issue(keystore, keystore.unlock(None), [spec], now=clock() - timedelta(days=100))
    pem = (server.root / "enclaves/fleet/r6/cert.pem").read_bytes()
    signer = signer_of(robot, Certificate.from_pem(pem))
    for each in (("GET", BUNDLE), ("POST", REQUESTS, robot.new().pem)):
        reply = asked(server, signer, *each)
        assert reply.status == 403
        assert reply.detail.startswith("its certificate expired")


def test_all_keys_of_a_certificate_sign():
    found = person(PAIR, "alice")
    shown = identity("ml-dsa-65")
    trust = ServerTrust(pins=frozenset({pin(shown)}))
    theirs, mine = connected(server_context([shown]), client_context(trust, HOST))
    signer = RequestSigner(found.certificate, tuple(keys(PAIR, KEYS_OF["alice"])))
    headers = signer.headers(mine, "GET", BUNDLE, b"")

    def verified(signatures):
        return verify_signed(
            theirs,
            method="GET",
            path=BUNDLE,
            body=b"",
            certificates=[headers["PQSEC-Certificate"]],
            signatures=signatures,
        )

    first, second = headers["Authorization"].removeprefix("PQSEC ").split(",")
    assert verified(f"{first},{second}").der == found.certificate.der
    for wrong in (first, second, f"{second},{first}", f"{first},{first}"):
        with pytest.raises(NotSignedError):
            verified(wrong)


def test_the_reference_has_the_sizes():
    rows = dict(re.findall(r"(?m)^\| `([^`]+)` \| (\d+ \| \d+) \|$", REFERENCE.read_text()))
    assert rows
    for kind, told in rows.items():
        names = kind.split(" and ")
        made = [some_key(each) for each in names]
        second = made[1].public_key if made[1:] else None
        certificate = authority(*names).issue(
            "/fleet/robot1", made[0].public_key, alternative=second, now=NOW, validity=30 * DAY
        )
        signatures = [base64.b64encode(each.sign(b"x")) for each in made]
        found = len(base64.b64encode(certificate.der)), len(b",".join(signatures))
        for size, expected in zip(found, map(int, told.split(" | ")), strict=True):
            assert abs(size - expected) <= 8  # ECDSA's signatures in DER differ by some octets
