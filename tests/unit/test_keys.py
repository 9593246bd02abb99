"""Private and public keys to bytes and back: every form that is read, and what is not."""

import base64
import hashlib
import shutil
import subprocess

import pytest
from cryptography.hazmat.primitives import padding
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, rsa, x25519
from cryptography.hazmat.primitives.ciphers import Cipher, modes
from cryptography.hazmat.primitives.ciphers.algorithms import AES
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
)

from pqsec_pki._asn1 import (
    AlgorithmIdentifier,
    BitString,
    EncryptedPrivateKeyInfo,
    Oid,
    OneAsymmetricKey,
    PBES2Params,
    PBKDF2Params,
    SeedAndExpandedKey,
    SubjectPublicKeyInfo,
    algorithm,
    bits,
    decode,
    encode,
    raw,
)
from pqsec_pki.algorithms import (
    SIGNATURES,
    Family,
    is_encrypted,
    load_private_key,
    load_public_key,
    pair_private,
    pem,
    private_key_pem,
    unpem,
)
from pqsec_pki.algorithms._pbes2 import MAX_ITERATIONS
from pqsec_pki.algorithms.signature import COMPOSITES
from pqsec_pki.errors import MalformedError, PassphraseError, PqsecError, UnknownAlgorithmError
from tests.some_keys import some_key

PASSPHRASE = "corréct horse".encode()
ROWS = [row for row in SIGNATURES if "4096" not in row.name]  # checking such a key is slow
ML_DSA = [row for row in ROWS if row.family is Family.PQ]
PQ = [*ML_DSA, *COMPOSITES]
EXPANDED_SIZES = {"ml-dsa-44": 2560, "ml-dsa-65": 4032, "ml-dsa-87": 4896}
PBKDF2, AES_256_CBC = "1.2.840.113549.1.5.12", "2.16.840.1.101.3.4.1.42"
HMAC_SHA = {1: "1.2.840.113549.2.7", **{b: f"1.2.840.113549.2.{n}" for b, n in
            ((256, 9), (384, 10), (512, 11))}}  # fmt: skip

each_row = pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
each_ml_dsa = pytest.mark.parametrize("row", ML_DSA, ids=lambda row: row.name)
each_composite = pytest.mark.parametrize("row", COMPOSITES, ids=lambda row: row.name)
each_pq = pytest.mark.parametrize("row", PQ, ids=lambda row: row.name)


def key_of(row):
    return some_key(row.name)


def other_halves(row):
    """A composite of each other kind of half; the largest RSA keys are slow to check."""
    kinds = {_kind(each): each for each in COMPOSITES if "4096" not in each.name}
    return [each for kind, each in kinds.items() if kind != _kind(row)]


def _kind(row):
    return getattr(row.traditional, "bits", row.traditional.name)


def native(handle, form=PrivateFormat.PKCS8, passphrase=None, encoding=Encoding.PEM):
    """A private key as other tools write it."""
    encryption = BestAvailableEncryption(passphrase) if passphrase else NoEncryption()
    return handle.private_bytes(encoding, form, encryption)


def same(key, other):
    return (key.algorithm, key.pkcs8) == (other.algorithm, other.pkcs8)


# PEM


def test_pem_is_read_back():
    der = bytes(range(200))
    text = pem("THING", der)
    assert max(map(len, text.splitlines())) <= 64
    assert unpem(text, "thing") == [("THING", der)]
    assert unpem(text.replace(b"\n", b"\r\n"), "thing") == [("THING", der)]


def test_every_block_is_found_and_what_stands_between_them_is_not_looked_at():
    text = b"subject=CA\n" + pem("A", b"1") + b"\n-- more --\n" + pem("B 2", b"2") + b"trailer"
    assert unpem(text, "thing") == [("A", b"1"), ("B 2", b"2")]


