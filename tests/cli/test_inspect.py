"""pqsec inspect: what a file is, in words or JSON, and nothing private of it."""

from base64 import b64encode
from hashlib import sha256

import pytest

from pqsec_pki.algorithms import load_private_key, private_key_pem
from pqsec_pki.certificates import Certificate
from tests.cli.conftest import NAMES, snapshot

TALKER = "k/enclaves/talker"
PUBLIC_KEYS = {
    "transition": {"key.pem": "ecdsa-p256", "alt.key.pem": "ml-dsa-65"},
    "hybrid": {"key.pem": "mldsa65-ecdsa-p256-sha512"},
    "pq": {"key.pem": "ml-dsa-65"},
    "cnsa2": {"key.pem": "ml-dsa-87"},
    "classical": {"key.pem": "ecdsa-p256"},
}
WHAT = {
    f"{TALKER}/cert.pem": ("certificate", "Participant certificate: CN=/talker"),
    f"{TALKER}/key.pem": ("private key", "Private key"),
    f"{TALKER}/alt.key.pem": ("private key", "Private key"),
    f"{TALKER}/permissions.xml": ("permissions document", "Permissions document, unsigned"),
    f"{TALKER}/permissions.p7s": ("signed permissions document", "Permissions document, signed"),
    f"{TALKER}/governance.p7s": ("signed governance document", "Governance document, signed"),
    "k/enclaves/governance.xml": ("governance document", "Governance document, unsigned"),
    "k/public/identity_ca.cert.pem": ("certificate", "CA certificate: CN=Identity CA"),
    "k/public/permissions_ca.cert.pem": ("certificate", "CA certificate: CN=Permissions CA"),
    "k/public/permissions_ca.alt.cert.pem": (
        "certificate",
        "CA certificate: CN=Permissions CA ml-dsa-65",
    ),
    "k/private/permissions_ca.key.pem": ("private key", "Private key"),
}
PASSPHRASE = b"open sesame, please"
WINDOW = 8
"""Bytes. Fewer could stand in the output by chance."""


def certificate(path):
    return Certificate.from_pem(path.read_bytes())


def quotes(der):
    """What an output that quotes `der` would hold: in hex and in base64, wherever it begins."""
    for shift in range(3):
        text = b64encode(der[shift:]).decode()
        yield from (text[at : at + 12] for at in range(len(text) - 12))
    yield from (der[at : at + WINDOW].hex() for at in range(len(der) - WINDOW))


# What is told


@pytest.mark.parametrize("file", WHAT)
def test_a_file_is_told_by_what_it_is(pqsec, keystore, tmp_path, file):
    keystore("transition")
    kind, title = WHAT[file]
    first, *rest = pqsec("inspect", file).done().out.splitlines()
    assert first == f"{file}: {title}"
    assert rest
    assert all(line.startswith("  ") for line in rest)
    said = pqsec("inspect --json", file).done()
    [value] = said.json["files"]
    assert list(value)[:3] == ["file", "kind", "title"]
    assert (value["file"], value["kind"], value["title"]) == (file, kind, title)
    (tmp_path / "file").write_bytes((tmp_path / file).read_bytes())
    assert pqsec("inspect --json file").json["files"] == [value | {"file": "file"}]


def test_several_files_are_told_in_order(pqsec, keystore):
    keystore("transition")
    files = list(WHAT)
    together = pqsec("inspect", *files).done()
    apart = [pqsec("inspect", file).done() for file in files]
    assert together.out == "".join(each.out for each in apart)
    assert together.err == ""
    values = pqsec("inspect --json", *files, files[0]).done().json["files"]
    assert [value["file"] for value in values] == [*files, files[0]]
    assert values[-1] == values[0]
    assert [(value["kind"], value["title"]) for value in values[:-1]] == list(WHAT.values())


def test_several_things_in_one_file_are_told_each(pqsec, keystore, tmp_path):
    keystore("transition")
    parts = [
        (tmp_path / TALKER / name).read_bytes() for name in ("cert.pem", "identity_ca.cert.pem")
    ]
    (tmp_path / "both.pem").write_bytes(b"".join(parts))
    titles = ["Participant certificate: CN=/talker", "CA certificate: CN=Identity CA"]
    lines = pqsec("inspect both.pem").done().out.splitlines()
    assert lines[0] == "both.pem: 2 things in one file"
    assert [line for line in lines if line in titles] == titles
    [value] = pqsec("inspect both.pem --json").done().json["files"]
    assert value["kind"] == "several"
    assert [part["title"] for part in value["parts"]] == titles


