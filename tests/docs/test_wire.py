"""wire.md and wire-tables.md are what the code does: every table, and every formula with a name."""

import hmac
import re
from dataclasses import MISSING, fields
from hashlib import sha256
from types import SimpleNamespace

import pytest

from pqsec_pki.algorithms import KEY_AGREEMENTS, SIGNATURES, profile_named
from pqsec_pki.algorithms._agreement import Hybrid
from pqsec_pki.algorithms._composite import _PREFIX as COMPOSITE_PREFIX
from pqsec_pki.algorithms._composite import Composite
from pqsec_pki.algorithms._pair import SignaturePair
from pqsec_pki.attacks import ATTACKS
from pqsec_pki.certificates.certificate import MAX_CERTIFICATE
from pqsec_pki.handshake import (
    AuthRequest,
    ByteOrder,
    DataHolder,
    Final,
    GenericMessage,
    IdentityToken,
    Introduction,
    KeyMaterial,
    MessageClass,
    PermissionsToken,
    Reply,
    Request,
    Transcript,
    TransformationKind,
    adjusted_guid,
    compact,
    key_exchange_material,
    participant_data,
)
from pqsec_pki.handshake import _secured as secured
from pqsec_pki.handshake.key_exchange import CRYPTO_TOKEN, KEY_MATERIAL
from pqsec_pki.handshake.messages import _SIZES as SIZES
from pqsec_pki.handshake.protection import MAX_PAYLOAD, MAX_SUBMESSAGE
from pqsec_pki.handshake.wire import (
    MAX_PROPERTIES,
    MAX_SAMPLE,
    MAX_TOKEN,
    MAX_TOKENS,
    encode_properties,
)
from pqsec_pki.selfcheck.session import _STATELESS_WRITER as STATELESS_WRITER
from pqsec_pki.smime.document import MAX_CARRIED, MAX_CARRIED_VALUES
from tests.docs import wire_sizes
from tests.docs.tables import Document, missing, number
from tests.vectors.handshake import make_pq

WIRE = Document("reference/wire.md")
TABLES = Document("reference/wire-tables.md")
MEASURED = Document("reference/sizes.md")
PAPER = Document("explanation/paper.md")
CHECKS = Document("../tests/docs/checks.md")
MOST_RATIO = 1.12
"""The target for the second version."""
AFEW = 40
"""Octets by which a message varies: ECDSA signatures in it, in PEM, and serial numbers."""


def octets(of, size):
    """`size` octets that no other name has."""
    return sha256(of.encode()).digest()[:size]


def hex_in(text):
    return bytes.fromhex("".join(text.split()))


# Encoding


def test_the_example_of_a_property_list():
    example = [("c.id", bytes.fromhex("616263")), ("dh1", bytes.fromhex("0102"))]
    encoded = hex_in(WIRE.block("3.1 CDR"))
    assert encoded == encode_properties(example)
    assert f"The list of `c.id` = `616263` and `dh1` = `0102`, {len(encoded)} octets" in WIRE.text


def test_the_fields_of_a_message_stand_where_the_table_says():
    values = {
        "message_identity.source_guid": octets("source", 16),
        "message_identity.sequence_number": octets("sequence", 8),
        "related_message_identity.source_guid": octets("related", 16),
        "related_message_identity.sequence_number": octets("other", 8),
        "destination_participant_guid": octets("participant", 16),
        "destination_endpoint_guid": octets("endpoint", 16),
        "source_endpoint_guid": octets("here", 16),
        "message_class_id, a string": b"\0\0\0\x0ddds.sec.auth\0",
        "message_data, the count of tokens": b"\0\0\0\1",
    }
    token = DataHolder("token")
    source, sequence, related, other, participant, endpoint, here, *_ = values.values()
    message = GenericMessage(
        source=source,
        sequence=int.from_bytes(sequence, signed=True),
        related_source=related,
        related_sequence=int.from_bytes(other, signed=True),
        destination_participant=participant,
        destination_endpoint=endpoint,
        source_endpoint=here,
        class_id=MessageClass.HANDSHAKE,
        tokens=(token,),
    )
    encoded = message.encode(ByteOrder.BIG)[4:]
    *rows, tokens = WIRE.table("Offset", "Octets", "Field")
    found = {row["Field"]: int(row["Offset"]) for row in rows}
    assert {name: encoded[at : at + len(values[name])] for name, at in found.items()} == values
    assert all(number(row["Octets"]) == len(values[row["Field"]]) for row in rows)
    assert encoded[int(tokens["Offset"]) :] == token.encode()


