"""Foreign EST clients at our server: curl and OpenSSL, classical and post-quantum."""

import base64
import os
import shutil
import subprocess
from datetime import UTC, datetime

import pytest

from pqsec_pki.certificates import Certificate
from tests.unit.serving import HOST, Robot, Server

EST = "/.well-known/est"


def run(folder, *command, data=None):
    done = subprocess.run(
        command, cwd=folder, input=data, capture_output=True, check=False, timeout=60
    )
    return done.returncode, done.stdout, done.stderr


@pytest.mark.slow
def test_curl_and_openssl_enrol_and_renew_by_est(requires, tmp_path):
    """Debian's own: OpenSSL 3.0 and TLS 1.3 without ML-KEM, so `classical: true`."""
    server = Server(
        tmp_path, datetime.now(UTC), profile="classical", classical=True, renew="any-time"
    )
    requires(shutil.which("curl"), "curl", "apt-get install curl")
    name, token = "/fleet/r1", server.token("/fleet/r1")
    with server.running():
        url = f"https://{HOST}:{server.port}{EST}"
        known = ["--silent", "--show-error", "--fail", "--cacert", "1.pem"]

        def curl(path, *more, data=None):
            code, out, said = run(tmp_path, "curl", *known, *more, f"{url}{path}", data=data)
            assert code == 0, said
            return base64.b64decode(out)

        def certificates(der):
            code, out, said = run(
                tmp_path, "openssl", "pkcs7", "-inform", "DER", "-print_certs", data=der
            )
            assert code == 0, said
            return out

        def asked(key):
            words = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes")
            code, der, said = run(
                tmp_path,
                *("openssl", "req", "-new", *words, "-keyout", key, "-outform", "DER"),
                *("-subj", "/CN=" + name.replace("/", "\\/")),
            )
            assert code == 0, said
            return base64.encodebytes(der)

        (tmp_path / "cas.pem").write_bytes(certificates(curl("/cacerts")))
        assert b"\x06\x08\x2a\x86\x48\xce\x3d\x03\x01\x07" in curl("/csrattrs")  # prime256v1
        sent = ("-H", "Content-Type: application/pkcs10", "--data-binary", "@-")
        user = ("--user", f"{token.id}:{token.secret}")
        first = curl("/simpleenroll", *user, *sent, data=asked("first.key"))
        (tmp_path / "first.pem").write_bytes(certificates(first))
        own = ("--cert", "first.pem", "--key", "first.key")
        second = curl("/fleet/simplereenroll", *own, *sent, data=asked("second.key"))
        (tmp_path / "second.pem").write_bytes(certificates(second))
        for each in ("first.pem", "second.pem"):
            code, _, said = run(tmp_path, "openssl", "verify", "-CAfile", "cas.pem", each)
            assert code == 0, said
        found = Certificate.from_pem((tmp_path / "second.pem").read_bytes())
        assert found.subject_name == f"CN={name}"
        code, _, said = run(tmp_path, "curl", *known, *sent, f"{url}/simpleenroll", data=b"AA==")
        assert (code, b"400" in said) == (22, True)


def test_openssl_agrees_on_the_post_quantum_group_only(tmp_path, openssl35):
    server = Server(tmp_path, datetime.now(UTC))
    asking = b"GET /pqsec/v1/head HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n"
    trust = ("-CAfile", "0.pem", "-verify_return_error", "-ign_eof")
    went = {}
    with server.running():
        for groups in ("X25519MLKEM768", "X25519", "MLKEM768"):
            link = ("s_client", "-connect", f"{HOST}:{server.port}", "-groups", groups)
            went[groups] = run(tmp_path, openssl35.path, *link, *trust, data=asking)
    served = [groups for groups, (_, out, _) in went.items() if b"HTTP/1.1 200 OK" in out]
    assert served == ["X25519MLKEM768"], went
    code, out, _ = went["X25519MLKEM768"]
    assert code == 0
    assert b"Negotiated TLS1.3 group: X25519MLKEM768" in out
    assert b"Peer signature type: mldsa65" in out


def test_openssl_renews_with_an_ml_dsa_certificate(tmp_path, openssl35):
    server = Server(tmp_path, datetime.now(UTC), renew="any-time")
    robot = Robot(server, tmp_path / "robot")
    with server.running():
        assert server.ask(robot.request, token=server.token("/fleet/r1")).status == 200
        enclave = server.root / "enclaves/fleet/r1"
        (tmp_path / "own.key").write_bytes(robot.key)
        body = base64.b64encode(robot.new().der)
        lines = [
            f"POST {EST}/simplereenroll HTTP/1.1",
            f"Host: {HOST}",
            "Content-Type: application/pkcs10",
            f"Content-Length: {len(body)}",
            "Connection: close",
        ]
        asking = "\r\n".join([*lines, "", ""]).encode() + body
        link = ("s_client", "-connect", f"{HOST}:{server.port}", "-quiet", "-ign_eof")
        own = ("-cert", os.fspath(enclave / "cert.pem"), "-key", "own.key")
        _, out, said = run(tmp_path, openssl35.path, *link, *own, data=asking)
    assert out.startswith(b"HTTP/1.1 200 OK"), (out, said)
