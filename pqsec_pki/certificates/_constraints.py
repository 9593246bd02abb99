"""Names that a CA may issue for: its nameConstraints (RFC 5280 4.2.1.10), as OpenSSL applies them.

They are applied whether they are critical or not. A name of a form that is not processed here is
refused if there are constraints for that form.
"""

import re
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from cryptography import x509
from cryptography.x509.oid import NameOID

from pqsec_pki._asn1 import Oid, encode
from pqsec_pki._dataclass import dataclass
from pqsec_pki._der import begins, content, elements
from pqsec_pki.certificates._plain import MINIMUM_0
from pqsec_pki.certificates._rdns import ReadAttribute, canonical_name
from pqsec_pki.certificates.certificate import Certificate

_HOST = re.compile(r"(?a)(?!.*(?:\.\.|-\.|\.-))\w[\w.-]*\.[\w.-]*\w")
"""A common name that OpenSSL takes for the name of a host."""
_IA5 = 0x16
_NAME_CONSTRAINTS = encode(Oid("2.5.29.30"))
_MAILBOX = Oid("1.3.6.1.5.5.7.8.9")
"""SmtpUTF8Mailbox (RFC 9598): another form of mail addresses."""


@dataclass(frozen=True, slots=True)
class _Name:
    """A name of a participant: its form, and its value in text; of a directory, DER."""

    form: type[x509.GeneralName]
    value: Any
    is_readable: bool = True


def violations(leaf: Certificate, authority: Certificate) -> Iterator[str]:
    """Why `authority` may not have issued `leaf`: for each of its names that is not allowed."""
    limits = authority.extension(x509.NameConstraints)
    if limits is None:
        return
    if _has_bounds(authority):
        yield "they have a minimum or maximum"
        return
    mails = leaf.subject.get_attributes_for_oid(NameOID.EMAIL_ADDRESS)
    if any(not isinstance(each, ReadAttribute) or each.der[0] != _IA5 for each in mails):
        yield "a mail address in its subject is not an IA5String"  # whatever they are for
    for name in _names(leaf):
        permitted = _bases(limits.permitted_subtrees, name.form)
        excluded = _bases(limits.excluded_subtrees, name.form)
        within = _FORMS.get(name.form)
        words = f"{name.form.__name__} {name.value!r}" if within else name.form.__name__
        words = "its subject" if name.form is x509.DirectoryName else words
        if not permitted and not excluded:
            continue
        if within is None or not name.is_readable:
            yield f"{words} cannot be compared with them"
        elif permitted and not any(within(name.value, each) for each in permitted):
            yield f"they do not permit {words}"
        elif any(within(name.value, each) for each in excluded):
            yield f"they exclude {words}"


def _bases(subtrees: Iterable[x509.GeneralName] | None, form: type[x509.GeneralName]) -> list[Any]:
    return [each.value for each in subtrees or () if type(each) is form]


def _names(leaf: Certificate) -> Iterator[_Name]:
    # 6.1.3 (b), (c): the subject, unless it is empty; its mail addresses; and the other names
    if list(leaf.subject):
        yield _Name(x509.DirectoryName, leaf.subject_der)
    for each in leaf.subject.get_attributes_for_oid(NameOID.EMAIL_ADDRESS):
        text = str(each.value)
        yield _Name(x509.RFC822Name, text, "@" in text)
    others = leaf.extension(x509.SubjectAlternativeName) or ()
    yield from map(_alternative, others)
    if any(isinstance(each, x509.DNSName) for each in others):
        return
    for each in leaf.subject.get_attributes_for_oid(NameOID.COMMON_NAME):  # as in OpenSSL
        host = str(each.value).rstrip("\0")
        if _HOST.fullmatch(host) or "\0" in host:
            yield _Name(x509.DNSName, host, "\0" not in host)


def _alternative(name: x509.GeneralName) -> _Name:
    match name:
        case x509.DirectoryName():
            return _Name(x509.DirectoryName, name.value.public_bytes())
        case x509.RFC822Name():
            return _Name(x509.RFC822Name, name.value, "@" in name.value)
        case x509.UniformResourceIdentifier():
            return _Name(x509.UniformResourceIdentifier, name.value, bool(_host(name.value)))
        case x509.OtherName() if name.type_id == _MAILBOX:
            return _Name(x509.RFC822Name, "SmtpUTF8Mailbox", is_readable=False)
        case _:
            return _Name(type(name), name.value)


def _in_directory(name: bytes, base: x509.Name) -> bool:
    start = canonical_name(base.public_bytes())
    return canonical_name(name)[: len(start)] == start


def _in_domain(name: str, base: str) -> bool:
    name, base = name.lower(), base.lower()
    return not base or name == base or name.endswith(base if base[0] == "." else f".{base}")


def _in_mail(name: str, base: str) -> bool:
    user, _, host = name.rpartition("@")
    base_user, at, base_host = base.rpartition("@")
    if base.startswith(".") and not at:
        return host.lower().endswith(base.lower())
    return host.lower() == base_host.lower() and base_user in ("", user)


def _in_uri(name: str, base: str) -> bool:
    host, base = _host(name).lower(), base.lower()
    return host.endswith(base) and host != base if base.startswith(".") else host == base


def _host(uri: str) -> str:
    """The host; empty if there is none, or versions of OpenSSL differ: a path with a colon."""
    rest = uri.partition(":")[2]
    host, _, path = rest.removeprefix("//").partition("/")
    return host.partition(":")[0] if rest.startswith("//") and ":" not in path else ""


_FORMS: dict[type[x509.GeneralName], Callable[[Any, Any], bool]] = {
    x509.DirectoryName: _in_directory,
    x509.DNSName: _in_domain,
    x509.RFC822Name: _in_mail,
    x509.UniformResourceIdentifier: _in_uri,
    x509.IPAddress: lambda address, network: address in network,
}


def _has_bounds(authority: Certificate) -> bool:
    """Whether a subtree has a minimum or maximum, which cryptography does not show."""
    last = elements(authority.tbs, None, "certificate")[-1]
    for each in elements(content(last), None, "certificate"):
        if begins(each, _NAME_CONSTRAINTS):
            octets = elements(each, None, "extension")[-1]
            kinds = elements(content(octets), None, "nameConstraints")
            subtrees = [tree for kind in kinds for tree in _members(kind)]
            bounds = (each for tree in subtrees for each in elements(tree, None, "subtree")[1:])
            return any(each != MINIMUM_0 for each in bounds)
    return False


def _members(kind: bytes) -> list[bytes]:
    return elements(b"\x30" + kind[1:], None, "nameConstraints")
