"""What EST asks of a request and the TLS connection that brings it (RFC 7030 3.5 and 4.2.2).

A client proves that it made the request for this connection, and did not get it from somebody: the
request's challenge password is the channel binding of the connection, in base64. TLS 1.2 has
tls-unique (RFC 5929), which TLS 1.3 has not: there it is tls-exporter (RFC 9266).
"""

import base64
import hmac

from cryptography import x509
from OpenSSL import SSL

from pqsec_pki.certificates import CertificateRequest
from pqsec_pki.errors import VerificationError
from pqsec_pki.est.tls import peer_certificate

_LABEL, _OCTETS = b"EXPORTER-Channel-Binding", 32
"""RFC 9266 4.2."""


def verify_est_request(
    request: CertificateRequest, connection: SSL.Connection, *, renews: bool
) -> None:
    """VerificationError for a request that does not belong to the server's connection.

    It has a challenge password that is not of the connection; or it `renews` the client's
    certificate, and asks for other names.
    """
    given, due = request.challenge_password, base64.b64encode(channel_binding(connection))
    if given is not None and not hmac.compare_digest(given, due):
        raise VerificationError(
            "the challenge password of the request is not the channel binding of this connection"
            " (RFC 7030 3.5): leave it out, or make the request for the connection"
        )
    held = peer_certificate(connection) if renews else None
    asked = _alternative_names(request.extensions)
    if held and asked and asked != _alternative_names(held.extensions):
        raise VerificationError(
            "the request asks for other subject alternative names than the client certificate has"
        )


def _alternative_names(extensions: x509.Extensions) -> x509.SubjectAlternativeName | None:
    try:
        return extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return None


def channel_binding(connection: SSL.Connection) -> bytes:
    """Octets that both ends of this connection have, and no other connection."""
    if connection.get_protocol_version() >= SSL.TLS1_3_VERSION:
        return connection.export_keying_material(_LABEL, _OCTETS, b"")
    # The first Finished message of a handshake, which is the client's: nothing is resumed.
    return connection.get_peer_finished() or b""
