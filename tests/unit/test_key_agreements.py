"""Every row of the table does what the table promises, and refuses what is no key."""

import hashlib

import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from pqsec_pki.algorithms import KEY_AGREEMENTS, Family
from pqsec_pki.algorithms._diffie_hellman import G, ModpKey, P
from pqsec_pki.errors import UnknownAlgorithmError, VerificationError
from tests.interop.der import Der

ROWS = {row.name: row for row in KEY_AGREEMENTS}
MODP = ROWS["dh-modp-2048-256"]
every_row = pytest.mark.parametrize("row", list(KEY_AGREEMENTS), ids=lambda row: row.name)
of_fixed_size = pytest.mark.parametrize(
    "row", [row for row in KEY_AGREEMENTS if row is not MODP], ids=lambda row: row.name
)

# docs/reference/wire.md 6.2: names and bytes of the TLS groups (RFC 10024), and DDS-Security's own.
WIRE = {
    "ecdh-p256": ("ECDH+prime256v1-CEUM", 65, 65, 32),
    "ecdh-p384": ("ECDHE-CEUM+P384", 97, 97, 48),
    "dh-modp-2048-256": ("DH+MODP-2048-256", 261, 261, 256),
    "mlkem768": ("MLKEM768", 1184, 1088, 32),
    "mlkem1024": ("MLKEM1024", 1568, 1568, 32),
    "x25519mlkem768": ("X25519MLKEM768", 1216, 1120, 64),
    "secp256r1mlkem768": ("SecP256r1MLKEM768", 1249, 1153, 64),
    "secp384r1mlkem1024": ("SecP384r1MLKEM1024", 1665, 1665, 80),
}


def test_the_table_has_the_names_and_sizes_that_are_on_the_wire():
    found = {
        row.name: (row.wire_name, row.public_size, row.ciphertext_size, row.secret_size)
        for row in KEY_AGREEMENTS
    }
    assert found == WIRE


@every_row
def test_both_sides_reach_one_secret(row):
    own = row.generate()
    ciphertext, secret = row.encapsulate(own.public)
    assert own.decapsulate(ciphertext) == secret


@of_fixed_size
def test_keys_ciphertexts_and_secrets_have_the_sizes_the_row_says(row):
    own = row.generate()
    ciphertext, secret = row.encapsulate(own.public)
    sizes = (len(own.public), len(ciphertext), len(secret))
    assert sizes == (row.public_size, row.ciphertext_size, row.secret_size)


@every_row
def test_two_key_pairs_are_never_the_same(row):
    assert row.generate().public != row.generate().public


@every_row
def test_a_key_pair_prints_nothing_of_its_private_half(row):
    assert "handle" not in repr(row.generate())


@every_row
@pytest.mark.parametrize(
    "change",
    [
        lambda data: b"",
        lambda data: data[:-1],
        lambda data: data + b"\0",
        lambda data: data * 800,
    ],
    ids=["empty", "short", "long", "huge"],
)
def test_a_public_key_or_ciphertext_of_a_wrong_size_is_refused(row, change):
    own = row.generate()
    ciphertext, _ = row.encapsulate(own.public)
    with pytest.raises(VerificationError):
        row.encapsulate(change(own.public))
    with pytest.raises(VerificationError):
        own.decapsulate(change(ciphertext))


@every_row
def test_a_public_key_of_all_ones_is_refused(row):
    # Off every curve, over the MODP prime, and over ML-KEM's modulus (FIPS 203 7.2).
    with pytest.raises(VerificationError):
        row.encapsulate(b"\xff" * row.public_size)


@pytest.mark.parametrize("name", ["mlkem768", "mlkem1024"])
def test_an_ml_kem_key_with_one_coefficient_over_the_modulus_is_refused(name):
    row = ROWS[name]
    public = row.generate().public
    with pytest.raises(VerificationError, match="public key"):
        row.encapsulate(b"\xff\xff" + public[2:])


@pytest.mark.parametrize("name", ["mlkem768", "mlkem1024"])
def test_a_changed_ml_kem_ciphertext_gives_a_secret_that_nobody_has(name):
    own = ROWS[name].generate()
    ciphertext, secret = ROWS[name].encapsulate(own.public)
    changed = bytes([ciphertext[0] ^ 1]) + ciphertext[1:]
    assert own.decapsulate(changed) != secret


@pytest.mark.parametrize(
    "name", ["ecdh-p256", "ecdh-p384", "secp256r1mlkem768", "secp384r1mlkem1024"]
)
@pytest.mark.parametrize("first", [0x00, 0x02, 0x05, 0x06], ids="0x{:02x}".format)
def test_a_point_that_says_it_is_of_another_form_is_refused(name, first):
    public = bytearray(ROWS[name].generate().public)
    public[0] = first
    with pytest.raises(VerificationError):
        ROWS[name].encapsulate(bytes(public))


@pytest.mark.parametrize("name", ["ecdh-p256", "ecdh-p384"])
def test_a_point_off_the_curve_is_refused(name):
    row = ROWS[name]
    public = row.generate().public
    off = public[:-1] + bytes([public[-1] ^ 1])
    with pytest.raises(VerificationError, match="public key"):
        row.encapsulate(off)


def test_a_compressed_point_is_refused():
    key = ec.generate_private_key(ec.SECP256R1()).public_key()
    with pytest.raises(VerificationError, match="33 bytes"):
        ROWS["ecdh-p256"].encapsulate(key.public_bytes(Encoding.X962, PublicFormat.CompressedPoint))


