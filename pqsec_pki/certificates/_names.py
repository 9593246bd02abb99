"""X.500 names as text, with OpenSSL's names of attributes, as the stacks use them.

cryptography writes emailAddress and a dozen others as dotted OIDs, which no stack accepts
in a permissions document.
"""

import re
from functools import cache

from cryptography import x509
from cryptography.x509.oid import NameOID

from pqsec_pki._assets import asset
from pqsec_pki._der import content, elements
from pqsec_pki.certificates._rdns import ReadAttribute

_FREQUENT = {
    NameOID.COMMON_NAME: "CN",
    NameOID.COUNTRY_NAME: "C",
    NameOID.STATE_OR_PROVINCE_NAME: "ST",
    NameOID.LOCALITY_NAME: "L",
    NameOID.ORGANIZATION_NAME: "O",
    NameOID.ORGANIZATIONAL_UNIT_NAME: "OU",
}
"""Rows of OpenSSL's table, which is read if a name has another attribute."""
_ESCAPED = ',+"\\<>;'
_PLAIN = re.compile(r"[A-Za-z0-9/_.-]+")


def name_text(name: x509.Name) -> str:
    """RFC 2253: CN=x,O=Lab,C=ES, the last part first. Non-ASCII letters are not escaped."""
    return ",".join(
        "+".join(_part(each) for each in reversed(list(rdn))) for rdn in reversed(name.rdns)
    )


def name_line(name: x509.Name) -> str:
    r"""OpenSSL's one-line form, in the order of the certificate: /C=ES/O=Lab/CN=\/x."""
    return "".join(
        "/" + "+".join(f"{_word(each)}={_in_line(_octets(each))}" for each in rdn)
        for rdn in name.rdns
    )


def lone_common_name(name: x509.Name) -> str | None:
    """The CN of a name that has nothing else, as those of participants; None for other names."""
    match list(name):
        case [part] if part.oid == NameOID.COMMON_NAME and isinstance(part.value, str):
            return part.value
    return None


def _in_line(value: bytes) -> str:
    octets = (
        f"\\{chr(octet)}"
        if octet in b"/+"
        else chr(octet)
        if 0x20 <= octet <= 0x7E  # noqa: PLR2004 -- printable ASCII
        else f"\\x{octet:02X}"
        for octet in value
    )
    return "".join(octets)


def _part(each: x509.NameAttribute[str | bytes]) -> str:
    value, word = each.value, _word(each)
    if isinstance(value, bytes) or word == each.oid.dotted_string:
        return f"{word}=#{_der(each).hex().upper()}"  # as OpenSSL: it does not know what it is
    if _PLAIN.fullmatch(value):  # so with nearly all names
        return f"{word}={value}"
    characters = [_escaped(character) for character in value]
    if value.startswith("#") and len(value) > 1:
        characters[0] = "\\#"
    for end in (0, -1):
        if value and value[end] == " ":
            characters[end] = "\\ "
    return f"{word}={''.join(characters)}"


def _escaped(character: str) -> str:
    if character in _ESCAPED:
        return f"\\{character}"
    if (
        not character.isprintable()
    ):  # control characters, and those that change the direction of text
        return "".join(f"\\{octet:02X}" for octet in character.encode())
    return character


def _octets(each: x509.NameAttribute[str | bytes]) -> bytes:
    """The content of its value; of a BIT STRING, without the number of unused bits."""
    found = content(_der(each))
    return found[1:] if isinstance(each.value, bytes) else found


def _der(each: x509.NameAttribute[str | bytes]) -> bytes:
    if isinstance(each, ReadAttribute):
        return each.der
    [rdn] = elements(x509.Name([each]).public_bytes(), None, "name")
    [_, value] = elements(content(rdn), None, "attribute")
    return value


def _word(each: x509.NameAttribute[str | bytes]) -> str:
    return _FREQUENT.get(each.oid) or _known().get(each.oid.dotted_string, each.oid.dotted_string)


@cache
def _known() -> dict[str, str]:
    """OpenSSL's table: OID -> short name. Newer versions know more."""
    lines = asset("schemas", "object_names.txt").read_text("ascii").splitlines()[1:]
    pairs = (line.partition(" ") for line in lines)
    return {oid: word for oid, _, word in pairs}
