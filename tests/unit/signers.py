"""Signed documents that name their signer otherwise than its certificate is written.

tests/unit/test_smime.py asks pqsec, and tests/interop/test_chains.py OpenSSL, whether it is the
signer.
"""

from dataclasses import dataclass
from datetime import UTC, datetime

from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from pqsec_pki._asn1 import IssuerAndSerialNumber, raw
from pqsec_pki.algorithms import load_private_key
from pqsec_pki.certificates import Certificate
from pqsec_pki.documents import DomainSet, Governance
from pqsec_pki.smime import Signer
from pqsec_pki.smime._canonical import file_of
from pqsec_pki.smime._mime import content_of
from pqsec_pki.smime._signer_info import make
from tests.unit.chains import (
    BAD,
    BMP,
    CA_NAME,
    CN,
    GOOD,
    NUMERIC,
    ORGANIZATION,
    PRINTABLE,
    T61,
    UTF8,
    VISIBLE,
    ca,
    common,
    key,
    name,
)

DOCUMENT = Governance.protected(DomainSet.of(0)).to_xml()


@dataclass(frozen=True)
class Case:
    """The name of a CA, the issuer and serial number in a signature, and whether they fit."""

    words: str
    accepted: bool
    ca_name: bytes
    issuer: bytes
    serial: int = 7

    def __str__(self):
        return self.words

    @property
    def ca(self):
        return ca(subject=self.ca_name)

    @property
    def message(self):
        private = key("ca").private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
        signer = Signer(Certificate.from_der(self.ca), load_private_key(private))
        content = content_of(DOCUMENT)
        info = make(signer, content, now=datetime.now(UTC))
        info.sid = IssuerAndSerialNumber(issuer=raw(self.issuer), serial_number=self.serial)
        return file_of(content, info, [], None)


def _cases():
    for text, tag, accepted in (
        ("Identity CA", UTF8, GOOD),
        ("Identity CA", PRINTABLE, GOOD),
        ("IDENTITY ca", UTF8, GOOD),
        ("  Identity   CA ", UTF8, GOOD),
        ("Identity CA".encode("utf-16-be"), BMP, GOOD),
        ("identity CA", T61, GOOD),
        ("IdentityCA", UTF8, BAD),
        ("Identity CB", PRINTABLE, BAD),
        ("Identity CA", VISIBLE, BAD),
        (b"Identity CA\xff", UTF8, BAD),
    ):
        issuer = common(text, tag)
        yield Case(f"signer {text!r} of type {tag}", accepted, CA_NAME, issuer)
    yield Case("another serial number", BAD, CA_NAME, common("identity ca"), 8)
    yield Case("another attribute", BAD, CA_NAME, name((ORGANIZATION, "Identity CA", UTF8)))
    twice = name((CN, "Identity CA", UTF8), (CN, "Identity CA", UTF8))
    yield Case("one part more", BAD, CA_NAME, twice)
    lab = common("lab_ca*", PRINTABLE)
    yield Case("a printable lab_ca*", GOOD, lab, lab)
    yield Case("lab_ca* in UTF-8", GOOD, lab, common("LAB_ca*"))
    number = common("12", NUMERIC)
    yield Case("a number", GOOD, number, number)
    yield Case("a number, and text", BAD, number, common("12"))
    yield Case("accents in T61", GOOD, common(b"\xe9", T61), common("é"))
    yield Case("capitals with accents", BAD, common("é"), common("É"))


CASES = [*_cases()]
