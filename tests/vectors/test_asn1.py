"""The bytes that _asn1 writes, held fixed: cryptography calls its ASN.1 module unstable.

`asn1/golden.json` was written once and checked with `openssl asn1parse`. A difference
here means that a new version of cryptography writes or reads something else.
"""

import json
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import pytest

from pqsec_pki import _asn1
from pqsec_pki._asn1 import (
    AlgorithmIdentifier,
    Attribute,
    AttributeTypeAndValue,
    BitString,
    CertificationRequestInfo,
    CMSAlgorithmProtection,
    ContentInfo,
    ECPrivateKey,
    EncapsulatedContentInfo,
    EncryptedPrivateKeyInfo,
    Extension,
    IssuerAndSerialNumber,
    KeyReference,
    NameHolder,
    Oid,
    OneAsymmetricKey,
    PBES2Params,
    PBKDF2Params,
    PreTBSCertList,
    RevokedEntry,
    SeedAndExpandedKey,
    SetOf,
    Signed,
    SignedData,
    SignerInfo,
    SubjectPublicKeyInfo,
    TBSCertificate,
    TBSCertList,
    Validity,
    algorithm,
    attribute,
    bits,
    decode,
    encode,
    moment_of,
    raw,
    read_time,
    time_of,
    whole_bytes,
)
from pqsec_pki.errors import MalformedError

GOLDEN = json.loads((Path(__file__).parent / "asn1" / "golden.json").read_bytes())
EARLY = datetime(2026, 11, 21, 12, 30, 15, tzinfo=UTC)
LATE = datetime(2050, 1, 1, tzinfo=UTC)
ML_DSA_65, ECDSA, SHA512 = (
    "2.16.840.1.101.3.4.3.18",
    "1.2.840.10045.4.3.2",
    "2.16.840.1.101.3.4.2.3",
)
RSA = "1.2.840.113549.1.1.11"
SERIAL = 0x7F00112233445566778899AABBCCDDEEFF001122

# CN=a, and a short public key: their own encodings are not what is looked at here.
NAME = raw(bytes.fromhex("300c310a300806035504030c0161"))
KEY = SubjectPublicKeyInfo(algorithm=algorithm(ML_DSA_65), subject_public_key=bits(b"key"))
VALIDITY = Validity(not_before=time_of(EARLY), not_after=time_of(LATE))
CRITICAL = Extension(extn_id=Oid("2.5.29.15"), critical=True, extn_value=b"\x03\x02\x07\x80")
PLAIN = Extension(extn_id=Oid("2.5.29.14"), critical=False, extn_value=b"\x04\x01\x00")
ATTRIBUTES = [
    attribute("1.2.840.113549.1.9.3", encode(Oid("1.2.840.113549.1.7.1"))),
    attribute("1.2.840.113549.1.9.4", encode(b"digest")),
    attribute("1.2.840.113549.1.9.5", encode(time_of(EARLY))),
]


def certificate_content(kind, **more):
    return kind(
        version=2,
        serial_number=SERIAL,
        issuer=NAME,
        validity=raw(encode(VALIDITY)),
        subject=NAME,
        subject_public_key_info=raw(encode(KEY)),
        issuer_unique_id=None,
        subject_unique_id=None,
        extensions=[CRITICAL, PLAIN],
        **more,
    )


def list_content(kind, **more):
    return kind(
        version=1,
        issuer=NAME,
        this_update=time_of(EARLY),
        next_update=time_of(LATE),
        revoked_certificates=[raw(bytes.fromhex("3012020107170d3236313132313132333031355a"))],
        crl_extensions=[PLAIN],
        **more,
    )


def signer_info(sid, unsigned):
    return SignerInfo(
        version=1,
        sid=sid,
        digest_algorithm=algorithm(SHA512),
        signed_attributes=sorted(ATTRIBUTES, key=encode),
        signature_algorithm=algorithm(ML_DSA_65),
        signature=b"signature",
        unsigned_attributes=unsigned,
    )