BLOCK = pem("CERTIFICATE", bytes(100))
BROKEN_PEM = {
    "it ends as another": BLOCK.replace(b"END CERTIFICATE", b"END X"),
    "something before BEGIN": b"x" + BLOCK,
    "a space before BEGIN": b" " + BLOCK,
    "a byte order mark before BEGIN": b"\xef\xbb\xbf" + BLOCK,
    "a line so long that OpenSSL cuts it before BEGIN": b"a" * 254 + BLOCK,
    "something after BEGIN": BLOCK.replace(b"-----\n", b"-----x\n", 1),
    "a high byte after BEGIN": BLOCK.replace(b"-----\n", b"-----\x80\n", 1),
    "something before END": BLOCK.replace(b"-----END", b"x-----END"),
    "something after END": BLOCK.replace(b"-----\n", b"-----x\n").replace(b"x\n", b"\n", 1),
    "a label in small letters": BLOCK + BLOCK.lower().replace(b"begin", b"BEGIN"),
    "a BEGIN without an END": b"-----BEGIN CERTIFICATE-----\n" + BLOCK,
    "an END without a BEGIN": b"-----END CERTIFICATE-----\n" + BLOCK,
    "a blank line inside": BLOCK.replace(b"\n", b"\n\n", 2),
    "a blank line at the end": BLOCK.replace(b"-----END", b"\n-----END"),
    "a space in a line": BLOCK.replace(b"AAAA", b"A AAA", 1),
    "a NUL in the text": b"\0\n" + BLOCK,
    "a header": BLOCK.replace(b"-----\n", b"-----\nX: y\n\n", 1),
    "a header without its blank line": BLOCK.replace(b"-----\n", b"-----\nX: y\n", 1),
    "another name for a certificate": BLOCK.replace(b" CERT", b" X509 CERT") + BLOCK,
    "a certificate that is trusted": BLOCK.replace(b" CERT", b" TRUSTED CERT") + BLOCK,
    "padding in the middle": BLOCK.replace(b"A\n", b"=\n", 1),
    "nothing inside": b"-----BEGIN CERTIFICATE-----\n-----END CERTIFICATE-----\n",
    "padding too much": pem("A", bytes(99)).replace(b"\n-----END", b"==\n-----END"),
    "base64 cut short": BLOCK.replace(b"==\n", b"\n"),
}
"""What OpenSSL or another reader takes for something else, or for nothing."""


@pytest.mark.parametrize("flaw", BROKEN_PEM)
def test_pem_that_readers_could_disagree_on_is_refused(flaw):
    assert BROKEN_PEM[flaw] != BLOCK
    with pytest.raises(MalformedError, match="PEM"):
        unpem(BROKEN_PEM[flaw], "thing")


@pytest.mark.parametrize("size", [4, 48, 76, 1000])
@pytest.mark.parametrize("end", [b"\n", b"\r\n", b" \n", b"\t\r\n"])
def test_pem_of_other_lines_is_read(size, end):
    text = base64.b64encode(bytes(100))
    lines = [text[at : at + size] for at in range(0, len(text), size)]
    marks = b"-----BEGIN A-----", b"-----END A-----"
    assert unpem(end.join([marks[0], *lines, marks[1], b""]), "thing") == [("A", bytes(100))]


@pytest.mark.parametrize("body", [b"MTI", b"M*Iz", "MTIé".encode()])
def test_broken_base64_is_refused(body):
    with pytest.raises(MalformedError, match="thing: broken"):
        unpem(b"-----BEGIN A-----\n" + body + b"\n-----END A-----\n", "thing")


@pytest.mark.timeout(120)  # what is quadratic takes an hour
def test_blocks_without_an_end_cost_no_more_than_their_length():
    with pytest.raises(MalformedError):
        unpem(b"-----BEGIN A-----\nAAAA\n" * 200_000, "thing")


@pytest.mark.parametrize("row", list(SIGNATURES), ids=lambda row: row.name)
@pytest.mark.parametrize("passphrase", [None, b"horse"])
def test_a_private_key_with_text_before_it_is_read(row, passphrase):
    # As `openssl pkcs12` writes it (RFC 7468 2).
    text = b"Bag Attributes\n    localKeyID: 01 02\nKey Attributes: <No Attributes>\n"
    key = key_of(row)
    found = load_private_key(text + private_key_pem(key, passphrase), passphrase)
    assert same(found, key)


@each_ml_dsa
def test_a_private_key_of_both_forms_with_text_before_it_is_read(row):
    key = key_of(row)
    text = b"Bag Attributes\n" + pem("PRIVATE KEY", pkcs8(row, both(row, key)))
    assert same(load_private_key(text), key)


# Private keys, unencrypted