@pytest.mark.parametrize("profile", NAMES)
def test_a_certificate_is_told_as_it_is(pqsec, keystore, tmp_path, profile):
    keystore(profile)
    file = f"{TALKER}/cert.pem"
    there = certificate(tmp_path / file)
    [value] = pqsec("inspect --json", file).done().json["files"]
    keys = PUBLIC_KEYS[profile]
    assert value["subject"] == "CN=/talker"
    assert value["role"] == "participant"
    assert value["sha256"] == there.fingerprint
    assert value["key"]["algorithm"] == keys["key.pem"]
    assert value["public_key_sha256"] == sha256(there.spki).hexdigest()
    out = pqsec("inspect", file).out
    assert there.fingerprint in out
    assert f"{there.serial_number:x}" in out
    second = [line for line in out.splitlines() if line.startswith("  alternative key ")]
    [words] = [line.removeprefix("  alternative key ").strip() for line in second]
    assert words.split(" ")[0] == keys.get("alt.key.pem", "none")


@pytest.mark.parametrize(
    ("profile", "file"), [(name, file) for name in NAMES for file in PUBLIC_KEYS[name]]
)
def test_of_a_private_key_its_public_half_is_told(pqsec, keystore, tmp_path, profile, file):
    keystore(profile)
    there = certificate(tmp_path / TALKER / "cert.pem")
    public = there.public_key if file == "key.pem" else there.alternative_key
    digest = sha256(public.spki).hexdigest()
    [value] = pqsec(f"inspect --json {TALKER}/{file}").done().json["files"]
    assert set(value) == {
        *("file", "kind", "title", "key", "public_key_sha256", "form", "encrypted", "private"),
    }
    assert value["key"]["algorithm"] == PUBLIC_KEYS[profile][file]
    assert value["key"]["sha256"] == value["public_key_sha256"] == digest
    assert (value["encrypted"], value["private"]) == (False, True)
    form = value["form"]
    lines = pqsec(f"inspect {TALKER}/{file}").done().out.splitlines()
    assert lines[0] == f"{TALKER}/{file}: Private key"
    assert lines[1].startswith(f"  key                 {PUBLIC_KEYS[profile][file]} (")
    assert lines[2:] == [
        f"  public key SHA-256  {digest}",
        f"  form                {form}",
        "                      not encrypted",
        "  keep                readable by its owner only (mode 0600)",
    ]


def test_no_keystore_is_needed_and_nothing_is_written(pqsec, keystore, tmp_path):
    keystore("transition")
    before = snapshot(tmp_path)
    pqsec("inspect", *WHAT, PQSEC_KEYSTORE="nowhere").done()
    pqsec("-k nowhere inspect", *WHAT).done()
    assert snapshot(tmp_path) == before


# Nothing private


@pytest.mark.parametrize("profile", NAMES)
def test_no_private_key_is_shown(pqsec, keystore, profile):
    k = keystore(profile)
    files = sorted(k.rglob("*key.pem"))
    assert {path.name for path in files if path.parent.name == "talker"} == set(
        PUBLIC_KEYS[profile]
    )
    names = [path.relative_to(k.parent) for path in files]
    shown = pqsec("inspect", *names).done().out + pqsec("inspect --json", *names).done().out
    for path in files:
        hidden = set(quotes(load_private_key(path.read_bytes()).pkcs8))
        assert len(hidden) > 100
        assert not [each for each in hidden if each in shown]


