"""X.500 names as text, with OpenSSL's names of attributes, as the stacks use them.

cryptography writes emailAddress and a dozen others as dotted OIDs, which no stack accepts
in a permissions document.
"""

import re

from cryptography import x509
from cryptography.x509.oid import NameOID

_WORDS = {
    NameOID.COMMON_NAME: "CN",
    NameOID.COUNTRY_NAME: "C",
    NameOID.STATE_OR_PROVINCE_NAME: "ST",
    NameOID.LOCALITY_NAME: "L",
    NameOID.ORGANIZATION_NAME: "O",
    NameOID.ORGANIZATIONAL_UNIT_NAME: "OU",
    NameOID.DOMAIN_COMPONENT: "DC",
    NameOID.USER_ID: "UID",
    NameOID.EMAIL_ADDRESS: "emailAddress",
    NameOID.SERIAL_NUMBER: "serialNumber",
    NameOID.STREET_ADDRESS: "street",
    NameOID.SURNAME: "SN",
    NameOID.GIVEN_NAME: "GN",
    NameOID.INITIALS: "initials",
    NameOID.TITLE: "title",
    NameOID.DN_QUALIFIER: "dnQualifier",
    NameOID.PSEUDONYM: "pseudonym",
    NameOID.GENERATION_QUALIFIER: "generationQualifier",
    NameOID.POSTAL_CODE: "postalCode",
    NameOID.POSTAL_ADDRESS: "postalAddress",
    NameOID.BUSINESS_CATEGORY: "businessCategory",
    NameOID.ORGANIZATION_IDENTIFIER: "organizationIdentifier",
    NameOID.UNSTRUCTURED_NAME: "unstructuredName",
    NameOID.X500_UNIQUE_IDENTIFIER: "x500UniqueIdentifier",
}
_ESCAPED = ',+"\\<>;'
_PLAIN = re.compile(r"[A-Za-z0-9/_.-]+")


def name_text(name: x509.Name) -> str:
    """RFC 2253: CN=x,O=Lab,C=ES, the last part first. Non-ASCII letters are not escaped."""
    return ",".join(
        "+".join(_part(each) for each in reversed(list(rdn))) for rdn in reversed(name.rdns)
    )


def name_line(name: x509.Name) -> str:
    r"""OpenSSL's one-line form, in the order of the certificate: /C=ES/O=Lab/CN=\/x."""
    return "".join(f"/{_word(each)}={_in_line(_plain(each))}" for each in name)


def lone_common_name(name: x509.Name) -> str | None:
    """The CN of a name that has nothing else, as those of participants; None for other names."""
    match list(name):
        case [part] if part.oid == NameOID.COMMON_NAME and isinstance(part.value, str):
            return part.value
    return None


def _in_line(value: str) -> str:
    octets = (
        f"\\{chr(octet)}"
        if octet in b"/+"
        else chr(octet)
        if 0x20 <= octet <= 0x7E  # noqa: PLR2004 -- printable ASCII
        else f"\\x{octet:02X}"
        for octet in value.encode()
    )
    return "".join(octets)


def _part(each: x509.NameAttribute[str | bytes]) -> str:
    value = _plain(each)
    if _PLAIN.fullmatch(value):  # so with nearly all names
        return f"{_word(each)}={value}"
    characters = [_escaped(character) for character in value]
    if value.startswith("#") and len(value) > 1:
        characters[0] = "\\#"
    for end in (0, -1):
        if value and value[end] == " ":
            characters[end] = "\\ "
    return f"{_word(each)}={''.join(characters)}"


def _escaped(character: str) -> str:
    if character in _ESCAPED:
        return f"\\{character}"
    if (
        not character.isprintable()
    ):  # control characters, and those that change the direction of text
        return "".join(f"\\{octet:02X}" for octet in character.encode())
    return character


def _plain(each: x509.NameAttribute[str | bytes]) -> str:
    value = each.value
    return f"#{value.hex()}" if isinstance(value, bytes) else value


def _word(each: x509.NameAttribute[str | bytes]) -> str:
    return _WORDS.get(each.oid, each.oid.dotted_string)
