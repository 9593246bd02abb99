"""What RFC 7030, 8951 and 9908 ask of an EST server. docs/reference/rfc7030.md lists all of it."""

import base64
import socket
from contextlib import contextmanager
from datetime import UTC, datetime

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding, pkcs7
from cryptography.x509.oid import AttributeOID, ExtendedKeyUsageOID, NameOID
from OpenSSL import SSL

from pqsec_pki._asn1 import ContentInfo, decode
from pqsec_pki.algorithms import SIGNATURES, load_private_key
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import VerificationError
from pqsec_pki.est import (
    EST,
    ServerTrust,
    TlsIdentity,
    client_context,
    request_attributes,
    server_context,
)
from pqsec_pki.server import begin_server
from pqsec_pki.server.call import CallKind, SignerCall
from pqsec_pki.server.call_handling import CallHandler
from pqsec_pki.server.waiting import WaitingRequests
from pqsec_pki.server.waiting_folder import RequestFolder
from tests.unit.keystores import DAY, NOW, made
from tests.unit.serving import HOST, PATIENCE, Robot, Server, received, reply_in
from tests.unit.test_overlap import begin
from tests.unit.tls_sides import connected

PKCS7 = "application/pkcs7-mime; smime-type=certs-only"
PKCS10 = "application/pkcs10"


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """With classical TLS too, which all clients of EST have; and with an approver."""
    made = Server(
        tmp_path_factory.mktemp("serve"),
        datetime.now(UTC),
        "classical",
        classical=True,
        renew="any-time",
        approval=True,
    )
    with made.running():
        yield made


@pytest.fixture
def robot(server, tmp_path):
    """A robot that is enrolled, and its identity in TLS."""
    found = Robot(server, tmp_path, "/fleet/r1")
    token = server.token("/fleet/r1", replaces=True)
    assert posted(server, "simpleenroll", found.request.der, token=token).status == 200
    return found, found.identity(server.bundle("/fleet/r1"))


def posted(server, operation, der, **options):
    return server.post(f"{EST}/{operation}", base64.encodebytes(der), PKCS10, **options)


def certificates_in(reply):
    """The certificates of a Simple PKI Response, which has nothing else."""
    assert (reply.status, reply.headers["content-type"]) == (200, PKCS7), reply
    der = base64.b64decode(reply.body.replace(b"\r\n", b""), validate=True)
    signed = decode(ContentInfo, der, "Simple PKI Response").content
    assert (signed.version, signed.crls) == (1, None)
    assert signed.signer_infos.as_list() == []
    found = pkcs7.load_der_pkcs7_certificates(der)
    return [Certificate.from_pem(each.public_bytes(Encoding.PEM)) for each in found]


def request_with(name="/fleet/r2", *, key=None, challenge=None, names=()):
    """A request in DER, as other programs make it."""
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    builder = x509.CertificateSigningRequestBuilder().subject_name(subject)
    if challenge is not None:
        builder = builder.add_attribute(AttributeOID.CHALLENGE_PASSWORD, challenge)
    if names:
        names = x509.SubjectAlternativeName([x509.DNSName(each) for each in names])
        builder = builder.add_extension(names, critical=False)
    made = builder.sign(key or ec.generate_private_key(ec.SECP256R1()), SHA256())
    return made.public_bytes(Encoding.DER)


# 3.2.2: paths


@pytest.mark.parametrize("label", ["", "/fleet", "/other"])
@pytest.mark.parametrize("operation", ["cacerts", "csrattrs"])
def test_each_operation_is_there_with_and_without_a_label(server, label, operation):
    assert server.send("GET", f"{EST}{label}/{operation}").status == 200


@pytest.mark.parametrize("operation", ["fullcmc", "serverkeygen"])
def test_what_is_optional_and_not_there_is_not_found(server, operation):
    assert posted(server, operation, request_with()).status == 404


# 3.2.3 and 3.3: authentication, and TLS


def test_a_password_is_asked_for_in_the_form_of_http(server):
    token = server.token("/other")  # of another server, or used up
    reply = server.post(
        f"{EST}/simpleenroll",
        base64.b64encode(request_with()),
        PKCS10,
        Authorization="Basic " + base64.b64encode(f"{token.id}:x".encode()).decode(),
    )
    assert (reply.status, reply.headers["www-authenticate"]) == (401, 'Basic realm="pqsec"')
    assert "not known" in reply.detail
    first = posted(server, "simplereenroll", request_with())
    assert (first.status, first.headers["www-authenticate"]) == (401, 'Basic realm="pqsec"')
    assert (first.headers["content-length"], first.body) == ("0", b"")


