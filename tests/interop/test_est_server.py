"""The robot's client at an EST server of others: libest's, of Debian 13."""

import socket
import subprocess
import time
from contextlib import contextmanager, suppress
from datetime import UTC, datetime

import pytest
from cryptography.hazmat.primitives.serialization import Encoding, pkcs7

from pqsec_pki.algorithms import SIGNATURES, private_key_pem
from pqsec_pki.certificates import Certificate, certificate_request
from pqsec_pki.errors import PqsecError, VerificationError
from pqsec_pki.est import EST, PKCS10, EstClient, ServerTrust, TlsIdentity, from_base64, to_base64
from tests.ports import free_port
from tests.unit.serving import HOST, PATIENCE
from tests.unit.tls_sides import certificate

pytestmark = [pytest.mark.interop, pytest.mark.timeout(120)]

KIND = "ecdsa-p256"
CONFIGURATION = """
[ca]
default_ca = own
[own]
database = index.txt
new_certs_dir = .
certificate = ca.pem
private_key = ca.key
serial = serial
default_days = 30
default_md = sha256
policy = any
x509_extensions = client
unique_subject = no
[any]
commonName = supplied
[client]
basicConstraints = CA:FALSE
keyUsage = digitalSignature
"""
ENVIRONMENT = {
    "EST_TRUSTED_CERTS": "ca.pem",
    "EST_CACERTS_RESP": "ca.pem",
    "EST_OPENSSL_CACONFIG": "ca.cnf",
}


@contextmanager
def estserver(clients):
    """Its URL; its CA issues for clients, and issued its own certificate."""
    now, folder = datetime.now(UTC), clients.folder
    ca, ca_key = certificate(KIND, owner="est CA", since=now, ca=True)
    chain, key = certificate(KIND, issuer="est CA", since=now)
    files = {"ca.pem": ca, "ca.key": ca_key, "own.pem": chain + key, "serial": b"01\n"}
    for name, data in (files | {"index.txt": b"", "ca.cnf": CONFIGURATION.encode()}).items():
        (folder / name).write_bytes(data)
    port = free_port()
    words = ("-c", "own.pem", "-k", "own.pem", "-r", "estrealm", "-o", "-p", str(port))
    variables = [f"{name}={value}" for name, value in ENVIRONMENT.items()]
    line = clients.line("env", *variables, "estserver", *words)
    with (folder / "log").open("wb") as log, subprocess.Popen(line, stdout=log, stderr=log) as ran:
        try:
            until = time.monotonic() + PATIENCE
            while time.monotonic() < until and ran.poll() is None:
                with suppress(ConnectionRefusedError):
                    socket.create_connection((HOST, port)).close()
                    break
                time.sleep(0.05)
            yield f"https://{HOST}:{port}"
        finally:
            ran.kill()


def certificates_in(answer):
    found = pkcs7.load_der_pkcs7_certificates(from_base64(answer.body))
    return [Certificate.from_pem(each.public_bytes(Encoding.PEM)) for each in found]


def test_the_client_enrols_and_renews_at_the_server_of_libest(est_clients):
    with estserver(est_clients) as url:
        ca = (est_clients.folder / "ca.pem").read_bytes()
        trust = ServerTrust(authorities=ca)

        def client(**shown):
            return EstClient(server=url, trust=trust, classical=True, **shown)

        [found] = certificates_in(client().get(f"{EST}/cacerts"))
        assert found.der == Certificate.from_pem(ca).der
        first, second = (SIGNATURES.named(KIND).generate() for _ in range(2))
        asked = to_base64(certificate_request("/fleet/r1", first).der)
        with pytest.raises(VerificationError, match="answers 401"):
            client().post(f"{EST}/simpleenroll", asked, PKCS10)
        known = client(secret=("estuser", "estpwd"))
        [mine] = certificates_in(known.post(f"{EST}/simpleenroll", asked, PKCS10))
        assert (mine.spki, mine.subject_name) == (first.public_key.spki, "CN=/fleet/r1")
        own = client(identity=TlsIdentity.of(mine.pem, private_key_pem(first)))
        asked = to_base64(certificate_request("/fleet/r1", second).der)
        [renewed] = certificates_in(own.post(f"{EST}/simplereenroll", asked, PKCS10))
        assert renewed.spki == second.public_key.spki
        with pytest.raises(PqsecError, match=r"not on X25519MLKEM768|protocol version"):
            EstClient(server=url, trust=trust).get(f"{EST}/cacerts")