@pytest.mark.parametrize("row", list(SIGNATURES), ids=lambda row: row.name)
def test_a_private_key_is_read_back_from_pem_and_der(row):
    key = key_of(row)
    assert same(load_private_key(private_key_pem(key)), key)
    assert same(load_private_key(key.pkcs8), key)


@each_row
def test_a_private_key_is_read_among_other_things(row):
    text = b"# key\n" + pem("CERTIFICATE", b"0") + private_key_pem(key_of(row)) + b"\n"
    found = load_private_key(text.removeprefix(b"# key\n").replace(b"\n", b"\r\n"))
    assert same(found, key_of(row))


@each_row
def test_what_a_key_signs_its_copy_verifies(row):
    copy = load_private_key(private_key_pem(key_of(row)))
    copy.public_key.verify(key_of(row).sign(b"data"), b"data")


@each_ml_dsa
def test_an_ml_dsa_key_is_written_as_its_seed_alone(row):
    key = key_of(row)
    assert len(key.pkcs8) == 54
    assert key.pkcs8.endswith(b"\x80\x20" + key.raw)


def pkcs8(row, octets, parameters=None):
    identifier = AlgorithmIdentifier(algorithm=Oid(row.key_oid), parameters=parameters)
    return encode(
        OneAsymmetricKey(
            version=0, algorithm=identifier, private_key=octets, attributes=None, public_key=None
        )
    )


MATRIX = {"ml-dsa-44": b"\4\4", "ml-dsa-65": b"\6\5", "ml-dsa-87": b"\x08\7"}


def both(row, key, *, seed=None, spoilt=None, size=None):
    """The form that OpenSSL 3.5 writes unless told otherwise, but for s1, s2 and t0."""
    public = key.public_key.raw
    secret = hashlib.shake_256(key.raw + MATRIX[row.name]).digest(128)[96:]
    begin = bytearray(public[:32] + secret + hashlib.shake_256(public).digest(64))
    if spoilt is not None:
        begin[spoilt] ^= 1
    expanded = bytes(begin).ljust(size or EXPANDED_SIZES[row.name], b"\0")
    return encode(SeedAndExpandedKey(seed=key.raw if seed is None else seed, expanded_key=expanded))


@each_ml_dsa
def test_an_ml_dsa_key_of_both_forms_is_read(row):
    key = key_of(row)
    assert same(load_private_key(pkcs8(row, both(row, key))), key)


@each_ml_dsa
def test_an_ml_dsa_key_of_a_bare_seed_is_read(row):
    key = key_of(row)
    assert same(load_private_key(pkcs8(row, key.raw)), key)


@each_ml_dsa
@pytest.mark.parametrize("start", ["30", "3082", "04", "8020", "801e"])
def test_a_seed_that_begins_like_a_tag_is_read(row, start):
    # One seed in 256 begins with the tag of a SEQUENCE.
    seed = bytes.fromhex(start).ljust(32, b"s")
    key = row.private_key(row.load_raw_private(seed))
    for octets in (seed, b"\x80\x20" + seed, both(row, key)):
        assert load_private_key(pkcs8(row, octets)).raw == seed


@each_ml_dsa
@pytest.mark.parametrize(
    "other",
    [{"seed": b"\1" * 32}, *({"spoilt": at} for at in (0, 31, 32, 63, 64, 127)), {"size": 4000}],
    ids=str,
)
def test_an_ml_dsa_key_whose_two_forms_differ_is_refused(row, other):
    with pytest.raises(MalformedError, match=f"the expanded form of this {row.name} key differ"):
        load_private_key(pkcs8(row, both(row, key_of(row), **other)))


@each_ml_dsa
@pytest.mark.parametrize("size", [0, 31, 33, 64])
def test_an_ml_dsa_key_with_a_seed_of_another_size_is_refused(row, size):
    with pytest.raises(MalformedError, match="is not 32 bytes"):
        load_private_key(pkcs8(row, both(row, key_of(row), seed=bytes(size))))
    with pytest.raises(MalformedError, match=f"not a private {row.name} key"):
        load_private_key(pkcs8(row, b"\x80" + bytes([size]) + bytes(size)))


@each_ml_dsa
def test_an_ml_dsa_key_of_the_expanded_form_alone_is_refused_with_the_way_out(row):
    octets = encode(bytes(EXPANDED_SIZES[row.name]))
    with pytest.raises(MalformedError, match="only its expanded form") as caught:
        load_private_key(pkcs8(row, octets))
    assert "seed-only" in caught.value.hint