@pytest.mark.parametrize(
    ("version", "ciphers", "alert"),
    [
        (SSL.TLS1_VERSION, b"ALL:@SECLEVEL=0", "protocol version"),
        (SSL.TLS1_1_VERSION, b"ALL:@SECLEVEL=0", "protocol version"),
        (SSL.TLS1_2_VERSION, b"eNULL:@SECLEVEL=0", "handshake failure"),
        (SSL.TLS1_2_VERSION, b"aNULL:@SECLEVEL=0", "handshake failure"),
    ],
)
def test_old_tls_and_weak_ciphers_are_refused(server, version, ciphers, alert):
    context = client_context(ServerTrust(pins=server.pins()), HOST, classical=True)
    context.set_min_proto_version(version)
    context.set_max_proto_version(version)
    context.set_cipher_list(ciphers)
    with pytest.raises(SSL.Error, match=alert), linked(server, context):
        pass


@contextmanager
def linked(server, context):
    """A connection after the handshake."""
    with socket.create_connection((HOST, server.port), PATIENCE) as plain:
        plain.settimeout(None)
        link = SSL.Connection(context, plain)
        link.set_connect_state()
        link.do_handshake()
        yield link


@pytest.mark.parametrize("kind", ["tls-pq", "tls-classical"])
@pytest.mark.parametrize("host", ["est.example", "192.0.2.7", "127.0.0.1"])
def test_the_first_certificates_are_of_a_server_and_not_of_a_ca(tmp_path, kind, host):
    now = datetime.now(UTC)
    begin_server(f"https://{host}:8443", tmp_path / "serve.yaml", tmp_path / "k", now=now)
    reached = "127.0.0.1" if host == "127.0.0.1" else "0.0.0.0"  # noqa: S104
    assert f"listen: {reached}:8443\n" in (tmp_path / "serve.yaml").read_text()
    chain, key = ((tmp_path / f"{kind}.{end}").read_bytes() for end in ("pem", "key"))
    found = Certificate.from_pem(chain)
    assert not found.extension(x509.BasicConstraints).ca
    usage = found.extension(x509.KeyUsage)
    assert (usage.digital_signature, usage.key_cert_sign, usage.crl_sign) == (True, False, False)
    assert list(found.extension(x509.ExtendedKeyUsage)) == [ExtendedKeyUsageOID.SERVER_AUTH]
    client = client_context(ServerTrust(authorities=chain), host)
    connected(server_context([TlsIdentity.of(chain, key)]), client)
    other = client_context(ServerTrust(authorities=chain), "other.example")
    with pytest.raises(VerificationError, match="is not for other"):
        connected(server_context([TlsIdentity.of(chain, key)]), other)


# 3.4 and 3.5: proof of possession, and its link to the connection


def test_a_request_without_proof_of_possession_is_refused(server, robot):
    der = robot[0].new().der
    reply = posted(server, "simplereenroll", der[:-1] + bytes([der[-1] ^ 1]), identity=robot[1])
    assert (reply.status, "no proof" in reply.detail) == (400, True)


@pytest.mark.parametrize("version", [SSL.TLS1_2_VERSION, SSL.TLS1_3_VERSION])
@pytest.mark.parametrize("bound", ["this connection", "another", "nothing"])
def test_a_request_is_linked_to_its_connection(server, version, bound):
    name = "/fleet/r2" if version == SSL.TLS1_2_VERSION else "/fleet/r3"
    context = client_context(ServerTrust(pins=server.pins()), HOST, classical=True)
    context.set_max_proto_version(version)
    with linked(server, context) as link, linked(server, context) as other:
        bindings = {"this connection": binding(link), "another": binding(other), "nothing": None}
        body = base64.b64encode(request_with(name, challenge=bindings[bound]))
        head = (
            f"POST {EST}/simpleenroll HTTP/1.1\r\nHost: x\r\nContent-Type: {PKCS10}\r\n"
            f"Content-Length: {len(body)}\r\nConnection: close\r\n\r\n"
        )
        link.sendall(head.encode() + body)
        reply = reply_in(received(link))
    if bound == "another":
        assert (reply.status, "channel binding" in reply.detail) == (400, True)
    else:
        assert reply.status == 202  # it waits for its approval


def binding(link):
    """What RFC 5929 and RFC 9266 say, on the client's side."""
    if link.get_protocol_version() == SSL.TLS1_2_VERSION:
        return base64.b64encode(link.get_finished())
    return base64.b64encode(link.export_keying_material(b"EXPORTER-Channel-Binding", 32, b""))


# 4.1: CA certificates


def test_the_ca_certificates_are_for_everybody(server):
    reply = server.send("GET", f"{EST}/cacerts")
    assert [each.der for each in certificates_in(reply)] == [server.keystore.identity_ca.der]


def test_the_next_ca_is_given_beside_the_current_one(tmp_path):
    keystore = made(tmp_path / "k", "classical")
    begin(keystore)
    waiting = WaitingRequests(RequestFolder(tmp_path / "waiting"), 1)
    handler = CallHandler(keystore, keystore.unlock(None), None, lambda: NOW + DAY, waiting)
    [answer] = handler.answers([SignerCall(kind=CallKind.CA_CERTIFICATES)])
    found = pkcs7.load_der_pkcs7_certificates(base64.b64decode(answer.body))
    assert len({each.public_bytes(Encoding.DER) for each in found}) == 2


