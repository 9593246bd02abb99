"""TLS of enrolment: TLS 1.3 with X25519MLKEM768, by the OpenSSL inside `cryptography`.

Python's ssl module uses the system's OpenSSL, which on Debian 12 has nothing post-quantum. The
client trusts a server by the SHA-256 of its key, or by a CA file and its name. The server takes
every client certificate whose key the client has: who it is, is decided for each request.
"""

import hashlib
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import field
from ipaddress import ip_address
from typing import Self

from cryptography import x509
from OpenSSL import SSL, crypto

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import load_private_key
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import PqsecError, UsageError, VerificationError, shown
from pqsec_pki.tokens import is_reference

GROUP = "X25519MLKEM768"
"""The key agreement of draft-ietf-tls-ecdhe-mlkem, which OpenSSL 3.5 and later prefer."""
_TLS12_CIPHERS = b"ECDHE+AESGCM:ECDHE+CHACHA20"
"""Ciphers for peers with TLS 1.2, if the settings allow them: forward secrecy and AEAD."""
_SESSION = b"pqsec"
_WHY = {9: "it is not valid yet", 10: "it has expired"}
"""Errors of X509_verify_cert that a clock can cause."""

Check = Callable[[SSL.Connection, crypto.X509, int, int, int], bool]
"""OpenSSL's verify callback: connection, certificate, error, depth in the chain, result."""


@dataclass(frozen=True, slots=True)
class TlsIdentity:
    """A certificate, with the CAs that are sent with it, and its key, in PEM without passphrase."""

    chain: bytes = field(repr=False)
    key: bytes = field(repr=False)

    @classmethod
    def of(cls, chain: bytes, key: bytes) -> Self:
        """PqsecError for a key in a token, UsageError for one that TLS does not have."""
        if is_reference(key):
            raise PqsecError(
                "TLS needs the key in a file, and this one is in a token",
                hint="name a key in a file, or use an enrolment token",
            )
        algorithm = load_private_key(key).algorithm
        if algorithm.parts:
            raise UsageError(
                f"TLS has no {algorithm.name} keys",
                hint="choose a key of one algorithm, such as ml-dsa-65",
            )
        return cls(chain, key)


@dataclass(frozen=True, slots=True)
class ServerTrust:
    """How a client knows its server."""

    pins: frozenset[str] = frozenset()
    """SHA-256 of keys (SPKI) in hex: the server's certificate has one of them. Its dates and name
    do not matter, so that a robot with a wrong clock reaches its server."""
    authorities: bytes = field(default=b"", repr=False)
    """Without pins: CAs in PEM, one of which issued a valid certificate for the server's name."""

    def __post_init__(self) -> None:
        """UsageError if neither pins nor CAs are given."""
        if not (self.pins or self.authorities):
            raise UsageError(
                "no server is trusted: no pin and no CA is given",
                hint="use a token file, --server-pin SHA256, or --server-ca FILE",
            )


def is_for_tls(key: bytes) -> bool:
    """Whether TLS can use the key in the content of a file; errors as of `load_private_key`."""
    return not is_reference(key) and not load_private_key(key).algorithm.parts


def spki_pin(certificate: Certificate) -> str:
    """The pin of a server with that certificate."""
    return hashlib.sha256(certificate.spki).hexdigest()


def server_context(identities: Iterable[TlsIdentity], *, classical: bool = False) -> SSL.Context:
    """A context of a server, which asks for a client's certificate and accepts any, or none.

    `identities` have keys of different kinds. With `classical` there is TLS 1.2 too, and the caller
    must not use `refuse_classical`. PqsecError for an identity that OpenSSL refuses.
    """
    context = _context(SSL.TLS_SERVER_METHOD, classical=classical)
    context.set_session_id(_SESSION)
    for each in identities:
        _use(context, each)
    context.set_verify(SSL.VERIFY_PEER, _accept)
    return context


def client_context(
    trust: ServerTrust, host: str, identity: TlsIdentity | None = None, *, classical: bool = False
) -> SSL.Context:
    """A context of a client for a connection to `host`.

    The connection's handshake raises VerificationError for a server that is not trusted, before
    the client's certificate is sent.
    """
    context = _context(SSL.TLS_CLIENT_METHOD, classical=classical)
    if identity:
        _use(context, identity)
    if trust.pins:
        context.set_verify(SSL.VERIFY_PEER, _pinned(trust.pins))
    else:
        with _in_memory(trust.authorities) as path:
            context.load_verify_locations(path)
        context.set_verify(SSL.VERIFY_PEER, _issued(host))
    return context