@each_pq
@pytest.mark.parametrize("parameters", ["0500", "0603551d0e"], ids=["NULL", "an OID"])
def test_a_post_quantum_private_key_with_parameters_is_refused(row, parameters):
    octets = decode(OneAsymmetricKey, key_of(row).pkcs8, "key").private_key
    with pytest.raises(MalformedError, match=f"{row.name} keys have no parameters"):
        load_private_key(pkcs8(row, octets, raw(bytes.fromhex(parameters))))


@each_composite
def test_a_composite_private_key_with_another_ones_half_is_refused(row):
    ml_dsa = key_of(row).raw[:32]
    others = other_halves(row)
    for other in others:
        with pytest.raises(PqsecError):
            load_private_key(pkcs8(row, ml_dsa + key_of(other).raw[32:]))


@each_composite
@pytest.mark.parametrize("size", [0, 31, 32, 33])
def test_a_composite_private_key_cut_short_is_refused(row, size):
    with pytest.raises(MalformedError):
        load_private_key(pkcs8(row, key_of(row).raw[:size]))


@pytest.mark.parametrize("name", ["mldsa65+rsa3072", "mldsa65+p256"])
@pytest.mark.parametrize("half", ["encrypted", "of an unknown algorithm"])
def test_a_composite_private_key_with_a_half_that_cannot_be_used_is_refused(name, half):
    row = SIGNATURES.named(name)
    encrypted = native(
        key_of(row).handle[1], passphrase=b"x", encoding=Encoding.DER, form=PrivateFormat.PKCS8
    )
    unknown = pkcs8(ML_DSA[0], b"").replace(
        encode(Oid(ML_DSA[0].key_oid)), encode(Oid("1.2.3.4.5.6.7.8.9.10"))
    )
    octets = key_of(row).raw[:32] + (encrypted if half == "encrypted" else unknown)
    with pytest.raises((MalformedError, UnknownAlgorithmError)):
        load_private_key(pkcs8(row, octets))


@pytest.mark.parametrize(
    "data",
    [b"", b"hello", b"\x30", b"\x30\x03\x02\x01\x00", b"-----BEGIN PRIVATE KEY-----\nMTIz\n",
     pem("PRIVATE KEY", b""), pem("PRIVATE KEY", b"123"), pem("CERTIFICATE", b"123"),
     pem("EC PRIVATE KEY", b"123"), pem("OPENSSH PRIVATE KEY", b"123")],
)  # fmt: skip
def test_what_is_no_private_key_is_refused(data):
    with pytest.raises(MalformedError):
        load_private_key(data)


# Private keys in a traditional form


TRADITIONAL = [row for row in ROWS if row.family is Family.CLASSICAL]
each_traditional = pytest.mark.parametrize("row", TRADITIONAL, ids=lambda row: row.name)


@each_traditional
def test_a_traditional_pem_is_read(row):
    text = native(key_of(row).handle, PrivateFormat.TraditionalOpenSSL)
    assert b"BEGIN RSA" in text or b"BEGIN EC" in text
    assert same(load_private_key(text), key_of(row))
    assert not is_encrypted(text)


def test_a_traditional_pem_after_its_curve_is_read():
    # `openssl ecparam -genkey` writes the curve first.
    row = SIGNATURES.named("p256")
    curve = pem("EC PARAMETERS", bytes.fromhex("06082a8648ce3d030107"))
    text = curve + native(key_of(row).handle, PrivateFormat.TraditionalOpenSSL)
    assert same(load_private_key(text), key_of(row))


@each_traditional
def test_an_encrypted_traditional_pem_is_read_with_its_passphrase_only(row):
    text = native(key_of(row).handle, PrivateFormat.TraditionalOpenSSL, PASSPHRASE)
    assert is_encrypted(text)
    assert same(load_private_key(text, PASSPHRASE), key_of(row))
    with pytest.raises(PassphraseError, match="no passphrase was given"):
        load_private_key(text)
    with pytest.raises(PassphraseError, match="wrong passphrase"):
        load_private_key(text, b"other")


