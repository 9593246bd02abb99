"""The CMS structure of a signed document, DER or BER, parsed (RFC 5652 5.1)."""

from pqsec_pki._asn1 import ContentInfo, SignedData, decode
from pqsec_pki.errors import MalformedError
from pqsec_pki.smime import _ber

SIGNED_DATA = "1.2.840.113549.1.7.2"


def parse(data: bytes) -> SignedData:
    """The SignedData in `data`; MalformedError if it is not one.

    All values are decoded, also those that are kept unchanged, since OpenSSL decodes them too.
    """
    info = decode(ContentInfo, _ber.to_der(data), "CMS structure")
    if info.content_type.dotted_string != SIGNED_DATA:
        raise MalformedError("not a CMS SignedData structure")
    return info.content
