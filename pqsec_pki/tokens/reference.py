"""A file that refers to a key in a token, in the form of OpenSSL's pkcs11-provider.

So `openssl` with that provider uses the same file as a private key. The form is a PEM block whose
DER is a SEQUENCE of a description (VisibleString) and a URI (UTF8String). URIs of other schemes
have a label of pqsec's own.
"""

import base64
import re

from pqsec_pki._asn1 import KeyReference, decode, encode, raw
from pqsec_pki.algorithms import pem
from pqsec_pki.errors import MalformedError
from pqsec_pki.tokens.uri import SCHEME

_PROVIDER_URI, _OTHER_URI = "PKCS#11 PROVIDER URI", "PQSEC KEY URI"
_BLOCK = (
    rb"\s*-----BEGIN (?P<label>PKCS#11 PROVIDER URI|PQSEC KEY URI)-----\r?\n"
    rb"(?P<text>(?:[A-Za-z0-9+/=]+\r?\n)+)"
    rb"-----END (?P=label)-----\s*"
)
_DESCRIPTION = raw(b"\x1a\x19PKCS#11 Provider URI v1.0")
_MARKS = tuple(f"-----BEGIN {each}-----".encode() for each in (_PROVIDER_URI, _OTHER_URI))


def is_reference(data: bytes) -> bool:
    """Whether the file's content `data` refers to a key elsewhere, and is not a key itself."""
    return any(mark in data for mark in _MARKS)


def reference_to(uri: str) -> bytes:
    """The content of a file that refers to the key with that URI."""
    label = _PROVIDER_URI if uri.startswith(f"{SCHEME}:") else _OTHER_URI
    return pem(label, encode(KeyReference(description=_DESCRIPTION, uri=uri)))


def uri_in(data: bytes) -> str:
    """The URI in such a file; MalformedError if there is anything else in it."""
    block = re.fullmatch(_BLOCK, data)
    if not block:
        raise MalformedError("not one reference to a key, in PEM")
    try:
        der = base64.b64decode(b"".join(block["text"].split()), validate=True)
    except ValueError:
        raise MalformedError("broken base64 in the reference to a key") from None
    uri: str = decode(KeyReference, der, "reference to a key").uri
    return uri
