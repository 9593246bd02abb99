"""Signatures, for every row: what holds, and each way in which it must not."""

import pytest
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import padding

from pqsec_pki._asn1 import AlgorithmIdentifier, SubjectPublicKeyInfo, algorithm, decode, encode
from pqsec_pki.algorithms import (
    SIGNATURES,
    Digest,
    Family,
    digest_of,
    load_public_key,
    pair_private,
)
from pqsec_pki.algorithms._table import AlgorithmTable
from pqsec_pki.algorithms.digest import DIGESTS
from pqsec_pki.algorithms.signature import COMPOSITES
from pqsec_pki.errors import UnknownAlgorithmError, VerificationError
from tests.some_keys import some_key as key_of

DATA = b"What a robot may do on domain 7."
ROWS = list(SIGNATURES)
RSA = [row for row in ROWS if row.name.startswith("rsa-")]
SHORT = [row for row in ROWS if row not in RSA]
PAIRS = [("ecdsa-p256", "ml-dsa-65"), ("rsa-2048", "ml-dsa-44"), ("ecdsa-p384", "ml-dsa-87")]

each_row = pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
each_composite = pytest.mark.parametrize("row", COMPOSITES, ids=lambda row: row.name)
each_rsa = pytest.mark.parametrize("row", RSA, ids=lambda row: row.name)
each_pair = pytest.mark.parametrize(("plain", "alternative"), PAIRS)


def pair_of(plain, alternative, owner="alice"):
    return pair_private(key_of(plain, owner), key_of(alternative, owner))


def flipped(data, at):
    altered = bytearray(data)
    altered[at] ^= 1
    return bytes(altered)


def refuses(key, signature, data=DATA, **marked):
    with pytest.raises(VerificationError) as caught:
        key.verify(signature, data, **marked)
    return str(caught.value)


def refuses_handshake(key, signature, data=DATA):
    with pytest.raises(VerificationError, match=r"bad .* signature"):
        key.verify_handshake(signature, data)


# What holds


@each_row
def test_a_signature_holds(row):
    key = key_of(row.name)
    key.public_key.verify(key.sign(DATA), DATA)
    key.public_key.verify(key.sign(DATA), DATA, row.identifier)
    key.public_key.verify(key.sign(b""), b"")


@each_row
def test_a_handshake_signature_holds(row):
    key = key_of(row.name)
    key.public_key.verify_handshake(key.sign_handshake(DATA), DATA)


@each_row
def test_the_sizes_that_a_row_promises_are_the_real_ones(row):
    key = key_of(row.name)
    sizes = {len(key.sign(DATA)), len(key.sign_handshake(DATA))}
    if row.family is Family.CLASSICAL and row.name.startswith("ecdsa"):
        assert max(sizes) <= row.signature_size <= max(sizes) + 10
    elif "ecdsa" in row.name:
        assert row.signature_size - 10 <= min(sizes) <= max(sizes) <= row.signature_size
    else:
        assert sizes == {row.signature_size}
    info = decode(SubjectPublicKeyInfo, key.public_key.spki, "key")
    assert len(info.subject_public_key.as_bytes()) == row.public_key_size


@each_row
def test_a_key_is_marked_with_the_oid_of_its_row(row):
    info = decode(SubjectPublicKeyInfo, key_of(row.name).public_key.spki, "key")
    assert info.algorithm.algorithm.dotted_string == row.key_oid
    if row.family is not Family.CLASSICAL:
        assert info.algorithm.parameters is None


@each_row
def test_a_key_is_of_its_row_and_of_no_other(row):
    key = key_of(row.name).public_key
    assert load_public_key(key.spki).algorithm is row
    found = [other for other in ROWS if other.matches(key.handle)]
    # Two composites whose RSA halves sign differently have keys that differ in the OID only.
    alike = [
        other for other in ROWS if row.parts and other.parts and _halves(other) == _halves(row)
    ]
    assert found == (alike or [row])


def _halves(row):
    ml_dsa, traditional = row.parts
    return ml_dsa, getattr(traditional, "bits", traditional)


@each_row
def test_post_quantum_signatures_have_a_level_and_classical_ones_none(row):
    assert (row.level == 0) == (row.family is Family.CLASSICAL)


# What does not


