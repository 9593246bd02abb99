"""Devices enrol with the certificate of their factory: which ones, as what, and how often."""

import base64
from dataclasses import replace
from datetime import UTC, datetime

import pytest

from pqsec_pki.certificates import Certificate, certificate_request
from pqsec_pki.domain import Device, read_domain
from pqsec_pki.enrolment import Bundle, pin_texts, pins_in_use
from pqsec_pki.errors import InvalidDocumentError, UsageError, VerificationError
from pqsec_pki.server.configuration import FactoryFiles
from pqsec_pki.server.factories import Factory, factory_of
from pqsec_pki.server.requester import NotAdmittedError
from tests.some_keys import some_key
from tests.unit.factory import DAY, SERVERS_ONLY, Maker
from tests.unit.serving import DOMAIN, Robot, Server

PKCS10 = "application/pkcs10"
INVENTORY = {
    "/fleet/r1": "acme:serialNumber=SN-1",
    "/fleet/r2": '"acme:subject=serialNumber=SN-2,O=Acme"',
    "/fleet/r3": "acme:serialNumber=SN-3",
    "/other": "bolt:serialNumber=SN-4",
}


def domain(profile="pq"):
    """The domain of the tests, with the device of each robot."""
    head = DOMAIN.format(profile=profile).partition("participants:")[0]
    lines = [
        f"  - {{name: {name}, role: robot, request: requests/, idevid: {device}}}\n"
        for name, device in INVENTORY.items()
    ]
    return f"{head}participants:\n{''.join(lines)}"


@pytest.fixture(scope="module")
def maker():
    return Maker(datetime.now(UTC))


@pytest.fixture(scope="module")
def server(maker, tmp_path_factory):
    folder = tmp_path_factory.mktemp("serve")
    maker.put(folder, line=[7])
    acme = {"cas": "acme.pem", "revocation_lists": ["root.crl", "line.crl"]}
    bolt = {"cas": "acme.pem", "again": True}
    made = Server(folder, datetime.now(UTC), factories={"acme": acme, "bolt": bolt})
    (folder / "domain.yaml").write_text(domain())
    with made.running(measured=True):
        yield made


def admissions(server):
    with server.keystore.open_ledger() as ledger:
        return [(each.name, dict(each.details)) for each in ledger.of_kind("admission")]


def test_a_device_enrols_once_with_the_certificate_of_its_factory(server, maker, tmp_path):
    device = maker.device("SN-1")
    for name, data in {"d.pem": device.chain, "d.key": device.key}.items():
        (server.folder / name).write_bytes(data)
    pins = [f"--server-pin={each}" for each in server.pins()]
    cas = [f"--ca-fingerprint={each}" for each in pin_texts(pins_in_use(server.keystore))]
    words = (
        *("enrol", f"https://127.0.0.1:{server.port}", "--name", "/fleet/r1"),
        *("--profile", "pq", *pins, *cas),
    )
    factory = ("--factory-cert", "d.pem", "--factory-key", "d.key", "--dir")
    server.cli(*words, *factory, str(tmp_path / "dds"))
    line = ("device acme:serialNumber=SN-1", Certificate.from_pem(device.chain).fingerprint)
    assert [(by, each["certificate"]) for by, each in admissions(server)] == [line]
    renewed = server.cli(
        "renew", "--from", words[1], "--rekey", "--dir", str(tmp_path / "dds"), check=False
    )
    assert "is not due" in renewed.stderr  # by its own certificate, as every robot
    again = server.cli(*words, *factory, str(tmp_path / "other"), check=False)
    assert (again.returncode, "has enrolled as /fleet/r1 before" in again.stderr) == (1, True)


def test_a_lost_answer_is_given_again_and_another_is_not(server, maker, tmp_path):
    robot, device = Robot(server, tmp_path, "/fleet/r2"), maker.device("SN-2")
    replies = [server.ask(robot.request, identity=device) for _ in range(2)]
    assert [each.status for each in replies] == [200, 200]
    assert replies[0].headers["etag"] == replies[1].headers["etag"]
    own = robot.identity(Bundle.from_bytes(replies[0].body))
    assert server.send("GET", "/pqsec/v1/bundle", identity=own).status == 200
    reply = server.ask(robot.new(), identity=device)
    assert (reply.status, "before" in reply.detail) == (403, True)