@pytest.mark.parametrize("order", list(ByteOrder), ids=lambda order: order.name)
def test_the_encapsulation_header(order):
    message = GenericMessage(
        source=bytes(16), sequence=1, destination_participant=bytes(16), class_id="", tokens=()
    )
    word = {ByteOrder.BIG: "big-endian", ByteOrder.LITTLE: "little-endian"}[order]
    text = WIRE.section("3.2 ParticipantGenericMessage")
    (header,) = re.findall(rf"`([0-9a-f]{{8}})` {word}", text)
    assert message.encode(order)[:4].hex() == header


def test_message_classes_and_who_carries_them():
    rows = WIRE.table("message_class_id")
    assert [row["message_class_id"] for row in rows] == [each.value for each in MessageClass]
    pairs = [row["Writer, reader"].split(", ") for row in rows]
    stateless, secure = pairs[0], pairs[-1]
    assert pairs == [stateless] * 2 + [secure] * 3
    assert stateless[0] == STATELESS_WRITER.hex()
    assert hex_in(secure[1] + secure[0]) in make_pq.SUBMESSAGE  # reader, then writer


# Discovery and messages


def test_the_parts_of_a_guid():
    high, low, entity = (row["Octets"] for row in WIRE.table("Octets", "Content"))
    assert (high, low, entity) == ("0 to 5", "6 to 11", "12 to 15")
    candidate = octets("candidate", 12) + bytes.fromhex("000001c1")
    guid = adjusted_guid(b"subject", candidate)
    bits = f"1{int.from_bytes(sha256(b'subject').digest()):0256b}"[:48]
    assert guid[:6] == int(bits, 2).to_bytes(6)
    assert guid[6:12] == sha256(candidate).digest()[:6]
    assert guid[12:] == candidate[12:]


def test_tokens_of_discovery():
    rows = WIRE.table("Token", "Class id", "Properties, in order")
    for row, token in zip(rows, (IdentityToken, PermissionsToken), strict=True):
        names = tuple(row["Properties, in order"].split(", "))
        assert (row["Token"], row["Class id"], names) == (
            token.__name__,
            token.CLASS_ID,
            token.NAMES,
        )


def names_of(message):
    """Its binary properties as the table writes them: the optional ones in parentheses."""
    found = []
    for field in fields(message):
        if field.name == "introduction":
            found += Introduction.NAMES
        else:
            found.append(field.name if field.default is MISSING else f"({field.name})")
    return found


@pytest.mark.parametrize("message", [Request, Reply, Final])
def test_the_binary_properties_of_the_second_version(message):
    rows = WIRE.table("Message", "Class id", "Binary properties, in order")
    (row,) = (each for each in rows if message.__name__ in each.values())
    names = row["In the second version"].split(", ")
    assert tuple(names) == compact.names(message.CLASS_ID)


def test_the_dictionary_and_the_mark_of_the_second_version():
    text = WIRE.section("5.1 The second version")
    (dictionary,) = re.findall(r"(?s)```xml\n(.*?)```", TABLES.text)
    assert dictionary.encode() == compact.CREDENTIALS_DICTIONARY
    marks = re.findall("`(ver)`(?: is|:| =) `([0-9]+)`", text)
    assert [(name, bytes.fromhex(value)) for name, value in marks] == [
        *compact.WireVersion.SECOND.mark,
        *compact.WireVersion.SECOND.mark,
    ]
    assert compact.WireVersion.FIRST.mark == ()