# 4.2: requests


@pytest.mark.parametrize(
    "encoded",
    [
        base64.b64encode,
        base64.encodebytes,
        lambda der: b"\r\n\t" + base64.b64encode(der).replace(b"A", b"A \r\n") + b"\n",
    ],
)
def test_base64_is_read_with_any_white_space_and_header(server, encoded, tmp_path):
    robot = Robot(server, tmp_path, "/fleet/r3")
    reply = server.post(
        f"{EST}/fleet/simpleenroll",
        encoded(robot.request.der),
        f"{PKCS10.upper()}; charset=x",
        token=server.token("/fleet/r3", replaces=True),
        Content_Transfer_Encoding="binary",
    )
    [found] = certificates_in(reply)
    assert (found.subject_name, found.spki) == ("CN=/fleet/r3", robot.request.spki)


def test_a_renewal_is_for_the_same_name_and_for_any_key(server, robot, tmp_path):
    found, identity = robot
    old = server.bundle("/fleet/r1")
    same = request_with("/fleet/r1", key=load_private_key(found.key).handle)
    [renewed] = certificates_in(posted(server, "simplereenroll", same, identity=identity))
    before = Certificate.from_pem(old.enclaves["/fleet/r1"]["cert.pem"])
    assert (renewed.spki == before.spki, renewed.serial_number == before.serial_number) == (1, 0)
    identity = found.identity(server.bundle("/fleet/r1"))
    other = Robot(server, tmp_path, "/fleet/r2").request.der
    refused = posted(server, "simplereenroll", other, identity=identity)
    assert (refused.status, refused.detail) == (403, "the client certificate is not for /fleet/r2")
    named = request_with("/fleet/r1", names=["other.example"])
    refused = posted(server, "simplereenroll", named, identity=identity)
    assert (refused.status, "alternative names" in refused.detail) == (400, True)
    [rekeyed] = certificates_in(
        posted(server, "simplereenroll", found.new().der, identity=identity)
    )
    assert rekeyed.spki != before.spki


def test_a_renewal_needs_the_certificate(server):
    token = server.token("/fleet/r2")
    reply = posted(server, "simplereenroll", request_with(), token=token)
    assert (reply.status, "show the current certificate" in reply.detail) == (401, True)


def test_who_waits_is_told_for_how_long_and_then_asks_the_same(server):
    der = request_with("/other")
    for _ in range(2):
        reply = posted(server, "simpleenroll", der)
        assert (reply.status, reply.headers["retry-after"]) == (202, "60")
        assert reply.headers["content-type"].startswith("text/plain")
        assert b"waits for approval" in reply.body
    fingerprint = reply.body.split()[-1].decode()
    server.cli("requests", "approve", fingerprint[:16], "--config", "serve.yaml")
    first, again = (certificates_in(posted(server, "simpleenroll", der)) for _ in range(2))
    assert [each.der for each in first] == [each.der for each in again]


@pytest.mark.parametrize("body", [b"", b"AAAA", b"!", base64.b64encode(b"\x30\x00")])
def test_an_error_has_words(server, body):
    reply = server.post(f"{EST}/simpleenroll", body, PKCS10)
    assert (reply.status, reply.headers["content-type"]) == (400, "application/problem+json")
    assert len(reply.detail) > 10


# 4.5: the attributes of a request


def test_the_attributes_are_for_everybody(server):
    reply = server.send("GET", f"{EST}/csrattrs")
    assert (reply.status, reply.headers["content-type"]) == (200, "application/csrattrs")
    profile = server.keystore.profile
    assert base64.b64decode(reply.body) == request_attributes(profile.participant_key, None)


EC = "301506072a8648ce3d0201310a06082a8648ce3d030107" + "06082a8648ce3d040302"
"""id-ecPublicKey with prime256v1; and ecdsa-with-SHA256, the OID of a signature."""
ML_DSA = "0609608648016503040312"
ATTRIBUTES = {
    "ecdsa-p256": EC,
    # rsaEncryption with 2048 bits, sha256WithRSAEncryption
    "rsa-2048": "301106092a864886f70d01010131040202080006092a864886f70d01010b",
    # id-ml-dsa-65 as the type of the key, with no more terms
    "ml-dsa-65": f"300d{ML_DSA}3100{ML_DSA}",
    # subjectAltPublicKeyInfo, altSignatureValue, and altSignatureAlgorithm with its value
    "ecdsa-p256 ml-dsa-65": f"{EC}0603551d480603551d4a30140603551d49310d300b{ML_DSA}",
}


@pytest.mark.parametrize("kinds", ATTRIBUTES)
def test_the_attributes_say_which_keys_and_signature(kinds):
    expected = bytes.fromhex(ATTRIBUTES[kinds])
    first, second, *_ = (*map(SIGNATURES.named, kinds.split()), None)
    assert request_attributes(first, second) == bytes([0x30, len(expected)]) + expected