def test_a_device_enrols_again_where_that_is_allowed(server, maker, tmp_path):
    robot, device = Robot(server, tmp_path, "/other"), maker.device("SN-4")
    for _ in range(2):
        assert server.ask(robot.new(), identity=device).status == 200
    server.cli("revoke", "/other", "--yes")
    reply = server.ask(robot.new(), identity=device)
    assert (reply.status, reply.detail) == (403, "/other was revoked")


def test_a_device_replaces_no_certificate_that_somebody_has(server, maker, tmp_path):
    request = Robot(server, tmp_path / "a", "/fleet/r3").request
    assert server.ask(request, token=server.token("/fleet/r3")).status == 200
    other = Robot(server, tmp_path / "b", "/fleet/r3").request
    reply = server.ask(other, identity=maker.device("SN-3"))
    assert (reply.status, reply.detail) == (409, "/fleet/r3 has a certificate for another key")


REFUSED = {
    "of another CA with the same name": (403, "the factory certificate is refused"),
    "without the CA between": (403, "unable to get local issuer certificate"),
    "expired": (403, "certificate has expired"),
    "not valid yet": (403, "certificate is not yet valid"),
    "revoked by the factory": (403, "was revoked on"),
    "a CA": (403, "it is the certificate of a CA"),
    "may not sign": (403, "keyUsage lacks digitalSignature"),
    "for servers": (403, "extKeyUsage lacks clientAuth"),
    "not in the inventory": (403, "the domain file has another device for /fleet/r3"),
    "the name of another": (403, "the domain file has another device for /fleet/r2"),
    "not in the domain file": (403, "/fleet/r9 is not in the domain file"),
    "the factory's key": (403, "the request is for the factory's key"),
    "another's proof": (400, "no proof that the requester has the private key"),
}


SHOWN = {
    "of another CA with the same name": lambda maker: Maker(maker.now, "mallory").device("SN-3"),
    "without the CA between": lambda maker: alone(maker.device("SN-3")),
    "expired": lambda maker: maker.device("SN-3", since=maker.now - 10 * DAY),
    "not valid yet": lambda maker: maker.device("SN-3", since=maker.now + DAY),
    "revoked by the factory": lambda maker: maker.device("SN-3", serial=7),
    "a CA": lambda maker: maker.device("SN-3", ca=True),
    "may not sign": lambda maker: maker.device("SN-3", signs=False),
    "for servers": lambda maker: maker.device("SN-3", purposes=SERVERS_ONLY),
    "not in the inventory": lambda maker: maker.device("SN-5"),
}
NAMES = {"the name of another": "/fleet/r2", "not in the domain file": "/fleet/r9"}


def alone(shown):
    return replace(shown, chain=Certificate.from_pem(shown.chain).pem)


@pytest.mark.parametrize("what", REFUSED)
def test_no_other_device_gets_a_certificate(server, maker, tmp_path, what):
    device = SHOWN.get(what, lambda maker: maker.device("SN-3"))(maker)
    name = NAMES.get(what, "/fleet/r3")
    body = Robot(server, tmp_path, name).request.der
    if what == "the factory's key":
        body = certificate_request(name, some_key("ecdsa-p256", "acme device SN-3")).der
    if what == "another's proof":
        body = body[:-1] + bytes([body[-1] ^ 1])
    status, detail = REFUSED[what]
    before = server.keystore.head
    reply = server.post("/pqsec/v1/requests", body, PKCS10, identity=device)
    assert (reply.status, detail in reply.detail) == (status, True), reply.detail
    assert server.keystore.head == before


def test_a_factory_certificate_renews_and_fetches_nothing(server, maker, tmp_path):
    robot, device = Robot(server, tmp_path, "/fleet/r3"), maker.device("SN-3")
    path = "/.well-known/est/simplereenroll"
    body = base64.b64encode(robot.request.der)
    for reply in (
        server.post(path, body, PKCS10, identity=device),
        server.send("GET", "/pqsec/v1/bundle", identity=device),
    ):
        assert (reply.status, reply.detail) == (403, "the client certificate was not issued here")


# Without a server


def factory_at(folder, authorities, **choices):
    (folder / "cas.pem").write_bytes(authorities)
    return Factory.read(FactoryFiles(folder / "cas.pem", **choices), ())