INFO = signer_info(IssuerAndSerialNumber(issuer=NAME, serial_number=SERIAL), None)
SIGNED_DATA = SignedData(
    version=1,
    digest_algorithms=SetOf([algorithm(SHA512)]),
    encapsulated_content=EncapsulatedContentInfo(
        content_type=Oid("1.2.840.113549.1.7.1"), content=None
    ),
    certificates=[raw(b"\x30\x00")],
    crls=None,
    signer_infos=SetOf([INFO]),
)
DERIVATION = PBKDF2Params(
    salt=bytes(range(16)),
    iteration_count=600_000,
    key_length=None,
    prf=algorithm("1.2.840.113549.2.9", null=True),
)
ENCRYPTION = PBES2Params(
    key_derivation=AlgorithmIdentifier(
        algorithm=Oid("1.2.840.113549.1.5.12"), parameters=raw(encode(DERIVATION))
    ),
    encryption=AlgorithmIdentifier(
        algorithm=Oid("2.16.840.1.101.3.4.1.42"), parameters=raw(encode(bytes(range(16))))
    ),
)
VALUES = {
    "AlgorithmIdentifier without parameters": algorithm(ML_DSA_65),
    "AlgorithmIdentifier with NULL": algorithm(RSA, null=True),
    "AlgorithmIdentifier with an OID": AlgorithmIdentifier(
        algorithm=Oid("1.2.840.10045.2.1"), parameters=raw(encode(Oid("1.2.840.10045.3.1.7")))
    ),
    "SubjectPublicKeyInfo": KEY,
    "Validity over 2050": VALIDITY,
    "Extension, critical": CRITICAL,
    "Extension, not critical": PLAIN,
    "TBSCertificate": certificate_content(TBSCertificate, signature=algorithm(ECDSA)),
    "Signed": Signed(
        tbs=raw(b"\x30\x00"), signature_algorithm=algorithm(ECDSA), signature=bits(b"signature")
    ),
    "CertificationRequestInfo": CertificationRequestInfo(
        version=0, subject=NAME, subject_public_key_info=raw(encode(KEY)), attributes=ATTRIBUTES[:1]
    ),
    "TBSCertList": list_content(TBSCertList, signature=algorithm(ECDSA)),
    "PreTBSCertList": list_content(PreTBSCertList),
    "RevokedEntry": RevokedEntry(
        user_certificate=7, revocation_date=time_of(EARLY), crl_entry_extensions=[PLAIN]
    ),
    "Attribute": ATTRIBUTES[2],
    "CMSAlgorithmProtection": CMSAlgorithmProtection(
        digest_algorithm=algorithm(SHA512), signature_algorithm=algorithm(ML_DSA_65)
    ),
    "SignerInfo by issuer and serial": INFO,
    "SignerInfo by key identifier, countersigned": signer_info(
        b"identifier", [attribute("1.2.840.113549.1.9.6", encode(INFO))]
    ),
    "ContentInfo": ContentInfo(content_type=Oid("1.2.840.113549.1.7.2"), content=SIGNED_DATA),
    "OneAsymmetricKey": OneAsymmetricKey(
        version=0,
        algorithm=algorithm(ML_DSA_65),
        private_key=b"\x80\x03key",
        attributes=None,
        public_key=None,
    ),
    "OneAsymmetricKey with everything": OneAsymmetricKey(
        version=1,
        algorithm=algorithm(ML_DSA_65),
        private_key=b"\x80\x03key",
        attributes=SetOf([ATTRIBUTES[1]]),
        public_key=bits(b"public"),
    ),
    "ECPrivateKey": ECPrivateKey(
        version=1, private_key=bytes(32), parameters=Oid("1.2.840.10045.3.1.7"), public_key=None
    ),
    "KeyReference": KeyReference(
        description=raw(b"\x1a\x19PKCS#11 Provider URI v1.0"), uri="pkcs11:token=t;object=o"
    ),
    "SeedAndExpandedKey": SeedAndExpandedKey(seed=bytes(32), expanded_key=b"expanded"),
    "NameHolder": NameHolder(
        name=[SetOf([AttributeTypeAndValue(type=Oid("2.5.4.3"), value=raw(b"\x0c\x01x"))])]
    ),
    "PBKDF2Params": DERIVATION,
    "PBES2Params": ENCRYPTION,
    "EncryptedPrivateKeyInfo": EncryptedPrivateKeyInfo(
        algorithm=AlgorithmIdentifier(
            algorithm=Oid("1.2.840.113549.1.5.13"), parameters=raw(encode(ENCRYPTION))
        ),
        encrypted_data=bytes(16),
    ),
}


