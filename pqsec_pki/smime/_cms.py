"""The CMS structure of a signed document, DER or BER, parsed (RFC 5652 5.1)."""

from pqsec_pki._asn1 import ContentInfo, SignedData, decode
from pqsec_pki.errors import MalformedError
from pqsec_pki.smime import _ber

SIGNED_DATA = "1.2.840.113549.1.7.2"


def parse(data: bytes) -> SignedData:
    """The SignedData in `data`; MalformedError if there is none.

    All of it is walked through, also what is kept as it is: OpenSSL reads that too.
    """
    info = decode(ContentInfo, _ber.to_der(data), "CMS structure")
    if info.content_type.dotted_string != SIGNED_DATA:
        raise MalformedError("not a CMS SignedData structure")
    return info.content