@pytest.mark.parametrize(
    ("found", "damage"),
    [
        (b"DEK-Info: ", b"DEK-Info: X"),
        (b"CBC,", b"CBC,0"),
        (b"DEK-Info: ", b"DEK-Info: AES-256-CBC,00\nDEK-Info: "),
    ],
    ids=["cipher", "initial value", "twice"],
)
def test_an_encrypted_traditional_pem_with_a_damaged_header_is_malformed(found, damage):
    row = SIGNATURES.named("p256")
    text = native(key_of(row).handle, PrivateFormat.TraditionalOpenSSL, PASSPHRASE)
    with pytest.raises(MalformedError, match="its DEK-Info line is damaged"):
        load_private_key(text.replace(found, damage), PASSPHRASE)


@each_row
def test_a_passphrase_for_a_key_that_needs_none_does_no_harm(row):
    assert same(load_private_key(private_key_pem(key_of(row)), PASSPHRASE), key_of(row))


# Encrypted PKCS#8


@each_row
def test_an_encrypted_private_key_is_read_back(row):
    text = private_key_pem(key_of(row), PASSPHRASE)
    assert is_encrypted(text)
    assert same(load_private_key(text, PASSPHRASE), key_of(row))


def test_an_encrypted_private_key_in_der_is_read():
    key = key_of(SIGNATURES.named("ml-dsa-65"))
    [(_, der)] = unpem(private_key_pem(key, PASSPHRASE), "key")
    assert is_encrypted(der)
    assert not is_encrypted(key.pkcs8)
    assert same(load_private_key(der, PASSPHRASE), key)
    with pytest.raises(PassphraseError, match="no passphrase was given"):
        load_private_key(der)


def test_a_private_key_is_never_encrypted_twice_alike():
    key = key_of(SIGNATURES.named("ml-dsa-65"))
    assert private_key_pem(key, PASSPHRASE) != private_key_pem(key, PASSPHRASE)


@pytest.mark.parametrize("passphrase", [b"", b"other", PASSPHRASE + b" "])
def test_a_wrong_passphrase_is_refused(passphrase):
    text = private_key_pem(key_of(SIGNATURES.named("ml-dsa-65")), PASSPHRASE)
    with pytest.raises(PassphraseError, match="wrong passphrase"):
        load_private_key(text, passphrase)


def test_a_missing_passphrase_is_said():
    text = private_key_pem(key_of(SIGNATURES.named("ml-dsa-65")), PASSPHRASE)
    with pytest.raises(PassphraseError, match="no passphrase was given"):
        load_private_key(text)


def encrypted_key(iterations=1, prf=256, **changes):
    """An encrypted ML-DSA key with a few iterations, and what `changes` says otherwise."""
    parts = {
        "salt": b"saltsalt",
        "iv": bytes(16),
        "data": ENCRYPTED_ONCE,
        "scheme": "1.2.840.113549.1.5.13",
        "derivation": PBKDF2,
        "cipher": AES_256_CBC,
    } | changes
    function = None if prf is None else algorithm(HMAC_SHA[prf], null=True)
    derivation = PBKDF2Params(
        salt=parts["salt"], iteration_count=iterations, key_length=None, prf=function
    )
    parameters = PBES2Params(
        key_derivation=with_parameters(parts["derivation"], encode(derivation)),
        encryption=with_parameters(parts["cipher"], encode(parts["iv"])),
    )
    identifier = with_parameters(parts["scheme"], encode(parameters))
    return encode(EncryptedPrivateKeyInfo(algorithm=identifier, encrypted_data=parts["data"]))


def with_parameters(oid, der):
    return AlgorithmIdentifier(algorithm=Oid(oid), parameters=raw(der))


# The PKCS#8 of the ML-DSA-44 key of the seed 00..1f, under "horse", one iteration of
# PBKDF2-HMAC-SHA256 with the salt "saltsalt", and an IV of zeros (made with OpenSSL 3.0).
SEED = bytes(range(32))
ENCRYPTED_ONCE = bytes.fromhex(
    "5c45c06dd91b232395e629e6aadf6403aa678c41d7c89c42803093ac79a99cf4"
    "719ddf97d87c66e926d00a595164a2e6e8fbd8115458860f8125b52ee4123d25"
)


def test_a_key_that_another_tool_encrypted_is_read():
    key = load_private_key(encrypted_key(), b"horse")
    assert (key.algorithm.name, key.raw) == ("ml-dsa-44", SEED)