@pytest.mark.parametrize("name", VALUES)
def test_the_bytes_are_what_they_were(name):
    assert encode(VALUES[name]).hex() == GOLDEN[name]


@pytest.mark.parametrize("name", VALUES)
def test_the_bytes_are_read_back(name):
    der = bytes.fromhex(GOLDEN[name])
    assert encode(decode(type(VALUES[name]), der, name)) == der


@pytest.mark.parametrize("name", VALUES)
def test_bytes_that_are_longer_or_shorter_are_refused(name):
    der = bytes.fromhex(GOLDEN[name])
    for bad in (der + b"\0", der[:-1], b"", b"\x30\x80" + der[2:] + b"\0\0"):
        with pytest.raises(MalformedError, match=f"not a DER {name}"):
            decode(type(VALUES[name]), bad, name)


def test_every_structure_is_held():
    structures = {name for name in _asn1.__all__ if hasattr(getattr(_asn1, name), "__asn1_root__")}
    held = {type(value).__name__ for value in VALUES.values()}
    inside = {"EncapsulatedContentInfo", "IssuerAndSerialNumber", "SignedData"}
    assert structures == held | inside
    assert set(GOLDEN) == set(VALUES)


def test_signed_attributes_are_a_set_in_order():
    backwards = encode(SetOf(ATTRIBUTES[::-1]))
    assert backwards == encode(SetOf(ATTRIBUTES))
    assert backwards[:1] == b"\x31"
    assert backwards[2:] == b"".join(sorted(map(encode, ATTRIBUTES)))


def test_a_set_out_of_order_is_refused():
    body = b"".join(sorted(map(encode, ATTRIBUTES), reverse=True))
    wrong = encode(Oid("1.2.3")) + bytes([0x31, len(body)]) + body
    with pytest.raises(MalformedError):
        decode(Attribute, bytes([0x30, len(wrong)]) + wrong, "attribute")


@pytest.mark.parametrize(
    ("moment", "der"),
    [
        (datetime(1950, 1, 1, tzinfo=UTC), b"\x17\x0d500101000000Z"),
        (datetime(2049, 12, 31, 23, 59, 59, 999_999, tzinfo=UTC), b"\x17\x0d491231235959Z"),
        (LATE, b"\x18\x0f20500101000000Z"),
        (datetime(2261, 12, 31, 23, 59, 59, tzinfo=UTC), b"\x18\x0f22611231235959Z"),
    ],
)
def test_times_change_their_form_in_2050(moment, der):
    assert encode(time_of(moment)) == der
    assert read_time(der, "time") == moment_of(time_of(moment)) == moment.replace(microsecond=0)


@pytest.mark.parametrize(
    "der",
    [
        b"\x17\x0d490229000000Z",
        b"\x17\x0b4912310000Z",
        b"\x17\x11491231235959+0000",
        b"\x18\x0f00000101000000Z",
        b"\x18\x1220500101000000.50Z",
        b"\x18\x0f20501301000000Z",
        b"\x05\x00",
        b"",
    ],
)
def test_a_time_that_is_none_is_refused(der):
    with pytest.raises(MalformedError, match="not a DER time"):
        read_time(der, "time")


def test_a_bit_string_with_unused_bits_has_no_whole_bytes():
    assert whole_bytes(BitString(b"key", 0), "it") == b"key"
    with pytest.raises(MalformedError, match="it is not a whole number of bytes"):
        whole_bytes(BitString(b"\x80", 7), "it")


def test_a_structure_is_made_when_it_is_used_and_refuses_other_fields():
    """Each takes a third of a millisecond, and a command needs few of the twenty-five."""
    code = (
        "from pqsec_pki._asn1 import *; made = lambda: [type(vars(each)['__asn1_root__']).__name__"
        " for each in (ContentInfo, SignerInfo, TBSCertList)]\n"
        "print(made()); ContentInfo.__asn1_root__; print(made())"
    )
    ran = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert ran.stdout.splitlines() == [
        "['_Root', '_Root', '_Root']",
        "['Sequence', 'Sequence', '_Root']",  # one contains the other
    ]
    with pytest.raises(TypeError, match="Validity has the fields not_before, not_after"):
        Validity(not_before=time_of(EARLY))
