"""pqsec verify: who signed a document, and what must not be missing."""

import shutil
from base64 import b64decode, encodebytes
from datetime import UTC, datetime, timedelta

import pytest

from pqsec_pki.algorithms import load_private_key, profile_named
from pqsec_pki.certificates import Certificate
from pqsec_pki.documents import DomainSet
from pqsec_pki.keystore import Keystore
from tests.cli.conftest import NAMES
from tests.interop.der import Der
from tests.unit.version_1 import in_version_1

GOVERNANCE = "k/enclaves/governance.p7s"
PERMISSIONS_CA = "k/public/permissions_ca.cert.pem"
FAMILIES = {
    "transition": {"classical", "pq"},
    "hybrid": {"hybrid"},
    "pq": {"pq"},
    "cnsa2": {"pq"},
    "classical": {"classical"},
}
MET = {
    "transition": {"classical", "pq", "both"},
    "hybrid": {"classical", "pq", "both"},
    "pq": {"pq"},
    "cnsa2": {"pq"},
    "classical": {"classical"},
}
PROMISED = {
    "transition": "both",
    "hybrid": "both",
    "pq": "pq",
    "cnsa2": "pq",
    "classical": "classical",
}
NO_PQ = "there is no post-quantum signature that could be checked, and one is required"
NO_CLASSICAL = "there is no classical signature, and one is required"
MARKER = b'filename="smime.p7s"\n\n'
NOT_SIGNED_BY = "not signed by CN=Permissions CA but by another certificate"


def stripped(message: bytes) -> bytes:
    """`message` without its unsigned attributes, as anyone on the way can make it."""
    return with_another_signer(message, [part for part in signer(message) if part.tag != 0xA1])


def with_another_signature(message: bytes) -> bytes:
    """`message` with one bit of its signature changed, and nothing else."""
    parts = signer(message)
    [at] = [number for number, part in enumerate(parts) if part.tag == 0x04]
    signature = bytearray(parts[at].content)
    signature[20] ^= 1  # in ECDSA's r, and in ML-DSA's first part
    return with_another_signer(message, [*parts[:at], Der.of(0x04, signature), *parts[at + 1 :]])


def with_another_countersignature(message: bytes) -> bytes:
    """`message` with one bit of its countersignature changed, which stands last."""
    *parts, unsigned = signer(message)
    assert unsigned.tag == 0xA1
    octets = bytearray(unsigned.content)
    octets[-1] ^= 1  # ML-DSA counts the hints there
    return with_another_signer(message, [*parts, Der.of(0xA1, octets)])


def signer(message: bytes) -> list[Der]:
    """The parts of the SignerInfo of `message`."""
    [found] = cms(message).parts[1].parts[0].parts[-1].parts
    return found.parts


def with_another_signer(message: bytes, parts: list[Der]) -> bytes:
    """`message` with a SignerInfo of those parts."""
    oid, explicit = cms(message).parts
    *signed_data, _ = explicit.parts[0].parts
    signers = Der.of(0x31, Der.of(0x30, b"".join(parts)))
    data = Der.of(0x30, b"".join([*signed_data, signers]))
    head, _, tail = message.rpartition(MARKER)
    _, end, rest = tail.partition(b"\n\n--")
    der = Der.of(0x30, oid + Der.of(0xA0, data))
    return head + MARKER + encodebytes(der).rstrip() + end + rest


def cms(message: bytes) -> Der:
    """The ContentInfo of `message`."""
    text, _, _ = message.rpartition(MARKER)[2].partition(b"\n\n--")
    return Der(b64decode(text))


@pytest.fixture
def strip(tmp_path):
    """strip(file) takes the countersignature off a signed file of the test."""

    def in_place(file):
        (tmp_path / file).write_bytes(stripped((tmp_path / file).read_bytes()))

    return in_place


# The right CA, and what was found