def test_a_wrong_passphrase_that_happens_to_pad_rightly_is_refused_as_such():
    # One wrong key in 256 decrypts to something with a right padding.
    for number in range(2000):
        with pytest.raises(PassphraseError, match="wrong passphrase"):
            load_private_key(encrypted_key(), str(number).encode())


@pytest.mark.parametrize("iterations", [-1, 0, MAX_ITERATIONS + 1, 2**31, 2**64])
def test_a_senseless_iteration_count_is_refused_before_any_work(iterations):
    with pytest.raises(MalformedError, match="an invalid parameter"):
        load_private_key(encrypted_key(iterations), b"horse")


def encrypted_by(cipher, prf, size):
    """The same key in the way of another tool."""
    key = hashlib.pbkdf2_hmac(f"sha{prf or 1}", b"horse", b"saltsalt", 1, size)
    padder, encryptor = (
        padding.PKCS7(128).padder(),
        Cipher(AES(key), modes.CBC(bytes(16))).encryptor(),
    )
    padded = padder.update(SIGNATURES.named("ml-dsa-44").pkcs8(seeded().handle)) + padder.finalize()
    return encrypted_key(
        prf=prf, cipher=cipher, data=encryptor.update(padded) + encryptor.finalize()
    )


def seeded():
    row = SIGNATURES.named("ml-dsa-44")
    return row.private_key(row.load_raw_private(SEED))


@pytest.mark.parametrize("prf", [None, 1, 256, 384, 512], ids=lambda prf: f"SHA-{prf}")
@pytest.mark.parametrize(("arc", "size"), [(2, 16), (22, 24), (42, 32)], ids=["128", "192", "256"])
def test_what_other_tools_choose_is_read(arc, size, prf):
    der = encrypted_by(f"2.16.840.1.101.3.4.1.{arc}", prf, size)
    assert load_private_key(der, b"horse").raw == SEED
    with pytest.raises(PassphraseError, match="wrong passphrase"):
        load_private_key(der, b"cow")


def test_an_unknown_pseudorandom_function_is_refused():
    der = encrypted_key().replace(encode(Oid(HMAC_SHA[256])), encode(Oid("1.2.840.113549.2.5")))
    with pytest.raises(MalformedError, match="an invalid parameter"):
        load_private_key(der, b"horse")


@pytest.mark.parametrize(
    ("part", "oid"),
    [
        pytest.param("scheme", "1.2.840.113549.1.5.3", id="PBES1"),
        pytest.param("derivation", "1.3.6.1.4.1.11591.4.11", id="scrypt"),
        pytest.param("cipher", "1.2.840.113549.3.7", id="triple DES"),
    ],
)
def test_another_encryption_scheme_is_refused(part, oid):
    with pytest.raises(MalformedError, match="is not encrypted with"):
        load_private_key(encrypted_key(**{part: oid}), b"horse")


@pytest.mark.parametrize(
    "identifier",
    [algorithm("1.2.840.113549.1.5.13"), algorithm("1.2.840.113549.1.5.13", null=True)],
    ids=["absent", "NULL"],
)
def test_an_encryption_scheme_without_parameters_is_refused(identifier):
    der = encode(EncryptedPrivateKeyInfo(algorithm=identifier, encrypted_data=bytes(16)))
    with pytest.raises(MalformedError, match="PBES2 parameters"):
        load_private_key(pem("ENCRYPTED PRIVATE KEY", der), b"horse")


@pytest.mark.parametrize("data", [b"", bytes(15), ENCRYPTED_ONCE[:-1], ENCRYPTED_ONCE[:-16]])
def test_an_encrypted_private_key_cut_short_is_refused(data):
    with pytest.raises(PqsecError):
        load_private_key(encrypted_key(data=data), b"horse")


def test_an_initialisation_vector_of_another_size_is_refused():
    with pytest.raises(PqsecError):
        load_private_key(encrypted_key(iv=bytes(8)), b"horse")


@each_traditional
def test_encrypted_pkcs8_of_another_library_is_read(row):
    text = native(key_of(row).handle, PrivateFormat.PKCS8, PASSPHRASE)
    assert same(load_private_key(text, PASSPHRASE), key_of(row))