def test_the_point_at_infinity_is_refused():
    with pytest.raises(VerificationError):
        ROWS["ecdh-p256"].encapsulate(b"\0")


@pytest.mark.parametrize("point", [bytes(32), b"\1" + bytes(31)], ids=["zero", "one"])
def test_an_x25519_point_of_small_order_is_refused_inside_a_hybrid(point):
    row = ROWS["x25519mlkem768"]
    own = row.generate()
    with pytest.raises(VerificationError, match="x25519"):
        row.encapsulate(own.public[:1184] + point)
    ciphertext, _ = row.encapsulate(own.public)
    with pytest.raises(VerificationError, match="x25519"):
        own.decapsulate(ciphertext[:1088] + point)


@pytest.mark.parametrize(
    ("name", "first", "second"),
    [
        ("x25519mlkem768", "mlkem768", None),
        ("secp256r1mlkem768", "ecdh-p256", "mlkem768"),
        ("secp384r1mlkem1024", "ecdh-p384", "mlkem1024"),
    ],
)
def test_a_hybrid_is_its_halves_side_by_side_in_the_order_of_tls(name, first, second):
    row = ROWS[name]
    own = row.generate()
    ciphertext, secret = row.encapsulate(own.public)
    one, two = own._handle
    half = ROWS[first]
    cut, cut_secret = half.ciphertext_size, half.secret_size
    assert own.public == one.public + two.public
    assert one.agreement is half
    assert second is None or two.agreement is ROWS[second]
    assert one.decapsulate(ciphertext[:cut]) == secret[:cut_secret]
    assert two.decapsulate(ciphertext[cut:]) == secret[cut_secret:]


def test_modp_answers_in_the_form_it_was_asked_in():
    own = MODP.generate()
    raw = MODP.key_pair(ModpKey(1000, der=False))
    for value in (own.public, MODP.encapsulate(own.public)[0]):
        assert Der.of(0x02, Der(value).content) == value  # whatever its length, which is random
    ciphertext, secret = MODP.encapsulate(raw.public)
    assert len(ciphertext) <= 256
    assert raw.decapsulate(ciphertext) == secret


def test_modp_reads_an_integer_that_is_a_little_short():
    # G^1028 has 2039 bits, so its DER length takes one byte fewer than usual.
    short = MODP.key_pair(ModpKey(1028))
    assert short.public[:3] == b"\x02\x81\xff"
    ciphertext, secret = MODP.encapsulate(short.public)
    assert short.decapsulate(ciphertext) == secret


def test_modp_secrets_lose_their_leading_zeros():
    one, two = MODP.key_pair(ModpKey(1000)), MODP.key_pair(ModpKey(67))
    number = pow(G, 67000, P)
    assert one.decapsulate(two.public) == two.decapsulate(one.public) == number.to_bytes(255)


@pytest.mark.parametrize(
    "value",
    [0, 1, 2, P - 1, P, P + 1],
    ids=["zero", "one", "of another order", "minus one", "the modulus", "over the modulus"],
)
@pytest.mark.parametrize("der", [False, True], ids=["raw", "der"])
def test_a_modp_value_outside_the_group_is_refused(value, der):
    body = value.to_bytes(257) if der else value.to_bytes(256)
    public = b"\x02\x82\x01\x01" + body if der else body
    with pytest.raises(VerificationError):
        MODP.encapsulate(public)


def test_a_modp_integer_with_padding_is_refused():
    public = MODP.key_pair(ModpKey(1028)).public
    with pytest.raises(VerificationError):
        MODP.encapsulate(b"\x02\x82\x01\x00\x00" + public[3:])


def test_a_negative_modp_integer_is_refused():
    # G^1001 has its top bit set, so without a zero in front it reads as negative.
    y = pow(G, 1001, P)
    assert y.bit_length() == 2048
    with pytest.raises(VerificationError):
        MODP.encapsulate(b"\x02\x82\x01\x00" + y.to_bytes(256))


@every_row
def test_only_what_is_not_classical_binds_the_transcript(row):
    secret, signed = b"secret", b"octets of the reply"
    if row.family is Family.CLASSICAL:
        expected = hashlib.sha256(secret).digest()
    else:
        expected = hashlib.sha256(secret + hashlib.sha256(signed).digest()).digest()
    assert row.shared_secret(secret, signed) == expected
    changed = row.shared_secret(secret, signed + b".")
    assert (changed != expected) is row.binds_transcript


@every_row
def test_only_what_a_quantum_computer_breaks_has_level_zero(row):
    assert (row.level == 0) is (row.family is Family.CLASSICAL)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("ML-KEM-768", "mlkem768"),
        ("MLKEM1024", "mlkem1024"),
        ("X25519-ML-KEM-768", "x25519mlkem768"),
        ("SecP256r1MLKEM768", "secp256r1mlkem768"),
        ("P256", "ecdh-p256"),
    ],
)
def test_names_are_found_in_any_case_and_by_alias(text, name):
    assert KEY_AGREEMENTS.named(text) is ROWS[name]


def test_an_unknown_name_is_refused_with_the_known_ones():
    with pytest.raises(UnknownAlgorithmError, match="'rot13'") as caught:
        KEY_AGREEMENTS.named("rot13")
    assert caught.value.hint is not None
    assert "x25519mlkem768" in caught.value.hint


@every_row
def test_a_wire_name_finds_its_row_and_no_other_case_does(row):
    assert KEY_AGREEMENTS.on_wire(row.wire_name) is row
    with pytest.raises(UnknownAlgorithmError):
        KEY_AGREEMENTS.on_wire(row.wire_name.swapcase())