@pytest.mark.parametrize("profile", NAMES)
def test_the_ca_is_the_keystores_or_the_one_named(pqsec, keystore, profile):
    keystore(profile)
    named = pqsec(f"verify {GOVERNANCE} --ca {PERMISSIONS_CA}").done()
    assert pqsec(f"-k k verify {GOVERNANCE}").done().out == named.out
    assert named.out.startswith(f"{GOVERNANCE}: signed by CN=Permissions CA\n  good signature: ")


@pytest.mark.parametrize("profile", NAMES)
@pytest.mark.parametrize("file", [GOVERNANCE, "k/enclaves/talker/permissions.p7s"])
def test_json_tells_the_signatures_that_hold(pqsec, keystore, profile, file):
    keystore(profile)
    said = pqsec(f"--json -k k verify {file}").done().json
    wanted = {"ok", "file", "kind", "signer", "signatures", "countersigned", "unchecked"}
    assert set(said) == wanted
    assert said["kind"] == file.rpartition("/")[2].removesuffix(".p7s")
    assert said["countersigned"] is (profile == "transition")
    assert said["ok"] is True
    assert said["unchecked"] == 0
    assert {each["family"] for each in said["signatures"]} == FAMILIES[profile]
    for each in said["signatures"]:
        age = datetime.now(UTC) - datetime.fromisoformat(each["signed_at"])
        assert timedelta() <= age < timedelta(hours=1)  # it was made once for all tests


def test_a_person_is_told_the_countersignature(pqsec, keystore):
    keystore("transition")
    lines = pqsec(f"-k k verify {GOVERNANCE}").done().out.splitlines()
    assert lines[1].startswith("  good signature: ecdsa-p256 (classical), ")
    assert lines[2].startswith("  good countersignature: ml-dsa-65 (pq), ")


def test_the_countersigner_is_found_beside_the_ca_or_named(pqsec, keystore, tmp_path):
    k = keystore("transition")
    shutil.copy(k / "public/permissions_ca.cert.pem", tmp_path / "ca.pem")
    shutil.copy(k / "public/permissions_ca.alt.cert.pem", tmp_path / "second.pem")
    alone = pqsec(f"verify {GOVERNANCE} --ca ca.pem --json").done()
    assert alone.json["unchecked"] == 1
    assert "pqsec: note: a countersignature was not checked" in alone.err
    pqsec(f"verify {GOVERNANCE} --ca ca.pem --require both").refused(1, NO_PQ)
    line = f"verify {GOVERNANCE} --ca ca.pem --alt-ca second.pem --require both --json"
    assert pqsec(line).done().json["unchecked"] == 0
    beside = f"verify {GOVERNANCE} --ca k/enclaves/talker/permissions_ca.cert.pem --require both"
    assert pqsec(beside).done().err == ""


# What is required


@pytest.mark.parametrize("require", ["classical", "pq", "both"])
@pytest.mark.parametrize("profile", NAMES)
def test_what_is_required_is_there_or_the_file_is_refused(pqsec, keystore, profile, require):
    keystore(profile)
    said = pqsec(f"-k k verify {GOVERNANCE} --require {require}")
    if require in MET[profile]:
        said.done()
    else:
        said.refused(1, GOVERNANCE, NO_PQ if profile == "classical" else NO_CLASSICAL)


def test_an_unknown_requirement_is_a_usage_error(pqsec, keystore):
    keystore()
    pqsec(f"-k k verify {GOVERNANCE} --require quantum").refused(2, "--require")


@pytest.mark.parametrize("require", ["", "--require pq", "--require both"])
def test_a_stripped_countersignature_is_refused_where_it_is_required(
    pqsec, keystore, strip, require
):
    keystore("transition")
    strip(GOVERNANCE)
    said = pqsec(f"-k k verify {GOVERNANCE} {require}").refused(1)
    assert said.errors == [f"{GOVERNANCE}: {NO_PQ}"]