@pytest.mark.parametrize("message", [Request, Reply, Final, AuthRequest])
def test_the_binary_properties_of_a_message(message):
    rows = [
        *WIRE.table("Message", "Class id", "Binary properties, in order"),
        *WIRE.table("Token", "Class id", "Binary properties"),
    ]
    (row,) = (each for each in rows if message.__name__ in each.values())
    assert row["Class id"] == message.CLASS_ID
    names = row.get("Binary properties, in order") or row["Binary properties"]
    assert names.split(", ") == names_of(message)


def test_the_sizes_of_binary_properties():
    found = {
        name: row["Octets"]
        for row in WIRE.table("Binary property", "Octets")
        for name in row["Binary property"].split(", ")
    }
    fixed = {name: int(size) for name, size in found.items() if size.isdigit()}
    assert fixed == {name: size for name, size in SIZES.items() if name != "future_challenge"}
    known = {name.strip("()") for each in (Request, Reply, Final) for name in names_of(each)}
    assert set(found) == known
    assert number(found["c.pdata"]) == len(participant_data(bytes(16)))


def test_the_least_participant_data():
    before, after = re.split(r"<.*>", WIRE.block("5. Messages"))
    guid = octets("guid", 16)
    assert hex_in(before) + guid + hex_in(after) == participant_data(guid)


# Algorithms

SINGLE = [row for row in SIGNATURES if not isinstance(row, Composite)]
COMPOSITES = [row for row in SIGNATURES if isinstance(row, Composite)]


def signature_rows():
    return TABLES.table("Key", "c.dsign_algo", "*.algo")


def test_names_and_sizes_of_signatures():
    found = [
        (row["c.dsign_algo"], row["*.algo"], number(row["Signature, octets"]))
        for row in signature_rows()
    ]
    assert found == [(row.wire_name, row.token_name, row.signature_size) for row in SINGLE]


def named():
    """The rows of signatures by the words of the table's first column."""
    return {row["Key"]: each for row, each in zip(signature_rows(), SINGLE, strict=True)}


def test_keys_are_called_what_they_are():
    for key, row in named().items():
        assert re.sub("[ -]", "", key).lower() == row.name.replace("-", "")


def test_composites():
    keys = named()
    found = TABLES.table("c.dsign_algo", "OID")
    assert len(found) == len(COMPOSITES)
    for row, composite in zip(found, COMPOSITES, strict=True):
        assert row["c.dsign_algo"] == composite.wire_name == composite.token_name
        assert row["OID"] == composite.key_oid
        assert row["Prehash"].lower() == composite.digest.name.replace("_", "")
        assert keys[row["ML-DSA"]] is composite.ml_dsa
        other = keys.get(row["Other"])
        assert (other.name if other else row["Other"].lower()) == composite.traditional.name
        assert number(row["Signature, octets"]) == composite.signature_size


def test_the_labels_of_a_composite():
    label, prefix = re.findall('"(.*?)"', WIRE.block("7.2 Composite"))
    assert prefix.encode() == COMPOSITE_PREFIX
    for row in COMPOSITES:
        name = re.sub("brainpoolP(256|384)r1", r"BP\1", row.wire_name)
        assert row.label == label.encode() + name.encode()


def test_pairs():
    keys = named()
    for row in TABLES.table("Plain key", "Alternative key"):
        alternative = keys[row["Alternative key"]]
        pair = SignaturePair.of(keys[row["Plain key"]], alternative)
        assert row["c.dsign_algo"] == pair.wire_name
        assert number(row["Alternative's, octets"]) == alternative.signature_size
        assert number(row["Whole signature, octets"]) == pair.signature_size


def agreement_rows():
    found = TABLES.table("c.kagree_algo", "dh1")
    assert [row["c.kagree_algo"] for row in found] == [row.wire_name for row in KEY_AGREEMENTS]
    return list(zip(found, KEY_AGREEMENTS, strict=True))


def test_names_and_sizes_of_key_agreements():
    for row, agreement in agreement_rows():
        assert number(row["Octets"]) == agreement.public_size
        assert number(row["Octets 1"]) == agreement.ciphertext_size
        assert number(row["Octets 2"]) == agreement.secret_size