@pytest.mark.usefixtures("all_iterations")
@pytest.mark.parametrize("profile", NAMES)
def test_of_an_encrypted_ca_key_nothing_but_its_encryption_is_shown(pqsec, keystore, profile):
    k = keystore(profile)
    files = sorted((k / "private").glob("*.key.pem"))
    assert len(files) == (4 if profile == "transition" else 2)
    hidden = set()
    for path in files:
        key = load_private_key(path.read_bytes())
        path.write_bytes(private_key_pem(key, PASSPHRASE))
        hidden |= set(quotes(key.pkcs8)) | set(path.read_text().splitlines()[1:-1])
    names = [path.relative_to(k.parent) for path in files]
    told = pqsec("inspect", *names).done()
    values = pqsec("inspect --json", *names).done()
    assert not [each for each in hidden if each in told.out + values.out]
    for name, value in zip(names, values.json["files"], strict=True):
        assert value == {
            "file": str(name),
            "kind": "private key",
            "title": "Private key, encrypted",
            "key": None,
            "form": "PKCS#8",
            "encrypted": True,
            "private": True,
        }
        assert f"{name}: Private key, encrypted\n" in told.out
    words = "  encrypted: PBKDF2 with 600000 iterations, AES-256-CBC\n"
    assert told.out.count(words) == len(files)


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
@pytest.mark.parametrize("profile", NAMES)
def test_a_damaged_private_key_is_not_shown_either(pqsec, keystore, tmp_path, profile, share):
    der = load_private_key((keystore(profile) / "enclaves/talker/key.pem").read_bytes()).pkcs8
    (tmp_path / "cut").write_bytes(der[: int(len(der) * share)])
    for option in ("", "--json"):
        said = pqsec(f"inspect cut {option}").refused(3, "cut: ")
        assert not [each for each in set(quotes(der)) if each in said.err]


# What cannot be told

UNKNOWN = {
    "empty": b"",
    "text": b"hello\n",
    "binary": b"\0\xff" * 99,
    "settings": b'{"format": 1}\n',
    "hollow": b"-----BEGIN CERTIFICATE-----\nMAA=\n-----END CERTIFICATE-----\n",
    "cut": b"-----BEGIN PRIVATE KEY-----\nMAA=\n",
    "DER": b"\x30\x03\x02\x01\x05",
}


@pytest.mark.parametrize("content", UNKNOWN.values(), ids=UNKNOWN)
def test_what_is_not_known_is_an_error_that_names_the_file(pqsec, tmp_path, content):
    (tmp_path / "file").write_bytes(content)
    for option in ("", "--json"):
        said = pqsec(f"inspect file {option}").refused(3)
        assert said.errors[0].startswith("file: ")
        assert said.errors[0].count("file: ") == 1


def test_what_is_known_is_said_where_nothing_is(pqsec, tmp_path):
    (tmp_path / "file").write_text("hello\n")
    said = pqsec("inspect file").refused(3, hint="known are: certificates, private and public keys")
    assert said.errors == ["file: its content is of no known kind"]


def test_xml_that_breaks_its_schema_is_a_no(pqsec, keystore, tmp_path):
    text = (keystore() / "enclaves/governance.xml").read_text()
    (tmp_path / "broken.xml").write_text(text.replace(">ENCRYPT<", ">encrypt<"))
    said = pqsec("inspect broken.xml").refused(1, problems=text.count(">ENCRYPT<"))
    assert all(error.startswith("broken.xml: line ") for error in said.errors)
    assert all("'encrypt' is not one of" in error for error in said.errors)


@pytest.mark.parametrize("option", ["", "--json"])
def test_one_file_that_cannot_be_told_is_named_and_nothing_is_printed(
    pqsec, keystore, tmp_path, option
):
    keystore("transition")
    (tmp_path / "other").write_text("hello\n")
    said = pqsec(f"inspect {option}", *WHAT, "other").refused(3)
    assert said.errors == ["other: its content is of no known kind"]
    said = pqsec(f"inspect {option}", "nowhere", *WHAT).refused(3)
    assert said.errors == ["nowhere: no such file or directory"]


def test_a_file_that_cannot_be_read_is_an_error(pqsec, tmp_path):
    assert pqsec("inspect nowhere").refused(3).errors == ["nowhere: no such file or directory"]
    (tmp_path / "loop").symlink_to("loop")
    pqsec("inspect loop").refused(3, "loop: too many levels of symbolic links")
    (tmp_path / "huge").write_bytes(b"x" * (9 << 20))
    pqsec("inspect huge").refused(3, "huge: larger than")


def test_what_names_no_file_is_a_usage_error(pqsec, keystore):
    keystore()
    hint = "`pqsec inspect --help`"
    pqsec("inspect").refused(2, "Missing argument 'FILE...'", hint=hint)
    pqsec("inspect", "").refused(2, "'FILE...': the path is empty", hint=hint)
    pqsec("inspect k/enclaves/governance.xml", "").refused(2, "the path is empty", hint=hint)
    pqsec("inspect k").refused(2, "is a directory", hint=hint)
    pqsec("inspect --passphrase-file x").refused(2, "--passphrase-file")