@pytest.mark.parametrize("made", NAMES)
@pytest.mark.parametrize("profile", NAMES)
def test_the_keystores_cas_say_what_is_required_if_nobody_else_does(pqsec, keystore, profile, made):
    """As on a robot, which has no settings of a keystore; these are of another profile."""
    k, other = keystore(made), keystore(profile, "other")
    shutil.copy(other / "pqsec.json", k / "pqsec.json")
    said = pqsec(f"-k k verify {GOVERNANCE}")
    assert said.done().err == ""
    explicit = pqsec(f"-k k verify {GOVERNANCE} --require {PROMISED[made]}")
    assert (explicit.code, explicit.out, explicit.err) == (said.code, said.out, said.err)
    for lenient in ("-k k --require any", f"-k k --ca {PERMISSIONS_CA}", f"--ca {PERMISSIONS_CA}"):
        pqsec(f"verify {GOVERNANCE} {lenient}").done()


@pytest.mark.parametrize(
    "options",
    [
        "-k k --require any",
        "-k k --require classical",
        f"--ca {PERMISSIONS_CA}",
        f"-k k --ca {PERMISSIONS_CA}",
        f"-k k --ca {PERMISSIONS_CA} --require any",
    ],
)
def test_a_stripped_countersignature_is_noted_where_it_is_not(pqsec, keystore, strip, options):
    keystore("transition")
    strip(GOVERNANCE)
    said = pqsec(f"verify {GOVERNANCE} {options}").done()
    assert "pqsec: note: there is no countersignature: " in said.err
    assert "countersignature" not in said.out


def test_naming_the_countersigner_is_asking_for_its_signature(pqsec, keystore, strip):
    keystore("transition")
    line = f"verify {GOVERNANCE} --ca {PERMISSIONS_CA}"
    second = "--alt-ca k/public/permissions_ca.alt.cert.pem"
    assert pqsec(f"{line} {second} --json").done().json["countersigned"] is True
    strip(GOVERNANCE)
    pqsec(f"{line} {second}").refused(1, NO_PQ)
    assert pqsec(f"{line} {second} --require any --json").done().json["countersigned"] is False


# A no


@pytest.mark.parametrize(
    ("options", "problems"),
    [
        ("-k k --require classical", [NO_CLASSICAL]),
        ("-k other", [NOT_SIGNED_BY]),
        ("-k other --require classical", [NOT_SIGNED_BY, NO_CLASSICAL]),
    ],
)
def test_json_tells_what_is_wrong(pqsec, keystore, options, problems):
    keystore("pq")
    keystore("pq", "other", "another")
    said = pqsec(f"verify {GOVERNANCE} {options} --json")
    assert said.code == 1
    assert said.json == {"ok": False, "file": GOVERNANCE, "problems": problems}
    assert said.errors == [f"{GOVERNANCE}: {problem}" for problem in problems]
    told = pqsec(f"verify {GOVERNANCE} {options}").refused(1, problems=len(problems))
    assert told.errors == said.errors


# Another CA


@pytest.mark.parametrize("profile", NAMES)
def test_another_ca_of_the_same_name_did_not_sign_it(pqsec, keystore, profile):
    keystore(profile)
    keystore(profile, "other", "another")
    said = pqsec(f"-k other verify {GOVERNANCE}").refused(1, problems=1 + (profile == "transition"))
    first, *rest = said.errors
    assert first == f"{GOVERNANCE}: not signed by CN=Permissions CA but by another certificate"
    assert rest == ([f"{GOVERNANCE}: {NO_PQ}"] if profile == "transition" else [])


@pytest.mark.parametrize("profile", NAMES)
def test_the_identity_ca_did_not_sign_it(pqsec, keystore, profile):
    keystore(profile)
    said = pqsec(f"verify {GOVERNANCE} --ca k/public/identity_ca.cert.pem")
    said.refused(1, "not signed by CN=Identity CA but by another certificate")


