"""TLS of enrolment with OpenSSL's own server: the group, the kinds of keys, and the pin."""

import socket
import subprocess
import time
from contextlib import contextmanager

import pytest

from pqsec_pki.errors import PqsecError, VerificationError
from pqsec_pki.est import EstClient, ServerTrust
from tests.ports import free_port
from tests.unit.tls_sides import HOST, certificate, identity, pin

pytestmark = [pytest.mark.interop, pytest.mark.timeout(120)]


@contextmanager
def s_server(openssl, folder, kind, *options):
    """The URL of `openssl s_server`, which shows a page about each connection."""
    for name, data in zip(("chain.pem", "key.pem"), certificate(kind), strict=True):
        (folder / name).write_bytes(data)
    port = free_port()
    files = ("-cert", folder / "chain.pem", "-key", folder / "key.pem")
    command = [openssl.path, "s_server", "-accept", f"{HOST}:{port}", "-www", *files, *options]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as server:
        try:
            until = time.monotonic() + 30
            while time.monotonic() < until and server.poll() is None:
                try:
                    socket.create_connection((HOST, port)).close()
                    break
                except ConnectionRefusedError:
                    time.sleep(0.05)
            yield f"https://{HOST}:{port}"
        finally:
            server.kill()


def page(url, kind, **choices):
    trust = ServerTrust(pins=frozenset({pin(identity(kind))}))
    return EstClient(server=url, trust=trust, **choices).get("/").body.decode()


@pytest.mark.parametrize("kind", ["ml-dsa-65", "ecdsa-p256"])
def test_openssl_and_the_client_agree_on_the_group_and_on_its_certificate(
    kind, openssl35, tmp_path
):
    robot = identity("ml-dsa-87", owner="robot")
    (tmp_path / "robot.pem").write_bytes(robot.chain)
    asks = ("-Verify", "1", "-CAfile", tmp_path / "robot.pem", "-no_check_time")
    with s_server(openssl35, tmp_path, kind, *asks) as url:
        said = page(url, kind, identity=robot)
        with pytest.raises(PqsecError, match="certificate required"):
            page(url, kind)
    assert "TLSv1.3" in said
    assert "X25519MLKEM768" in said
    assert "CN=robot" in said.replace(" ", "")


def test_openssl_with_another_group_or_version_is_refused(openssl35, tmp_path):
    with s_server(openssl35, tmp_path, "ecdsa-p256", "-groups", "X25519") as url:
        with pytest.raises(VerificationError, match="agreed on x25519, not on X25519MLKEM768"):
            page(url, "ecdsa-p256")
        assert "TLSv1.3" in page(url, "ecdsa-p256", classical=True)
    with s_server(openssl35, tmp_path, "ecdsa-p256", "-no_tls1_3") as url:
        with pytest.raises(PqsecError, match="protocol version"):
            page(url, "ecdsa-p256")
        assert "TLSv1.2" in page(url, "ecdsa-p256", classical=True)
