"""Describes X.509 extensions."""

from collections.abc import Callable
from typing import Any

from cryptography import x509

from pqsec_pki.certificates import name_text
from pqsec_pki.inspection.description import Fact, Value

_USES = (
    ("digital_signature", "sign data"),
    ("content_commitment", "sign with non-repudiation"),
    ("key_encipherment", "receive encrypted keys"),
    ("data_encipherment", "receive encrypted data"),
    ("key_agreement", "agree on keys"),
    ("key_cert_sign", "sign certificates"),
    ("crl_sign", "sign revocation lists"),
)
_PURPOSES = {
    "1.3.6.1.5.5.7.3.1": "TLS server",
    "1.3.6.1.5.5.7.3.2": "TLS client",
    "1.3.6.1.5.5.7.3.3": "code signing",
    "1.3.6.1.5.5.7.3.4": "e-mail protection",
    "2.5.29.37.0": "any purpose",
}
_NAMES_OF = {
    "2.5.29.14": "subject key identifier",
    "2.5.29.15": "key usage",
    "2.5.29.17": "other names",
    "2.5.29.19": "basic constraints",
    "2.5.29.20": "list number",
    "2.5.29.27": "delta list",
    "2.5.29.28": "issuing distribution point",
    "2.5.29.31": "where revocation lists are",
    "2.5.29.32": "policies",
    "2.5.29.35": "issuer's key identifier",
    "2.5.29.37": "extended key usage",
    "2.5.29.72": "subject's alternative key",
    "2.5.29.73": "alternative signature algorithm",
    "2.5.29.74": "alternative signature",
    "1.3.6.1.5.5.7.1.1": "where the issuer's services are",
    "2.16.840.1.113730.1.13": "comment",
}


def extensions_fact(label: str, extensions: x509.Extensions) -> Fact:
    """All extensions as a fact, with the meaning of each known one."""
    found = [(_name(each), _words(each), each) for each in extensions]
    value: tuple[Value, ...] = tuple(
        {"oid": each.oid.dotted_string, "name": name, "critical": each.critical, "text": words}
        for name, words, each in found
    )
    lines = [f"{name}: {words}" if words else name for name, words, _ in found]
    return Fact.of(label, value, *(lines or ["none"]))


def _name(extension: x509.Extension[Any]) -> str:
    oid = extension.oid.dotted_string
    unknown = f"{oid} (not known here{', and critical' if extension.critical else ''})"
    return _NAMES_OF.get(oid, unknown)


def _words(extension: x509.Extension[Any]) -> str | None:
    say = _SAYERS.get(type(extension.value))
    return say(extension.value) if say else None


def _constraints(value: x509.BasicConstraints) -> str:
    if not value.ca:
        return "not a CA"
    if value.path_length is None:
        return "a CA"
    if value.path_length == 0:
        return "a CA, with no CA below it"
    return f"a CA, with at most {value.path_length} CAs below it"


def _usage(value: x509.KeyUsage) -> str:
    uses = [words for name, words in _USES if getattr(value, name)]
    return f"may {', '.join(uses)}" if uses else "may do nothing"


def _purposes(value: x509.ExtendedKeyUsage) -> str:
    return ", ".join(_PURPOSES.get(each.dotted_string, each.dotted_string) for each in value)


def _names(value: x509.SubjectAlternativeName) -> str:
    return ", ".join(map(_general_name, value))


def _general_name(name: x509.GeneralName) -> str:
    if isinstance(name, x509.DirectoryName):
        return name_text(name.value)
    if isinstance(name, x509.OtherName):
        return f"a name of type {name.type_id.dotted_string}"
    if isinstance(name, x509.RegisteredID):
        return name.value.dotted_string
    return str(name.value)


def _issuer_key(value: x509.AuthorityKeyIdentifier) -> str | None:
    return value.key_identifier.hex() if value.key_identifier else None


_SAYERS: dict[type, Callable[[Any], str | None]] = {
    x509.BasicConstraints: _constraints,
    x509.KeyUsage: _usage,
    x509.ExtendedKeyUsage: _purposes,
    x509.SubjectAlternativeName: _names,
    x509.SubjectKeyIdentifier: lambda value: value.digest.hex(),
    x509.AuthorityKeyIdentifier: _issuer_key,
    x509.CRLNumber: lambda value: str(value.crl_number),
}