def refuse_classical(connection: SSL.Connection) -> None:
    """VerificationError unless the connection's keys were agreed with GROUP."""
    group = connection.get_group_name()
    if (group or "").upper() != GROUP.upper():
        raise VerificationError(
            f"the peer agreed on {group or 'an unknown group'}, not on {GROUP}",
            hint="both sides need OpenSSL 3.5 or later; a server with `classical: true` allows"
            " others",
        )


def peer_certificate(connection: SSL.Connection) -> Certificate | None:
    """The peer's certificate, whose key it has shown to have; nothing else of it is verified.

    MalformedError for one that OpenSSL reads, and pqsec does not.
    """
    found = connection.get_peer_certificate()
    return _certificate(found) if found else None


def peer_chain(connection: SSL.Connection) -> tuple[bytes, ...]:
    """What the client sent after its certificate, in DER; it is not verified."""
    own, found = connection.get_peer_certificate(), connection.get_peer_cert_chain() or ()
    dumped = [crypto.dump_certificate(crypto.FILETYPE_ASN1, each) for each in (own, *found) if each]
    return tuple(each for each in dumped if each != dumped[0])


def _context(method: int, *, classical: bool) -> SSL.Context:
    context = SSL.Context(method)
    oldest = SSL.TLS1_2_VERSION if classical else SSL.TLS1_3_VERSION
    context.set_min_proto_version(oldest)
    context.set_cipher_list(_TLS12_CIPHERS)
    # A session that is resumed has no certificate of now, and keys of an earlier agreement.
    context.set_session_cache_mode(SSL.SESS_CACHE_OFF)
    context.set_mode(SSL.MODE_RELEASE_BUFFERS)
    context.set_options(SSL.OP_NO_TICKET | SSL.OP_NO_RENEGOTIATION | SSL.OP_NO_COMPRESSION)
    return context


def _use(context: SSL.Context, identity: TlsIdentity) -> None:
    """Load from memory files: other calls take no ML-DSA keys, and no chain for each key."""
    try:
        with _in_memory(identity.chain) as path:
            context.use_certificate_chain_file(path)
        with _in_memory(identity.key) as path:
            context.use_privatekey_file(path)
        context.check_privatekey()
    except SSL.Error:
        # Without the library's error, which may quote what it read.
        raise PqsecError(
            "OpenSSL does not accept this certificate and key for TLS: they do not belong together,"
            " or are of a kind that TLS does not have"
        ) from None


@contextmanager
def _in_memory(data: bytes) -> Iterator[str]:
    """The path of a file with `data` that is on no disk."""
    with os.fdopen(os.memfd_create("pqsec"), "wb") as file:
        file.write(data)
        file.flush()
        yield f"/proc/self/fd/{file.fileno()}"


def _accept(*_: object) -> bool:
    return True


def _pinned(pins: frozenset[str]) -> Check:
    def check(_by: SSL.Connection, found: crypto.X509, _error: int, depth: int, _ok: int) -> bool:
        pin = spki_pin(_certificate(found))
        if depth == 0 and pin not in pins:
            raise VerificationError(
                f"the server's key is not a pinned one: it has SHA-256 {pin}",
                hint="pin each of its keys: `pqsec inspect` shows them of its certificates",
            )
        return True

    return check


def _issued(host: str) -> Check:
    def check(_by: SSL.Connection, found: crypto.X509, error: int, depth: int, ok: int) -> bool:
        if not ok:
            why = _WHY.get(error, f"none of the trusted CAs issued it (OpenSSL's error {error})")
            raise VerificationError(f"the server's certificate is refused: {why}")
        if depth == 0 and not _is_for(_certificate(found), host):
            raise VerificationError(f"the server's certificate is not for {shown(host)}")
        return True

    return check


def _is_for(certificate: Certificate, host: str) -> bool:
    """Whether a subject alternative name is exactly `host`, a DNS name or an address (RFC 9525)."""
    names = certificate.extension(x509.SubjectAlternativeName)
    if names is None:
        return False
    try:
        return ip_address(host) in names.get_values_for_type(x509.IPAddress)
    except ValueError:
        known = names.get_values_for_type(x509.DNSName)
        return host.lower() in [each.lower() for each in known]


def _certificate(found: crypto.X509) -> Certificate:
    """The certificate, parsed again; MalformedError if OpenSSL accepts it and pqsec does not."""
    return Certificate.from_der(crypto.dump_certificate(crypto.FILETYPE_ASN1, found))