def test_a_participant_is_no_permissions_ca(pqsec, keystore):
    keystore()
    said = pqsec(f"verify {GOVERNANCE} --ca k/enclaves/talker/cert.pem")
    said.refused(1, "is not marked as a CA", problems=3)


def test_a_ca_of_version_1_is_trusted_because_it_is_named(pqsec, keystore, tmp_path):
    k = keystore()
    old = in_version_1(
        Certificate.from_pem((k / "public/permissions_ca.cert.pem").read_bytes()),
        load_private_key((k / "private/permissions_ca.key.pem").read_bytes()),
    )
    (tmp_path / "old.pem").write_bytes(old.pem)
    said = pqsec(f"verify {GOVERNANCE} --ca old.pem").done()
    assert said.out.startswith(f"{GOVERNANCE}: signed by CN=Permissions CA\n")
    assert said.err == (
        "pqsec: note: old.pem is a version 1 certificate, which does not state whether it is"
        " a CA: it is trusted because you named it\n"
    )


def test_a_countersignature_by_another_does_not_count(pqsec, keystore):
    keystore("transition")
    keystore("transition", "other", "another")
    other = "--alt-ca other/public/permissions_ca.alt.cert.pem"
    said = pqsec(f"-k k verify {GOVERNANCE} --require both {other}")
    said.refused(1, NO_PQ)


@pytest.mark.parametrize(
    ("days", "words"), [(-60, "the CA certificate expired on"), (60, "is not valid before")]
)
def test_a_ca_out_of_its_time_is_refused(pqsec, tmp_path, days, words):
    Keystore.create(
        tmp_path / "k",
        profile_named("classical"),
        name="",
        domains=DomainSet.of(0),
        validity=timedelta(days=30),
        passphrase=None,
        now=datetime.now(UTC) + timedelta(days=days),
    )
    pqsec(f"-k k verify {GOVERNANCE}").refused(1, "permissions_ca.cert.pem", words)
    said = pqsec(f"-k k --json verify {GOVERNANCE}").json
    assert said["ok"] is False
    assert words in said["problems"][0]


# Changed on the way


@pytest.mark.parametrize("profile", NAMES)
def test_a_changed_text_is_refused(pqsec, keystore, tmp_path, profile):
    keystore(profile)
    signed = (tmp_path / GOVERNANCE).read_bytes()
    (tmp_path / GOVERNANCE).write_bytes(signed.replace(b">false<", b">true<", 1))
    said = pqsec(f"-k k verify {GOVERNANCE}")
    said.refused(1, GOVERNANCE, "the content was changed after signing")


@pytest.mark.parametrize("profile", NAMES)
def test_a_changed_signature_is_refused(pqsec, keystore, tmp_path, profile):
    keystore(profile)
    signed = (tmp_path / GOVERNANCE).read_bytes()
    if profile == "transition":
        signed = stripped(signed)
    (tmp_path / GOVERNANCE).write_bytes(with_another_signature(signed))
    said = pqsec(f"-k k verify {GOVERNANCE} --require any")
    said.refused(1, GOVERNANCE, "signature")
    pqsec(f"-k k verify {GOVERNANCE}").refused(1, problems=1 + (profile == "transition"))


def test_a_changed_countersignature_is_refused_even_where_it_is_not_required(
    pqsec, keystore, tmp_path
):
    keystore("transition")
    signed = (tmp_path / GOVERNANCE).read_bytes()
    (tmp_path / GOVERNANCE).write_bytes(with_another_countersignature(signed))
    words = f"{GOVERNANCE}: the countersignature: "
    for require in ("any", "classical"):
        pqsec(f"-k k verify {GOVERNANCE} --require {require}").refused(1, words)
    said = pqsec(f"-k k verify {GOVERNANCE}").refused(1, words, problems=2)
    assert said.errors[1] == f"{GOVERNANCE}: {NO_PQ}"