def test_what_key_agreements_send_and_the_order_of_the_halves_of_a_hybrid():
    words = {
        "ecdh-p256": ("P-256",) * 3,
        "ecdh-p384": ("P-384",) * 3,
        "dh-modp-2048-256": ("number",) * 3,
        "x25519": ("X25519",) * 3,
        "mlkem768": ("ML-KEM-768 key", "ciphertext", "ML-KEM"),
        "mlkem1024": ("ML-KEM-1024 key", "ciphertext", "ML-KEM"),
    }
    for row, agreement in agreement_rows():
        is_hybrid = isinstance(agreement, Hybrid)
        parts = (agreement.first, agreement.second) if is_hybrid else (agreement,)
        due = [" ‖ ".join(each) for each in zip(*(words[part.name] for part in parts), strict=True)]
        assert [row[name] for name in ("dh1", "dh2", "Secret")] == due


def test_how_the_shared_secret_is_computed():
    formulas = dict(re.findall(r"(\w+): +SharedSecret = (.*)", WIRE.block("8.3 SharedSecret")))
    due = {
        "plain": ("SHA256(secret)", sha256(b"secret")),
        "bound": (
            "SHA256(secret ‖ SHA256(octets signed by the Reply))",
            sha256(b"secret" + sha256(b"signed").digest()),
        ),
    }
    assert formulas == {name: formula for name, (formula, _) in due.items()}
    for row, agreement in agreement_rows():
        expected = due[row["SharedSecret"]][1].digest()
        assert agreement.shared_secret(b"secret", b"signed") == expected


def test_what_is_hashed_and_signed():
    covered = re.search(r"property list of the Request's (.*)\)", WIRE.block("8.1 Hashes"))[1]
    assert tuple(covered.split(", ")) == Introduction.NAMES
    names = ("hash_c1", "hash_c2", "challenge1", "challenge2", "dh1", "dh2")
    transcript = Transcript(**{name: octets(name, 32) for name in names})
    signed = re.findall("= property list of (.*)", WIRE.block("8.2 What is signed"))
    for text, made in zip(
        signed, (transcript.reply_octets(), transcript.final_octets()), strict=True
    ):
        assert made == encode_properties((name, octets(name, 32)) for name in text.split(", "))


# What follows


def test_the_key_of_the_key_exchange():
    done = SimpleNamespace(
        challenge1=octets("one", 32), challenge2=octets("two", 32), shared_secret=octets("z", 32)
    )

    def derived(line):
        first, label, second = re.search(r'SHA256\((\w+) ‖ "(.*)" ‖ (\w+)\)', line).groups()
        assert len(label) == 16
        key = getattr(done, first) + label.encode() + getattr(done, second)
        return hmac.digest(sha256(key).digest(), done.shared_secret, "sha256")

    salt, key = WIRE.block("12.1 The key of the key exchange (Kx)").splitlines()
    material = key_exchange_material(done)
    assert (material.salt, material.sender_key) == (derived(salt), derived(key))
    assert (material.kind, material.sender_key_id.hex()) == (4, "00000000")
    assert "kind 4, sender key id `00000000`" in WIRE.text


@pytest.mark.parametrize("kind", list(TransformationKind)[1:], ids=lambda kind: kind.name)
def test_session_keys(kind):
    material = KeyMaterial.generate(kind).for_receiver()
    session = octets("session", 4)
    plain, receiver = re.findall('"(.*?)"', WIRE.block("12.3 Session keys"))
    for key, label, made in (
        (material.sender_key, plain, material.session_key(session)),
        (material.receiver_key, receiver, material.session_receiver_key(session)),
    ):
        full = hmac.digest(key, label.encode() + material.salt + session, "sha256")
        assert made == full[: kind.key_size]


