"""Whatever a file may hold that is not ours: certificates, keys, documents, signatures."""

import base64
import re
from functools import cache

from pqsec_pki.algorithms import is_encrypted, load_private_key, load_public_key, private_key_pem
from pqsec_pki.certificates import Certificate, verify_chain
from pqsec_pki.documents import DomainSet, Governance, Grant, Kind, Permissions, validate
from pqsec_pki.errors import PqsecError
from pqsec_pki.inspection import describe
from pqsec_pki.smime import Require, Signer, sign, signers_in, verify
from tests.fuzz import mutation
from tests.fuzz.messages import PAIR, SUITES
from tests.fuzz.people import DAY, NOW, authority, enrolled, keys
from tests.unit.test_requests import crl, request, with_alternative

# Certificates and keys


def ca():
    """The authority of pairs: it signs everything twice."""
    return authority(*PAIR.split(" and "))


def second_ca():
    return authority("ml-dsa-65")


def certificates():
    people = [enrolled(kind, "alice") for kind in SUITES]
    return [each.certificate.der for each in people] + [people[-1].certificate.pem]


def take_certificate(data):
    """As a leaf, as an authority; and all that it says of itself."""
    read = Certificate.from_pem if data.startswith(b"-") else Certificate.from_der
    certificate = read(data)
    told = [certificate.subject_name, certificate.subject_text, certificate.signature_algorithm]
    told.append(certificate.subject_key_identifier)
    bob = enrolled(PAIR, "bob")
    for leaf, authority_ in ((certificate, bob.ca), (bob.certificate, certificate)):
        for required in (True, False):
            try:
                verify_chain(leaf, authority_, now=NOW, require_alternative=required)
            except PqsecError as error:
                told += error.lines
    return told, certificate.handshake_keys


def all_keys():
    return [key for kind in SUITES for key in keys(kind, "hers")]


def take_public_key(data):
    key = load_public_key(data)
    try:
        key.verify_handshake(data, data)
    except PqsecError:
        return key
    raise AssertionError("a key has signed itself")


def private_keys():
    return [key.pkcs8 for key in all_keys()] + [private_key_pem(key) for key in all_keys()]


def take_private_key(data):
    # A passphrase is stretched 600,000 times: no place to look for bugs.
    if is_encrypted(data):
        return None
    key = load_private_key(data)
    return key.public_key.verify(key.sign(data), data)


# Documents


def governance():
    return Governance.protected(DomainSet.of(0)).to_xml()


def permissions():
    grant = Grant.least(
        subject_name="CN=/a",
        not_before=NOW,
        not_after=NOW + DAY,
        domains=DomainSet.parse("0-3,7"),
        publish=["rt/chatter"],
        subscribe=["rt/*"],
    )
    return Permissions(grants=(grant,)).to_xml()


def take_document(data):
    kind = {Kind.GOVERNANCE: Governance, Kind.PERMISSIONS: Permissions}[validate(data)]
    document = kind.from_xml(data)
    assert kind.from_xml(document.to_xml()) == document
    return document


@cache
def signed():
    """A document that an authority signed, and another countersigned."""
    signer, countersigner = (Signer(each.certificate, each.key) for each in (ca(), second_ca()))
    return sign(governance(), signer, countersigner=countersigner, now=NOW)


BASE64 = re.compile(rb"(?<=smime\.p7s\"\n\n)[A-Za-z0-9+/=\n]+")


def signature():
    return base64.b64decode(BASE64.search(signed())[0])


def with_signature(der):
    return BASE64.sub(lambda _: base64.encodebytes(der) + b"\n", signed())


def take_signed(data):
    second = second_ca().certificate
    verified = verify(data, ca().certificate, alternative_ca=second, require=Require.ANY)
    assert verified.document == governance().replace(b"\n", b"\r\n")
    return verified, signers_in(data)


def take_signature(der):
    message = with_signature(der)
    try:
        signers_in(message)
    except PqsecError:
        take_signed(message)
        raise AssertionError("verified what cannot even be listed") from None
    return take_signed(message)


# Anything


def files():
    key, second = keys(PAIR, "hers")
    return [
        request(key, second),
        with_alternative(crl(ca()), ca()),
        signed(),
        permissions(),
        certificates()[0],
        enrolled(PAIR, "alice").certificate.pem + ca().certificate.pem,
        private_key_pem(second),
        key.public_key.spki,
    ]


TARGETS = {
    "certificate": (take_certificate, certificates, mutation.in_pem),
    "public-key": (
        take_public_key,
        lambda: [key.public_key.spki for key in all_keys()],
        mutation.der,
    ),
    "private-key": (take_private_key, private_keys, mutation.in_pem),
    "document": (take_document, lambda: [governance(), permissions()]),
    "signed-document": (take_signed, lambda: [signed()]),
    "signature": (take_signature, lambda: [signature()], mutation.der),
    "any-file": (lambda data: describe(data, now=NOW), files, mutation.in_pem),
}
"""{name: (what takes bytes, real bytes that it takes, how they are best spoilt)}"""