@each_row
def test_altered_data_is_refused(row):
    key = key_of(row.name)
    refuses(key.public_key, key.sign(DATA), DATA + b" ")
    refuses(key.public_key, key.sign(DATA), b"")
    refuses_handshake(key.public_key, key.sign_handshake(DATA), flipped(DATA, 0))


@each_row
@pytest.mark.parametrize("at", [0, 40, -1])
def test_an_altered_signature_is_refused(row, at):
    key = key_of(row.name)
    refuses(key.public_key, flipped(key.sign(DATA), at))
    refuses_handshake(key.public_key, flipped(key.sign_handshake(DATA), at))


@each_row
@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda _: b"", id="empty"),
        pytest.param(lambda s: s[:-1], id="cut short"),
        pytest.param(lambda s: s + b"\0", id="longer"),
        pytest.param(lambda s: bytes(len(s)), id="all zero"),
    ],
)
def test_a_signature_of_another_shape_is_refused(row, change):
    key = key_of(row.name)
    refuses(key.public_key, change(key.sign(DATA)))
    refuses_handshake(key.public_key, change(key.sign_handshake(DATA)))


@pytest.mark.parametrize("row", [*SHORT, RSA[0]], ids=lambda row: row.name)
def test_a_signature_by_another_key_is_refused(row):
    key, other = key_of(row.name), key_of(row.name, "mallory")
    refuses(key.public_key, other.sign(DATA))
    refuses_handshake(key.public_key, other.sign_handshake(DATA))


@each_row
def test_a_signature_marked_with_another_algorithm_is_refused(row):
    key = key_of(row.name)
    signature = key.sign(DATA)
    foreign = {other.identifier for other in ROWS if not row.accepts(other.identifier)}
    assert len(foreign) >= len(ROWS) - len(RSA) - 1
    for identifier in foreign:
        words = refuses(key.public_key, signature, identifier=identifier)
        assert "does not fit" in words


@each_row
def test_a_signature_marked_with_senseless_bytes_is_refused(row):
    key = key_of(row.name)
    for identifier in (b"", b"\x30\x00", row.identifier + b"\0"):
        words = refuses(key.public_key, key.sign(DATA), identifier=identifier)
        assert "does not fit" in words


@pytest.mark.parametrize("row", [row for row in ROWS if row not in RSA], ids=lambda row: row.name)
def test_a_signature_marked_with_parameters_that_must_be_absent_is_refused(row):
    oid = decode(AlgorithmIdentifier, row.identifier, "identifier").algorithm.dotted_string
    with_null = encode(algorithm(oid, null=True))
    key = key_of(row.name)
    assert "does not fit" in refuses(key.public_key, key.sign(DATA), identifier=with_null)


@each_rsa
def test_an_rsa_signature_marked_without_its_parameters_is_refused(row):
    oid = decode(AlgorithmIdentifier, row.identifier, "identifier").algorithm.dotted_string
    key = key_of(row.name)
    words = refuses(key.public_key, key.sign(DATA), identifier=encode(algorithm(oid)))
    assert "does not fit" in words


@pytest.mark.parametrize("name", ["ecdsa-p256", "ecdsa-p384", "rsa-2048"])
def test_a_classical_signature_is_checked_with_the_hash_it_is_marked_with(name):
    key = key_of(name)
    identifiers = [row.identifier for row in ROWS if key.algorithm.accepts(row.identifier)]
    wrong = [each for each in identifiers if each != key.algorithm.identifier]
    for identifier in wrong:
        assert refuses(key.public_key, key.sign(DATA), identifier=identifier).startswith("bad")


@each_rsa
def test_certificates_and_handshakes_pad_rsa_differently(row):
    key = key_of(row.name)
    refuses_handshake(key.public_key, key.sign(DATA))
    refuses(key.public_key, key.sign_handshake(DATA))


@each_rsa
@pytest.mark.parametrize("salt", [0, 32, padding.PSS.MAX_LENGTH])
def test_a_handshake_signature_may_have_a_salt_of_any_length(row, salt):
    key = key_of(row.name)
    scheme = padding.PSS(padding.MGF1(hashes.SHA256()), salt)
    key.public_key.verify_handshake(key.handle.sign(DATA, scheme, hashes.SHA256()), DATA)