def test_kinds_of_protection_and_the_sizes_of_their_keys():
    rows = TABLES.table("Kind", "Name")
    for row, kind in zip(rows, TransformationKind, strict=True):
        assert (int(row["Kind"]), row["Name"]) == (kind.value, kind.name)
        assert number(row["Key and salt, octets"]) == kind.key_size
        content = "as it is" if not kind else "encrypted" if kind.encrypts else "signed"
        assert row["Content"] == content
        material = KeyMaterial.generate(kind)
        sizes = [len(material.encode())]
        if kind:
            sizes.append(len(material.for_receiver().encode()))
        found = (row["Key material, octets"], row["With receiver key"])
        assert [int(cell) for cell in found if cell] == sizes


def test_a_crypto_token_field_by_field():
    material = KeyMaterial.generate(TransformationKind.AES256_GCM).for_receiver()
    values = (
        bytes([0, 0, 0, material.kind]),
        material.salt,
        material.sender_key_id,
        material.sender_key,
        material.receiver_key_id,
        material.receiver_key,
    )
    encoded = b""
    for row, value in zip(WIRE.table("Field", "Type"), values, strict=True):
        is_sequence = {"u32": False, "octets": False, "octet sequence": True}[row["Type"]]
        size = material.kind.key_size if is_sequence else number(row["Octets of its content"])
        assert len(value) == size
        encoded += size.to_bytes(4) * is_sequence + value
    assert material.to_holder() == DataHolder(CRYPTO_TOKEN, (), ((KEY_MATERIAL, encoded),))
    assert f"Class id `{CRYPTO_TOKEN}`, one binary property `{KEY_MATERIAL}`" in WIRE.text


def test_crypto_header_and_footer():
    header, footer = (row["Content, with octets"] for row in WIRE.table("Structure"))
    sizes = [int(size) for size in re.findall(r"\(([0-9]+)\)", header)]
    assert sizes == [4, secured.KEY_ID_SIZE, secured.SESSION_ID_SIZE, secured.SUFFIX_SIZE]
    assert sum(sizes) == secured.HEADER_SIZE
    tag, count, *each = (int(size) for size in re.findall(r"\(([0-9]+)\)", footer))
    receivers = tuple(secured.ReceiverTag(bytes(4), bytes(16)) for _ in range(3))
    encoded = secured.CryptoFooter(bytes(secured.TAG_SIZE), receivers).encode()
    assert len(encoded) == tag + count + 3 * sum(each)


def test_the_submessages_around():
    found = {row["Submessage"]: int(row["Kind"], 16) for row in TABLES.table("Submessage")}
    assert found == {f"SEC_{each.name}": each.value for each in secured.Secure}


def test_limits():
    due = {
        "a token": MAX_TOKEN,
        "a sample": MAX_SAMPLE,
        "a certificate": MAX_CERTIFICATE,
        "id of the second version, inflated": compact.MAX_CREDENTIALS,
        "the CMS structure in id": MAX_CARRIED,
        "ASN.1 values in that structure": MAX_CARRIED_VALUES,
        "properties in one list": MAX_PROPERTIES,
        "tokens in one message": MAX_TOKENS,
        "a submessage to be protected": MAX_SUBMESSAGE,
        "a payload to be protected": MAX_PAYLOAD,
        "receivers of one submessage": secured.MAX_RECEIVERS,
    }
    assert {row["Limit"]: int(row["Value"]) for row in TABLES.table("Limit")} == due


def test_sizes_are_those_that_are_measured(now):
    measured = wire_sizes.measured_suites(now)
    for row in MEASURED.table("Profile", "c.dsign_algo"):
        profile, signature, agreement, *sizes, fragments, share = row.values()
        sizes = [int(size) for size in sizes]
        assert measured[profile, signature, agreement] == pytest.approx(sizes, abs=AFEW)
        assert (fragments, share) == wire_sizes.fragments(sizes)


