"""TLS of enrolment: which server and which group a client takes, and what a server learns."""

import socket
import subprocess
import sys
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from OpenSSL import SSL

from pqsec_pki.algorithms import private_key_pem
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import PqsecError, UsageError, VerificationError
from pqsec_pki.est import (
    GROUP,
    ServerTrust,
    TlsIdentity,
    client_context,
    peer_certificate,
    refuse_classical,
    server_context,
)
from pqsec_pki.tokens import reference_to
from tests.some_keys import some_key
from tests.unit.tls_sides import HOST, certificate, connected, identity, pin

TODAY = datetime.now(UTC).replace(microsecond=0) - timedelta(days=1)
"""OpenSSL has a clock of its own."""


def trusting(*identities):
    return ServerTrust(pins=frozenset(map(pin, identities)))


@pytest.mark.parametrize("server", ["ecdsa-p256", "ml-dsa-65"])
@pytest.mark.parametrize("client", [None, "ecdsa-p256", "ml-dsa-44", "ml-dsa-87"])
def test_both_sides_agree_with_any_keys(server, client):
    shown = identity(server)
    own = identity(client, owner="robot") if client else None
    sides = connected(server_context([shown]), client_context(trusting(shown), HOST, own))
    assert {side.get_group_name() for side in sides} == {GROUP}
    assert {side.get_protocol_version_name() for side in sides} == {"TLSv1.3"}
    for side in sides:
        refuse_classical(side)
    seen = peer_certificate(sides[0])
    assert (seen and seen.pem) == (own and Certificate.from_pem(own.chain).pem)


def test_a_server_with_two_keys_shows_one_that_the_client_can_verify():
    both = [identity("ecdsa-p256"), identity("ml-dsa-65")]
    sides = connected(server_context(both), client_context(trusting(*both), HOST))
    assert peer_certificate(sides[1]).pem in [Certificate.from_pem(each.chain).pem for each in both]


def test_a_pinned_server_may_have_a_certificate_of_any_date_and_name():
    shown = identity("ml-dsa-65", since=datetime(2001, 1, 1, tzinfo=UTC), name="elsewhere")
    assert connected(server_context([shown]), client_context(trusting(shown), HOST))


def test_a_server_with_another_key_is_refused_before_the_client_shows_itself():
    other = identity("ml-dsa-65", owner="other")
    client = client_context(trusting(other), HOST, identity("ml-dsa-65", owner="robot"))
    shown = identity("ml-dsa-65")
    with pytest.raises(VerificationError, match=f"not a pinned one: it has SHA-256 {pin(shown)}"):
        connected(server_context([shown]), client)


def test_the_pin_of_a_ca_above_the_server_is_no_pin_of_the_server():
    authority = identity("ecdsa-p256", owner="ca", ca=True)
    chain, key = certificate("ecdsa-p256", issuer="ca")
    shown = TlsIdentity.of(chain + authority.chain, key)
    with pytest.raises(VerificationError, match="not a pinned one"):
        connected(server_context([shown]), client_context(trusting(authority), HOST))


@pytest.mark.parametrize("kind", ["ecdsa-p256", "ml-dsa-65"])
@pytest.mark.parametrize("host", [HOST, "fleet.example", "::1"])
def test_a_server_is_known_by_its_ca_and_name(kind, host):
    authority, _ = certificate(kind, owner="ca", ca=True, since=TODAY)
    shown = identity(kind, issuer="ca", since=TODAY, name=host)
    trust = ServerTrust(authorities=authority)
    assert connected(server_context([shown]), client_context(trust, host))
    with pytest.raises(VerificationError, match=r"not for 127\.0\.0\.2"):
        connected(server_context([shown]), client_context(trust, "127.0.0.2"))