@pytest.mark.interop
@pytest.mark.parametrize("name", ["ecdsa-p256", "ecdsa-p384", "rsa-2048"])
@pytest.mark.parametrize("options", [[], ["-iter", "100000"], ["-v2prf", "hmacWithSHA512"]])
def test_what_openssl_pkcs8_encrypts_is_read(requires, tmp_path, name, options):
    openssl = requires(shutil.which("openssl"), "openssl", "apt-get install openssl")
    row = SIGNATURES.named(name)
    command = [openssl, "pkcs8", "-topk8", "-passout", "pass:horse", *options]
    done = subprocess.run(
        command, input=private_key_pem(key_of(row)), capture_output=True, check=True
    )
    assert is_encrypted(done.stdout)
    assert same(load_private_key(done.stdout, b"horse"), key_of(row))
    with pytest.raises(PassphraseError, match="wrong passphrase"):
        load_private_key(done.stdout, b"cow")


# Keys of algorithms that no row is for


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (ed25519.Ed25519PrivateKey.generate, "Ed25519|1.3.101.112"),
        (x25519.X25519PrivateKey.generate, "X25519|1.3.101.110"),
        (lambda: ec.generate_private_key(ec.SECP521R1()), "secp521r1"),
        (lambda: ec.generate_private_key(ec.BrainpoolP256R1()), "brainpoolP256r1"),
        (lambda: rsa.generate_private_key(65537, 1024), "1024 bits"),  # noqa: S505 -- that is the flaw
    ],
)
def test_a_key_that_no_row_is_for_is_refused_and_named(make, words):
    handle = make()
    spki = handle.public_key().public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
    with pytest.raises(UnknownAlgorithmError, match=words):
        load_private_key(native(handle))
    with pytest.raises(UnknownAlgorithmError, match=words):
        load_public_key(spki)


def test_keys_of_an_unknown_oid_are_refused():
    identifier = algorithm("1.2.3.4")
    spki = encode(SubjectPublicKeyInfo(algorithm=identifier, subject_public_key=bits(b"key")))
    with pytest.raises(UnknownAlgorithmError, match=r"1\.2\.3\.4"):
        load_public_key(spki)
    der = OneAsymmetricKey(
        version=0, algorithm=identifier, private_key=b"key", attributes=None, public_key=None
    )
    with pytest.raises(UnknownAlgorithmError):
        load_private_key(encode(der))


# Public keys


def spki_of(row, data, parameters=None, unused=0):
    identifier = AlgorithmIdentifier(algorithm=Oid(row.key_oid), parameters=parameters)
    info = SubjectPublicKeyInfo(algorithm=identifier, subject_public_key=BitString(data, unused))
    return encode(info)


@each_row
def test_a_public_key_is_read_back(row):
    key = key_of(row).public_key
    copy = load_public_key(key.spki)
    assert (copy.algorithm, copy.raw, copy.spki) == (row, key.raw, key.spki)


@each_pq
@pytest.mark.parametrize("parameters", ["0500", "0603551d0e"], ids=["NULL", "an OID"])
def test_a_post_quantum_public_key_with_parameters_is_refused(row, parameters):
    with pytest.raises(PqsecError):
        load_public_key(spki_of(row, key_of(row).public_key.raw, raw(bytes.fromhex(parameters))))


@each_pq
@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda key: key[:-1], id="cut short"),
        pytest.param(lambda key: key + b"\0", id="longer"),
        pytest.param(lambda _: b"", id="empty"),
    ],
)
def test_a_post_quantum_public_key_of_another_size_is_refused(row, change):
    with pytest.raises(MalformedError):
        load_public_key(spki_of(row, change(key_of(row).public_key.raw)))


@each_pq
def test_a_public_key_with_unused_bits_is_refused(row):
    data = key_of(row).public_key.raw[:-1] + b"\0"
    with pytest.raises(MalformedError):
        load_public_key(spki_of(row, data, unused=1))


@each_composite
def test_a_composite_public_key_with_another_ones_half_is_refused(row):
    cut = row.ml_dsa.public_key_size
    others = other_halves(row)
    for other in others:
        half = key_of(other).public_key.raw[other.ml_dsa.public_key_size :]
        with pytest.raises(MalformedError, match=f"not a {row.name} public key"):
            load_public_key(spki_of(row, key_of(row).public_key.raw[:cut] + half))


