"""Requests that the holder of a certificate signs, where TLS cannot show it.

Python's TLS has no keys of tokens and no composite keys. What is signed has the channel binding of
the connection (tls-exporter, RFC 9266), so it is of no use on another one.
"""

import base64
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Self

from OpenSSL import SSL

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import PrivateKey
from pqsec_pki.certificates import Certificate
from pqsec_pki.credentials import ALT_KEY, CERTIFICATE, KEY
from pqsec_pki.errors import VerificationError
from pqsec_pki.est.linking import channel_binding
from pqsec_pki.tokens import Pin, key_in, stored_pin

SCHEME, CERTIFICATE_HEADER = "PQSEC", "PQSEC-Certificate"
"""The scheme of the header Authorization; the header with the certificate, in DER and base64."""
_CONTEXT = "pqsec-request-v1"


class NotSignedError(VerificationError):
    """The holder of the certificate did not sign this request on this connection."""


@dataclass(frozen=True, slots=True)
class RequestSigner:
    """A certificate, and all of its keys."""

    certificate: Certificate
    keys: tuple[PrivateKey, ...] = field(repr=False)

    @classmethod
    def of(cls, files: Mapping[str, bytes], pin: Pin = stored_pin) -> Self:
        """The signer with the installed files of a participant; errors as of `key_in`."""
        keys = tuple(key_in(files[each], pin=pin) for each in (KEY, ALT_KEY) if each in files)
        return cls(Certificate.from_pem(files[CERTIFICATE]), keys)

    def headers(
        self, connection: SSL.Connection, method: str, path: str, body: bytes
    ) -> dict[str, str]:
        """The headers that sign this request. NotSignedError below TLS 1.3."""
        content = _content(connection, self.certificate, method, path, body)
        signatures = ",".join(_text(each.sign(content)) for each in self.keys)
        return {
            "Authorization": f"{SCHEME} {signatures}",
            CERTIFICATE_HEADER: _text(self.certificate.der),
        }


def verify_signed(  # noqa: PLR0913 -- the parts of a request, by name
    connection: SSL.Connection,
    *,
    method: str,
    path: str,
    body: bytes,
    certificates: Sequence[str],
    signatures: str,
) -> Certificate:
    """The certificate whose keys all signed the request; nothing else of it is verified.

    `certificates` are the values of CERTIFICATE_HEADER, `signatures` what follows the scheme.
    NotSignedError if they did not; MalformedError for values that are not certificates.
    """
    if len(certificates) != 1:
        raise NotSignedError(f"a signed request must have one {CERTIFICATE_HEADER}")
    found = Certificate.from_der(_octets(certificates[0]))
    given = [_octets(each) for each in signatures.split(",")]
    keys = [each for each in (found.public_key, found.alternative_key) if each]
    if len(given) != len(keys):
        raise NotSignedError(f"the request has {len(given)} signatures: each key makes one")
    content = _content(connection, found, method, path, body)
    for key, signature in zip(keys, given, strict=True):
        try:
            key.verify(signature, content)
        except VerificationError as error:
            words = f"the request is not signed for this connection: {error}"
            raise NotSignedError(words) from None
    return found


def _content(
    connection: SSL.Connection, certificate: Certificate, method: str, path: str, body: bytes
) -> bytes:
    """The octets to sign. Nothing else that these keys sign begins with the same octets."""
    if connection.get_protocol_version() < SSL.TLS1_3_VERSION:
        raise NotSignedError("requests are signed over TLS 1.3 only")
    lines = (
        _CONTEXT,
        channel_binding(connection).hex(),
        certificate.fingerprint,
        method,
        path,
        hashlib.sha256(body).hexdigest(),
    )
    return "".join(f"{each}\n" for each in lines).encode()


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode()


def _octets(text: str) -> bytes:
    try:
        return base64.b64decode(text.strip(), validate=True)
    except ValueError:
        raise NotSignedError("the signature, or its certificate, is not base64") from None