def test_signatures_are_not_taken_over_from_another_document(pqsec, keystore, tmp_path):
    keystore()
    text, signature = (
        (tmp_path / file).read_bytes().split(b"Content-Type: application/x-pkcs7-signature")
        for file in (GOVERNANCE, "k/enclaves/talker/permissions.p7s")
    )
    boundary, own = text[0].rpartition(b"--")[2], signature[0].rpartition(b"--")[2]
    tail = signature[1].replace(own.strip(), boundary.strip())
    mixed = text[0] + b"Content-Type: application/x-pkcs7-signature" + tail
    (tmp_path / "mixed.p7s").write_bytes(mixed)
    pqsec("-k k verify mixed.p7s").refused(1, "the content was changed after signing")


SIGNED = b'Content-Type: multipart/signed; boundary="x"\n\n'
PARTS = SIGNED + b"--x\nContent-Type: text/plain\n\nhi\n--x\nContent-Type: x/y\n\n%b\n--x--\n"
NOT_SIGNED = {
    "empty": b"",
    "binary": b"\0\xff" * 999,
    "XML": b"<dds/>",
    "no parts": SIGNED,
    "no base64": PARTS % b"!!!!",
    "empty CMS": PARTS % b"MAA=",
    "no CMS": PARTS % b"aGVsbG8=",
}


@pytest.mark.parametrize("content", NOT_SIGNED.values(), ids=NOT_SIGNED)
def test_what_is_no_signed_file_is_refused_by_name(pqsec, keystore, tmp_path, content):
    keystore()
    (tmp_path / "file").write_bytes(content)
    pqsec("-k k verify file").refused(1, "file: ")


def test_an_empty_file_is_told_as_empty(pqsec, keystore, tmp_path):
    keystore()
    (tmp_path / "file").touch()
    said = pqsec("-k k verify file").refused(1, "file: the file is empty")
    assert "S/MIME" not in said.err


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.99])
def test_a_file_that_was_cut_is_refused(pqsec, keystore, tmp_path, share):
    keystore("transition")
    signed = (tmp_path / GOVERNANCE).read_bytes()
    (tmp_path / "cut.p7s").write_bytes(signed[: int(len(signed) * share)])
    pqsec("-k k verify cut.p7s").refused(1, "cut.p7s: ")


# Files that cannot be used


def test_files_that_cannot_be_read_are_errors_and_not_a_no(pqsec, keystore, tmp_path):
    keystore()
    said = pqsec("-k k verify nowhere.p7s").refused(3, "no such file")
    assert said.err.count("nowhere.p7s") == 1
    pqsec("-k k verify k").refused(2, "is a directory")
    (tmp_path / "huge.p7s").write_bytes(b"x" * (9 << 20))
    pqsec("-k k verify huge.p7s").refused(3, "huge.p7s: larger than")
    pqsec(f"verify {GOVERNANCE}").refused(2, "no keystore named", hint="certificate: --ca FILE")
    pqsec("-k k verify").refused(2, "FILE")


@pytest.mark.parametrize("option", ["--ca", "--alt-ca"])
@pytest.mark.parametrize(
    "content",
    [None, b"", b"\xff" * 99, b"-----BEGIN CERTIFICATE-----\nMAA=\n"],
    ids=["missing", "empty", "binary", "cut"],
)
def test_a_ca_that_is_no_certificate_is_named(pqsec, keystore, tmp_path, option, content):
    keystore()
    if content is not None:
        (tmp_path / "ca.pem").write_bytes(content)
    pqsec(f"-k k verify {GOVERNANCE} {option} ca.pem").refused(3, "ca.pem: ")


def test_a_ca_whose_name_leaves_no_room_for_a_second_is_alone(pqsec, keystore, tmp_path):
    name = f"{'x' * 246}.cert.pem"
    shutil.copy(keystore() / "public/permissions_ca.cert.pem", tmp_path / name)
    assert pqsec(f"verify {GOVERNANCE} --ca {name}").done().err == ""
