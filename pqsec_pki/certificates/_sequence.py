"""The sequence number of a certificate or signed document: the order that no clock changes.

A CA counts what it signs, so a robot knows an older certificate by its smaller number, whatever
clocks said when the two were made. The number is the attribute of PKCS#9 for that (RFC 2985
5.3.5): a signed attribute of documents, and in certificates an attribute in the extension
subjectDirectoryAttributes, which is never critical (RFC 5280 4.2.1.8).
"""

from cryptography import x509

from pqsec_pki._asn1 import DirectoryAttributes, Extension, Oid, attribute, decode, encode
from pqsec_pki.errors import MalformedError

SEQUENCE_NUMBER = Oid("1.2.840.113549.1.9.25.4")
MAX_SEQUENCE_NUMBER = (1 << 63) - 1
"""The largest number of a ledger line."""
_DIRECTORY_ATTRIBUTES = x509.ObjectIdentifier("2.5.29.9")


def read_sequence_number(der: bytes) -> int:
    """The number in a DER INTEGER; MalformedError if it is not 1 to MAX_SEQUENCE_NUMBER."""
    number = decode(int, der, "sequence number")
    if not 0 < number <= MAX_SEQUENCE_NUMBER:
        raise MalformedError("the sequence number is not the number of a ledger line")
    return number


def sequence_extension(number: int) -> Extension:
    """The extension of a certificate with that sequence number."""
    numbered = attribute(SEQUENCE_NUMBER.dotted_string, encode(number))
    value = encode(DirectoryAttributes(attribute=numbered))
    oid = Oid(_DIRECTORY_ATTRIBUTES.dotted_string)
    return Extension(extn_id=oid, critical=False, extn_value=value)


def sequence_number_in(extensions: x509.Extensions) -> int | None:
    """The sequence number among a certificate's extensions; None if there is none.

    Also None for directory attributes of other tools that cannot be read.
    """
    try:
        found = extensions.get_extension_for_oid(_DIRECTORY_ATTRIBUTES).value
        only = decode(DirectoryAttributes, found.public_bytes(), "directory attributes").attribute
        if only.type.dotted_string != SEQUENCE_NUMBER.dotted_string:
            return None
        [value] = only.values.as_list()
        return read_sequence_number(encode(value))
    except (x509.ExtensionNotFound, MalformedError, ValueError):
        return None
