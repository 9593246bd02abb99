"""Certificates for TLS, and both sides of a connection in one process."""

from contextlib import suppress
from datetime import timedelta
from ipaddress import ip_address

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID
from OpenSSL import SSL

from pqsec_pki.algorithms import private_key_pem
from pqsec_pki.certificates import Certificate
from pqsec_pki.est import TlsIdentity, spki_pin
from tests.some_keys import some_key
from tests.unit.killing import NOW

HOST = "127.0.0.1"


def certificate(  # noqa: PLR0913 -- by name
    kind, *, owner="server", issuer=None, since=NOW, name=HOST, ca=False
):
    """A certificate in PEM of `owner`'s key, by itself or by `issuer`, and the key in PEM."""
    key, by = some_key(kind, owner), some_key(kind, issuer or owner)
    builder = (
        x509.CertificateBuilder()
        .subject_name(_name(owner))
        .issuer_name(_name(issuer or owner))
        .public_key(key.handle.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(since)
        .not_valid_after(since + timedelta(days=90))
        .add_extension(x509.BasicConstraints(ca=ca, path_length=None), critical=True)
        .add_extension(x509.SubjectAlternativeName([_alternative(name)]), critical=False)
    )
    digest = None if kind.startswith("ml-dsa") else hashes.SHA256()
    made = builder.sign(by.handle, digest)
    return made.public_bytes(Encoding.PEM), private_key_pem(key)


def identity(kind, **choices):
    """What one side shows."""
    return TlsIdentity.of(*certificate(kind, **choices))


def pin(shown):
    """The pin of an identity."""
    return spki_pin(Certificate.from_pem(shown.chain))


def _name(text):
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


def _alternative(name):
    try:
        return x509.IPAddress(ip_address(name))
    except ValueError:
        return x509.DNSName(name)


def connected(server, client):
    """The connections of both sides after the handshake, as (server's, client's)."""
    sides = SSL.Connection(server, None), SSL.Connection(client, None)
    sides[0].set_accept_state()
    sides[1].set_connect_state()
    done = set()
    for _ in range(6):
        for side, other in (sides[::-1], sides):
            with suppress(SSL.WantReadError):
                side.do_handshake()
                done.add(side)
            _carry(side, other)
    assert len(done) == len(sides)
    return sides


def _carry(source, goal):
    with suppress(SSL.WantReadError):
        goal.bio_write(source.bio_read(1 << 20))
