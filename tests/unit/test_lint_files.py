"""The rules about files: modes, keys out of place and keys left behind."""

import shutil

import pytest
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
)

from pqsec_pki.algorithms import load_private_key, private_key_pem, unpem
from tests.unit.linting import SECRET, TALKER, Lab, certificate, p256

KEY = f"{TALKER}/key.pem"
CA_KEY = "private/identity_ca.key.pem"


@pytest.fixture
def lab(tmp_path):
    return Lab(tmp_path)


def open_ca_key(lab):
    return private_key_pem(load_private_key((lab / CA_KEY).read_bytes(), SECRET))


def copy_key(lab, goal, source=KEY, mode=0o600):
    shutil.copyfile(lab / source, lab / goal)
    (lab / goal).chmod(mode)


def chmod(path, mode):
    return lambda lab: (lab / path).chmod(mode)


def put(path, make):
    return lambda lab: lab.put(path, make(lab))


FLAWS = [
    ("PQS701", chmod(KEY, 0o644)),
    ("PQS701", chmod(KEY, 0o640)),
    ("PQS701", chmod(f"{TALKER}/alt.key.pem", 0o604)),
    ("PQS701", chmod(CA_KEY, 0o660)),
    ("PQS702", chmod("private", 0o755)),
    ("PQS702", chmod("private", 0o710)),
    ("PQS703", lambda lab: copy_key(lab, f"{TALKER}/ca.key.pem", CA_KEY)),
    ("PQS703", lambda lab: copy_key(lab, f"{TALKER}/identity_ca.key.pem", CA_KEY)),
    ("PQS703", put(KEY, open_ca_key)),
    ("PQS704", lambda lab: copy_key(lab, "public/talker.key.pem")),
    ("PQS704", lambda lab: lab.put(f"{TALKER}/cert.pem", both(lab))),
    ("PQS705", chmod(f"{TALKER}/cert.pem", 0o666)),
    ("PQS705", chmod(TALKER, 0o777)),
    ("PQS705", chmod("enclaves/governance.p7s", 0o646)),
    ("PQS706", lambda lab: copy_key(lab, f"{TALKER}/key.pem~")),
    ("PQS706", lambda lab: copy_key(lab, f"{TALKER}/key.pem.bak")),
    ("PQS706", lambda lab: copy_key(lab, f"{TALKER}/#key.pem#")),
    ("PQS706", lambda lab: copy_key(lab, f"{TALKER}/key (copy).pem")),
    ("PQS706", lambda lab: copy_key(lab, f"{TALKER}/.key.pem.swp")),
    ("PQS701", put(f"{TALKER}/backup.der", lambda lab: in_der(PrivateFormat.PKCS8))),
    ("PQS701", put(f"{TALKER}/backup.key", lambda lab: in_der(PrivateFormat.TraditionalOpenSSL))),
    ("PQS703", put(f"{TALKER}/x.key", lambda lab: unpem(open_ca_key(lab), "key")[0][1])),
    ("PQS704", put("public/talker.der", lambda lab: in_der(PrivateFormat.PKCS8))),
    ("PQS707", put(CA_KEY, open_ca_key)),
    ("PQS708", put(CA_KEY, lambda lab: in_the_old_way(BestAvailableEncryption(SECRET)))),
]


def in_the_old_way(encryption):
    return p256().private_bytes(Encoding.PEM, PrivateFormat.TraditionalOpenSSL, encryption)


def in_der(form):
    return p256().private_bytes(Encoding.DER, form, NoEncryption())


def both(lab):
    return (lab / TALKER / "cert.pem").read_bytes() + (lab / KEY).read_bytes()


@pytest.mark.parametrize(("rule", "flaw"), FLAWS)
def test_a_flaw_is_found(lab, rule, flaw):
    flaw(lab)
    assert rule in lab.found()


@pytest.mark.parametrize(
    "change",
    [
        lambda lab: None,
        chmod(KEY, 0o400),
        chmod(TALKER, 0o755),
        chmod("private", 0o500),
        chmod(f"{TALKER}/cert.pem", 0o600),
        lambda lab: copy_key(lab, f"{TALKER}/old.key.pem"),
        chmod("enclaves", 0o1777),  # sticky, as /tmp is
        lambda lab: shutil.copyfile(lab / TALKER / "cert.pem", lab / "public/talker.cert.pem"),
        lambda lab: lab.put(
            "public/talker.der", unpem((lab / TALKER / "cert.pem").read_bytes(), "it")[0][1]
        ),
    ],
)
def test_what_is_no_flaw_is_not_complained_of(lab, change):
    change(lab)
    assert lab.found() == {}


def test_an_encrypted_private_key_must_not_be_read_by_others_either(lab):
    (lab / CA_KEY).chmod(0o644)
    assert set(lab.found()) == {"PQS701"}


def test_no_message_shows_a_key(lab):
    for _, flaw in FLAWS:
        flaw(lab)
    findings = lab.found().values()
    key = (lab / KEY).read_bytes().splitlines()[1].decode()
    assert len(findings) > 5
    assert not any(key[:16] in finding.message for finding in findings)


def test_a_traditional_key_counts_too(lab):
    (lab / "public/old.pem").write_bytes(in_the_old_way(NoEncryption()) + certificate())
    assert {"PQS701", "PQS704"} <= set(lab.found())
    assert "PQS708" not in lab.found()


def test_a_key_is_found_in_a_file_that_is_also_a_document(lab):
    signed = (lab / TALKER / "permissions.p7s").read_bytes()
    lab.put(f"{TALKER}/both.p7s", signed + (lab / KEY).read_bytes())
    (lab / TALKER / "both.p7s").chmod(0o644)
    found = lab.found()
    assert {"PQS701", "PQS706", "PQS344"} <= set(found)
    assert found["PQS701"].path.name == "both.p7s"