@each_rsa
@pytest.mark.parametrize(("mask", "digest"), [("SHA1", "SHA256"), ("SHA512", "SHA512")])
def test_a_handshake_signature_with_another_hash_is_refused(row, mask, digest):
    key = key_of(row.name)
    scheme = padding.PSS(padding.MGF1(getattr(hashes, mask)()), 20)
    refuses_handshake(key.public_key, key.handle.sign(DATA, scheme, getattr(hashes, digest)()))


# Composites


@each_composite
def test_a_composite_signature_without_its_ml_dsa_half_is_refused(row):
    key = key_of(row.name)
    rest = key.sign(DATA)[row.ml_dsa.signature_size :]
    refuses(key.public_key, rest)
    refuses(key.public_key, bytes(row.ml_dsa.signature_size) + rest)


@each_composite
def test_a_composite_signature_without_its_classical_half_is_refused(row):
    key = key_of(row.name)
    ml_dsa = key.sign(DATA)[: row.ml_dsa.signature_size]
    refuses(key.public_key, ml_dsa)
    refuses(key.public_key, ml_dsa + bytes(64))


@each_composite
def test_a_composite_signature_with_its_halves_swapped_is_refused(row):
    key, cut = key_of(row.name), row.ml_dsa.signature_size
    signature = key.sign(DATA)
    refuses(key.public_key, signature[cut:] + signature[:cut])


@pytest.mark.parametrize(
    "row", [row for row in COMPOSITES if "rsa" not in row.name], ids=lambda row: row.name
)
@pytest.mark.parametrize("kept", [0, 1], ids=["ml-dsa kept", "classical kept"])
def test_a_composite_signature_with_one_half_by_another_key_is_refused(row, kept):
    key, other = key_of(row.name), key_of(row.name, "mallory")
    handles = list(other.handle)
    handles[kept] = key.handle[kept]
    refuses(key.public_key, row.sign(tuple(handles), DATA))


@each_composite
def test_the_halves_of_a_composite_signature_are_good_for_nothing_alone(row):
    key, cut = key_of(row.name), row.ml_dsa.signature_size
    signature = key.sign(DATA)
    ml_dsa, traditional = key.public_key.handle
    refuses(row.ml_dsa.public_key(ml_dsa), signature[:cut])
    refuses(row.traditional.public_key(traditional), signature[cut:])


@each_composite
def test_plain_signatures_side_by_side_are_no_composite_signature(row):
    key = key_of(row.name)
    ml_dsa, traditional = key.handle
    both = row.ml_dsa.sign(ml_dsa, DATA) + row.traditional.sign(traditional, DATA)
    refuses(key.public_key, both)


@each_composite
def test_a_context_is_bound_and_has_at_most_255_bytes(row):
    key = key_of(row.name)
    signature = row.sign(key.handle, DATA, b"c" * 255)
    row.check(key.public_key.handle, signature, DATA, row.identifier, b"c" * 255)
    with pytest.raises(InvalidSignature):
        row.check(key.public_key.handle, signature, DATA, row.identifier, b"c" * 254)
    with pytest.raises(ValueError, match="context too long"):
        row.sign(key.handle, DATA, b"c" * 256)


def test_no_two_composites_share_a_label():
    assert len({row.label for row in COMPOSITES}) == len(COMPOSITES)


# Pairs: the two keys of a certificate with an alternative signature


@each_pair
def test_the_signature_of_a_pair_holds(plain, alternative):
    key = pair_of(plain, alternative)
    signature = key.sign_handshake(DATA)
    key.public_key.verify_handshake(signature, DATA)
    row = key.algorithm
    assert (row.family, row.level) == (Family.HYBRID, SIGNATURES.named(alternative).level)
    assert row.signature_size - 10 <= len(signature) <= row.signature_size


@each_pair
def test_a_pair_is_one_row_however_often_it_is_made(plain, alternative):
    assert pair_of(plain, alternative).algorithm is pair_of(plain, alternative).algorithm


@each_pair
def test_the_signature_of_a_pair_without_its_ml_dsa_half_is_refused(plain, alternative):
    key = pair_of(plain, alternative)
    rest = key.sign_handshake(DATA)[SIGNATURES.named(alternative).signature_size :]
    key_of(plain).public_key.verify_handshake(rest, DATA)  # good for the plain key alone
    refuses_handshake(key.public_key, rest)