@pytest.mark.parametrize("name", ["mldsa65+p256", "mldsa87+p384"])
@pytest.mark.parametrize("flaw", ["compressed", "off the curve", "infinity"])
def test_a_composite_public_key_with_a_bad_point_is_refused(name, flaw):
    row = SIGNATURES.named(name)
    cut = row.ml_dsa.public_key_size
    ml_dsa, point = key_of(row).public_key.raw[:cut], bytearray(key_of(row).public_key.raw[cut:])
    bad = {
        "compressed": bytes([2 + point[-1] % 2]) + point[1 : 1 + len(point) // 2],
        "off the curve": point[:-1] + bytes([point[-1] ^ 1]),
        "infinity": b"\0",
    }
    with pytest.raises(MalformedError, match=f"not a {row.name} public key"):
        load_public_key(spki_of(row, ml_dsa + bad[flaw]))


@pytest.mark.parametrize("half", ["as SubjectPublicKeyInfo", "of an unknown algorithm"])
def test_a_composite_public_key_with_an_rsa_half_in_another_form_is_refused(half):
    row = SIGNATURES.named("mldsa65+rsa3072")
    key = key_of(row).public_key
    wrapped = key.handle[1].public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
    unknown = encode(
        SubjectPublicKeyInfo(algorithm=algorithm("1.2.3.4"), subject_public_key=bits(b"key"))
    )
    data = key.raw[: row.ml_dsa.public_key_size] + (wrapped if "Info" in half else unknown)
    with pytest.raises(MalformedError, match="not an RSA key of 3072 bits"):
        load_public_key(spki_of(row, data))


@pytest.mark.parametrize("data", [b"", b"\x30\x00", b"\x30\x80\x00\x00", b"key"])
def test_what_is_no_public_key_is_refused(data):
    with pytest.raises(MalformedError, match="not a DER SubjectPublicKeyInfo"):
        load_public_key(data)


# What keys say of themselves


@each_row
def test_a_private_key_prints_nothing_of_itself(row):
    key = key_of(row)
    shown = f"{key!r} {key} {pair_private(key, key_of(ML_DSA[1]))!r}"
    assert row.name in shown
    assert key.raw.hex() not in shown
    assert repr(key.raw)[2:30] not in shown
    assert "handle" not in shown


def test_an_end_line_that_repeats_the_key_is_not_quoted():
    """The library's error would, and an error keeps the one that it was raised in."""
    begin, *body, end, _ = private_key_pem(ROWS[0].generate()).split(b"\n")
    data = b"\n".join([begin, *body, b"-----END " + body[-1], end, b""])
    with pytest.raises(MalformedError) as caught:
        load_private_key(data)
    assert caught.value.__context__ is caught.value.__cause__ is None


@pytest.mark.parametrize("arc", [36, 55], ids=["before the draft's", "after them"])
def test_a_composite_key_that_is_not_offered_is_refused_with_its_oid(arc):
    oid = f"1.3.6.1.5.5.7.6.{arc}"
    der = encode(
        OneAsymmetricKey(
            version=0,
            algorithm=AlgorithmIdentifier(algorithm=Oid(oid), parameters=None),
            private_key=bytes(100),
            attributes=None,
            public_key=None,
        )
    )
    for data in (der, pem("PRIVATE KEY", der)):
        with pytest.raises(UnknownAlgorithmError, match=f"algorithm {oid} are not known here"):
            load_private_key(data)


@pytest.mark.parametrize("label", ["PRIVATE KEY", "ENCRYPTED PRIVATE KEY"])
def test_a_private_key_in_pkcs8_with_a_header_is_refused(label):
    text = pem(label, key_of(ML_DSA[0]).pkcs8).replace(b"-----\n", b"-----\nX: y\n\n", 1)
    with pytest.raises(MalformedError, match="traditional private keys only"):
        load_private_key(text, b"horse")


def test_a_key_behind_broken_parameters_is_refused_as_openssl_does():
    key = private_key_pem(key_of(SIGNATURES.named("ecdsa-p256")))
    curve = pem("EC PARAMETERS", encode(Oid("1.2.840.10045.3.1.7")))
    assert load_private_key(curve + key)
    with pytest.raises(MalformedError, match="name of a curve"):
        load_private_key(pem("EC PARAMETERS", b"123") + key)