@pytest.mark.parametrize(
    ("flaw", "words"),
    [
        ({"since": TODAY - timedelta(days=100)}, "it has expired"),
        ({"since": TODAY + timedelta(days=100)}, "not valid yet"),
        ({"issuer": "other"}, "none of the trusted CAs issued it"),
    ],
)
def test_a_server_is_refused_under_its_ca(flaw, words):
    authority, _ = certificate("ml-dsa-65", owner="ca", ca=True, since=TODAY)
    shown = identity("ml-dsa-65", **{"issuer": "ca", "since": TODAY, **flaw})
    client = client_context(ServerTrust(authorities=authority), HOST)
    with pytest.raises(VerificationError, match=words):
        connected(server_context([shown]), client)


def test_nobody_is_trusted_by_default():
    with pytest.raises(UsageError, match="no server is trusted"):
        client_context(ServerTrust(), HOST)


def test_a_session_is_never_resumed():
    shown = identity("ml-dsa-65")
    server, client = server_context([shown]), client_context(trusting(shown), HOST)
    first = connected(server, client)
    first[0].send(b"x")
    first[1].bio_write(first[0].bio_read(1 << 16))
    assert first[1].recv(1) == b"x"
    again = SSL.Connection(server, None), SSL.Connection(client, None)
    again[1].set_session(first[1].get_session())
    for side, begin in zip(again, ("set_accept_state", "set_connect_state"), strict=True):
        getattr(side, begin)()
    with suppress(SSL.WantReadError):
        again[1].do_handshake()
    again[0].bio_write(again[1].bio_read(1 << 16))
    with suppress(SSL.WantReadError):
        again[0].do_handshake()
    assert len(again[0].bio_read(1 << 16)) > len(Certificate.from_pem(shown.chain).der)


CLASSICAL = """
import socket, ssl, sys
context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
context.maximum_version = getattr(ssl.TLSVersion, sys.argv[1])
context.set_ecdh_curve("prime256v1")
end = socket.socket(fileno=int(sys.argv[2]))
with context.wrap_socket(end, server_hostname="x") as tls:
    tls.recv(1)
"""


def accepted(context, version):
    """The server's connection with Python's ssl module, which has no GROUP."""
    here, there = socket.socketpair()
    with here, there:
        command = [sys.executable, "-c", CLASSICAL, version, str(there.fileno())]
        with subprocess.Popen(command, pass_fds=[there.fileno()], stderr=subprocess.DEVNULL) as by:
            there.close()
            try:
                connection = SSL.Connection(context, here)
                connection.set_accept_state()
                connection.do_handshake()
                return connection
            finally:
                by.kill()


def test_a_classical_peer_is_refused_unless_it_is_allowed():
    shown = identity("ecdsa-p256")
    with pytest.raises(VerificationError, match=r"(?i)agreed on (prime|secp)256\w+, not on X25519"):
        refuse_classical(accepted(server_context([shown]), "TLSv1_3"))
    with pytest.raises(SSL.Error):
        accepted(server_context([shown]), "TLSv1_2")
    allowed = server_context([shown], classical=True)
    assert accepted(allowed, "TLSv1_2").get_protocol_version_name() == "TLSv1.2"


def test_keys_that_tls_cannot_use_are_told():
    chain, _ = certificate("ecdsa-p256")
    with pytest.raises(PqsecError, match="in a file, and this one is in a token"):
        TlsIdentity.of(chain, reference_to("pkcs11:token=t;object=k"))
    composite = private_key_pem(some_key("mldsa44-ed25519-sha512"))
    with pytest.raises(UsageError, match="TLS has no mldsa44-ed25519-sha512 keys"):
        TlsIdentity.of(chain, composite)


def test_a_key_of_another_certificate_is_refused_and_not_shown():
    shown = replace(identity("ecdsa-p256"), key=identity("ecdsa-p256", owner="other").key)
    with pytest.raises(PqsecError, match="do not belong together") as refused:
        server_context([shown])
    assert "PRIVATE" not in repr(shown)
    assert refused.value.__cause__ is None