@each_pair
def test_the_signature_of_a_pair_without_its_classical_half_is_refused(plain, alternative):
    key = pair_of(plain, alternative)
    ml_dsa = key.sign_handshake(DATA)[: SIGNATURES.named(alternative).signature_size]
    key_of(alternative).public_key.verify_handshake(ml_dsa, DATA)
    refuses_handshake(key.public_key, ml_dsa)


@each_pair
@pytest.mark.parametrize("mallorys", ["plain", "alternative"])
def test_the_signature_of_a_pair_with_one_half_by_another_key_is_refused(
    plain, alternative, mallorys
):
    first = key_of(plain, "mallory" if mallorys == "plain" else "alice")
    second = key_of(alternative, "mallory" if mallorys == "alternative" else "alice")
    signature = pair_private(first, second).sign_handshake(DATA)
    refuses_handshake(pair_of(plain, alternative).public_key, signature)


@each_pair
def test_a_pair_takes_no_data_but_what_it_signed(plain, alternative):
    key = pair_of(plain, alternative)
    signature = key.sign_handshake(DATA)
    refuses_handshake(key.public_key, signature, DATA + b"\0")
    for at in (0, SIGNATURES.named(alternative).signature_size + 8, -1):
        refuses_handshake(key.public_key, flipped(signature, at))


def test_a_pair_has_no_encoding_of_its_own():
    row = pair_of("ecdsa-p256", "ml-dsa-65").algorithm
    for load in (row.load_raw_public, row.load_raw_private):
        with pytest.raises(ValueError, match="no encoding"):
            load(b"1234")
    assert not row.matches(pair_of("ecdsa-p256", "ml-dsa-65").public_key.handle)


# The table


@each_row
def test_a_row_is_found_by_name_and_alias_in_any_case(row):
    for name in (row.name, *row.aliases):
        assert SIGNATURES.named(name) is row
        assert SIGNATURES.named(f"id-{name.upper()}") is row


@each_row
def test_a_row_is_found_by_what_the_wire_calls_it(row):
    assert SIGNATURES.on_wire(row.wire_name).wire_name == row.wire_name


def test_an_unknown_name_is_refused_with_the_known_ones():
    with pytest.raises(
        UnknownAlgorithmError, match="no signature algorithm named 'rot13'"
    ) as caught:
        SIGNATURES.named("rot13")
    assert all(row.name in caught.value.hint for row in ROWS)


def test_an_unknown_wire_name_is_refused():
    with pytest.raises(UnknownAlgorithmError, match="on the wire"):
        SIGNATURES.on_wire("ecdsa-p256")


def test_a_table_refuses_two_rows_of_one_name():
    row = SIGNATURES.named("ml-dsa-65")
    with pytest.raises(AssertionError, match="share a name"):
        AlgorithmTable("signature algorithm", [row, SIGNATURES.named("ml-dsa-44"), row])


@pytest.mark.parametrize("digest", DIGESTS, ids=lambda digest: digest.name)
def test_a_digest_is_found_by_oid_and_has_its_length(digest: Digest):
    assert digest_of(digest.oid) is digest
    bits = {"shake_128": 256, "shake_256": 512}.get(digest.name) or int(digest.name[-3:])
    assert len(digest.of(DATA)) * 8 == bits
    assert digest.of(DATA) != digest.of(DATA + b"\0")


@pytest.mark.parametrize(
    ("oid", "words"),
    [
        ("1.3.14.3.2.26", "digest SHA-1 is no longer safe"),
        ("1.2.840.113549.2.5", "digest MD5 is no longer safe"),
        ("1.2.3", "digest 1.2.3 is not known here"),
    ],
)
def test_a_weak_or_unknown_digest_is_refused_by_name(oid, words):
    with pytest.raises(UnknownAlgorithmError, match=words):
        digest_of(oid)


@pytest.mark.parametrize("name", ["ecdsa-p256", "rsa-2048"])
@pytest.mark.parametrize(
    ("oid", "digest"),
    [("1.2.840.10045.4.1", "SHA-1"), ("1.2.840.113549.1.1.5", "SHA-1"),
     ("1.2.840.113549.1.1.4", "MD5")],
)  # fmt: skip
def test_a_signature_with_a_weak_digest_is_refused_by_its_name(name, oid, digest):
    key = SIGNATURES.named(name).generate()
    with pytest.raises(VerificationError, match=f"made with {digest}, which is no longer safe"):
        key.public_key.verify(key.sign(DATA), DATA, encode(algorithm(oid, null=True)))
