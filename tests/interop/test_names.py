"""Subject names are spelled as OpenSSL spells them: the stacks compare text."""

import random
from datetime import UTC, datetime, timedelta

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID

from pqsec_pki.algorithms import pem
from pqsec_pki.certificates import Certificate

pytestmark = pytest.mark.interop

LETTERS = "ab ,+\"\\<>;#=/|éñ漢'&.:@-_9Z"
FREE = (
    NameOID.COMMON_NAME,
    NameOID.ORGANIZATION_NAME,
    NameOID.ORGANIZATIONAL_UNIT_NAME,
    NameOID.LOCALITY_NAME,
    NameOID.SURNAME,
    NameOID.GIVEN_NAME,
    NameOID.TITLE,
    NameOID.STREET_ADDRESS,
    NameOID.PSEUDONYM,
)
PLAIN = (NameOID.EMAIL_ADDRESS, NameOID.SERIAL_NUMBER, NameOID.DN_QUALIFIER)
ENCLAVE = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "/fleet/robot1")])


def names() -> list[x509.Name]:
    chance = random.Random(20261121)  # noqa: S311 -- the same names every time
    found = [ENCLAVE]
    for _ in range(40):
        free = chance.sample(FREE, chance.randint(1, 3))
        attributes = [(oid, "".join(chance.choices(LETTERS, k=6))) for oid in free]
        attributes += [(oid, "x1") for oid in chance.sample(PLAIN, chance.randint(0, 2))]
        found.append(x509.Name([x509.NameAttribute(*each) for each in attributes]))
    return found


@pytest.fixture(scope="module")
def key():
    return ec.generate_private_key(ec.SECP256R1())


@pytest.mark.slow(but=5)
@pytest.mark.parametrize("name", names(), ids=str)
def test_a_subject_is_spelled_as_openssl_spells_it(name, key, openssl, put):
    now = datetime.now(UTC)
    builder = x509.CertificateBuilder(name, name, key.public_key(), 1, now, now + timedelta(1))
    made = builder.sign(key, hashes.SHA256())
    der = made.public_bytes(Encoding.DER)
    certificate = Certificate.from_der(der)
    file = put("cert.pem", pem("CERTIFICATE", der))

    def spelled(option: str) -> str:
        said = openssl("x509", "-noout", "-subject", "-nameopt", option, "-in", file).decode()
        return said.removeprefix("subject=").rstrip("\n")

    assert certificate.subject_name == spelled("RFC2253,-esc_msb")
    assert certificate.subject_text == spelled("compat")