def test_sizes_of_the_second_version_and_their_ratio(now, tmp_path):
    firsts = {
        (row["Profile"], row["c.kagree_algo"]): row
        for row in MEASURED.table("Profile", "c.dsign_algo")
    }
    rows = MEASURED.table("Profile", "Request 2")
    assert [row["Profile"] for row in rows] == ["transition", "hybrid", "pq", "cnsa2"]
    for row in rows:
        profile = profile_named(row["Profile"])
        sizes = [int(row[name]) for name in ("Request 2", "Reply 2", "Final 2")]
        measured = wire_sizes.second_version(now, tmp_path, profile)
        assert measured == pytest.approx(sizes, abs=2 * AFEW)
        least = wire_sizes.irreducible(profile)
        assert all(size <= MOST_RATIO * due for size, due in zip(measured, least, strict=True))
        assert [row[name] for name in ("Ratio", "Ratio 1", "Ratio 2")] == wire_sizes.ratios(
            profile, sizes
        )
        first = firsts[profile.name, profile.key_agreement.wire_name]
        before = [int(first[name]) for name in ("Request", "Reply", "Final")]
        assert row["Small fragments, before"] == wire_sizes.small_fragments(before)
        assert row["After"] == wire_sizes.small_fragments(sizes)


def test_sizes_of_several_sets_between_stock_stacks_are_those_of_classical(now, tmp_path):
    rows = MEASURED.table("Sets")
    assert [row["Sets"] for row in rows] == [*wire_sizes.SETS]
    classical = [int(rows[0][name]) for name in ("Request between stock stacks", "Reply", "Final")]
    for row in rows:
        first, *further = wire_sizes.sizes_of_sets(now, tmp_path / row["Sets"], row["Sets"])
        names, *written = row.values()
        assert names
        assert [int(each) for each in written if each] == pytest.approx(
            [size for each in (first, *further) for size in each], abs=2 * AFEW
        )
        assert all(size <= 1.02 * due for size, due in zip(first, classical, strict=True))


# The text


def test_every_check_has_a_test_and_every_attack_it_names_is_one():
    checks = [row["No."] for row in WIRE.table("No.", "Of")]
    assert checks == [f"C{at}" for at in range(1, len(checks) + 1)]
    rules = [row["No."] for row in WIRE.table("No.", "Rule")]
    assert rules == [f"S{at}" for at in range(1, len(rules) + 1)]
    held = CHECKS.table("No.", "Attack")
    assert list(dict.fromkeys(row["No."] for row in held)) == checks
    assert {row["Attack"] for row in held} <= {attack.name for attack in ATTACKS} | {""}
    assert missing([row["Test"] for row in held]) == []


def test_every_point_of_the_paper_names_its_tests():
    points = re.findall(r"(?ms)^## ([0-9])\. (.*?)\n(.*?)(?=^## |\Z)", PAPER.text)
    assert [number for number, *_ in points] == [str(at) for at in range(1, len(points) + 1)]
    for *_, text in points:
        assert re.findall(r"(?m)^\*(\w.*?)\.\*", text) == ["Found", "Consequence", "pqsec"]
    shown = {row["Point"] for row in CHECKS.table("Point", "Shown by")}
    assert shown == {number for number, *_ in points} | {"9"}


def test_the_tests_that_are_named_are_there():
    assert CHECKS.tests
    assert missing(CHECKS.tests) == []


def test_checks_and_sections_that_are_referred_to_are_there():
    checks = {row["No."] for row in [*WIRE.table("No.", "Of"), *WIRE.table("No.", "Rule")]}
    assert set(re.findall(r"\b[CS][0-9]+\b", WIRE.text + PAPER.text)) <= checks
    titles = set(re.findall(r"(?m)^#+ ([0-9.]+?)\.? ", WIRE.text))
    assert set(re.findall(r"[Ss]ections? ([0-9]+(?:\.[0-9]+)?)", WIRE.text)) <= titles
    assert set(re.findall(r"wire\.md, ([0-9.]+[0-9])", PAPER.text)) <= titles


def test_words_of_rfc_2119_stand_in_normative_sections_only():
    before, normative = WIRE.text.split("\n## 3. ")
    after = normative.partition("\n## 14. ")[2]
    assert "Sections 3 to 13 are normative; MUST, SHOULD and MAY are those of RFC 2119" in before
    assert re.findall(r"\b(?:MUST|SHOULD|MAY)\b", before + after) == ["MUST", "SHOULD", "MAY"]