def test_with_lists_each_ca_needs_one(maker, tmp_path):
    (tmp_path / "root.crl").write_bytes(maker.revoked("root"))
    factory = factory_at(tmp_path, maker.root, lists=(tmp_path / "root.crl",))
    device, line = map(Certificate.from_pem, (maker.device("SN-1").chain, maker.line))
    with pytest.raises(VerificationError, match="no revocation list of CN=line"):
        factory.verify(device, [line.der], maker.now)


def test_an_old_list_admits_nobody(maker, tmp_path):
    (tmp_path / "line.crl").write_bytes(maker.revoked("line"))
    factory = factory_at(tmp_path, maker.line, lists=(tmp_path / "line.crl",))
    device = Certificate.from_pem(maker.device("SN-1").chain)
    factory.verify(device, [], maker.now)
    with pytest.raises(VerificationError, match="the revocation list ended"):
        factory.verify(device, [], maker.now + 2 * DAY)


def test_the_time_is_that_of_the_signer(maker, tmp_path):
    factory = factory_at(tmp_path, maker.line)
    device = Certificate.from_pem(maker.device("SN-1").chain)
    with pytest.raises(VerificationError, match="certificate has expired"):
        factory.verify(device, [], maker.now + 20 * DAY)


def test_a_broken_digest_is_refused(maker, tmp_path):
    factory = factory_at(tmp_path, maker.line)
    device = Certificate.from_pem(maker.device("SN-1").chain)
    # cryptography signs nothing with SHA-1, so only what is looked at says so: ecdsa-with-SHA1
    device = replace(device, identifier=bytes.fromhex("300906072a8648ce3d0401"))
    with pytest.raises(VerificationError, match="SHA-1, which is no longer safe"):
        factory.verify(device, [], maker.now)


def test_a_factory_that_the_server_does_not_know_admits_nobody(server, maker):
    found = Certificate.from_pem(maker.device("SN-4").chain)
    member = read_domain(server.folder / "domain.yaml").members["/other"]
    with pytest.raises(NotAdmittedError, match=r"serve\.yaml has no factory bolt"):
        factory_of(member, found, {})


def test_a_long_path_is_not_followed(maker, tmp_path):
    factory, line = factory_at(tmp_path, maker.root), Certificate.from_pem(maker.line)
    device = Certificate.from_pem(maker.device("SN-1").chain)
    with pytest.raises(VerificationError, match="more than 8 certificates"):
        factory.verify(device, [line.der] * 9, maker.now)


def test_a_ca_of_the_domain_is_no_factory(server):
    (server.folder / "own.pem").write_bytes(server.keystore.identity_ca.pem)
    files = FactoryFiles(server.folder / "own.pem")
    with pytest.raises(UsageError, match="is a CA of the domain"):
        Factory.read(files, server.keystore.anchors.identity_cas)


@pytest.mark.parametrize(
    "text", ["SN-1", "acme:SN-1", "acme:serial=1", "acme:sha256=AB", ":subject=x", "acme:subject= "]
)
def test_a_device_is_named_in_one_of_three_ways(text):
    with pytest.raises(UsageError):
        Device.of(text)


def test_a_device_is_known_by_its_fingerprint(maker):
    found = Certificate.from_pem(maker.device("SN-1").chain)
    assert Device.of(f"acme:sha256={found.fingerprint}").has(found)
    assert not Device.of(f"acme:sha256={'0' * 64}").has(found)


def test_a_column_of_the_inventory_has_the_devices(tmp_path):
    (tmp_path / "robots.csv").write_text("name,idevid\n/r1,acme:serialNumber=SN-1\n/r2,\n")
    text = "name: Lab\nroles: {robot: {publish: [rt/x]}}\nparticipants:\n"
    path = tmp_path / "domain.yaml"
    path.write_text(f"{text}  - {{csv: robots.csv, role: robot, request: requests/}}\n")
    found = read_domain(path).members
    assert (str(found["/r1"].device), found["/r2"].device) == ("acme:serialNumber=SN-1", None)
    (tmp_path / "robots.csv").write_text("name,idevid\n/r1,SN-1\n")
    with pytest.raises(InvalidDocumentError, match="names no device"):
        read_domain(path)
