"""What others made becomes a keystore of pqsec's, and no file in it changes."""

import shutil

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID

from pqsec_pki.algorithms import PROFILES, load_private_key, private_key_pem, profile_named
from pqsec_pki.certificates import Authority, Certificate, revocation_list, verify_chain
from pqsec_pki.documents import DomainRange, DomainSet, Governance, Permissions
from pqsec_pki.errors import (
    ExistsError,
    KeystoreError,
    MalformedError,
    PqsecError,
    UnknownAlgorithmError,
    VerificationError,
)
from pqsec_pki.keystore import Keystore, audit, status
from pqsec_pki.lifecycle import (
    ParticipantSpec,
    Rollover,
    adopt,
    issue,
    plan_rollover,
    renew,
    revoke,
    sign_governance,
)
from pqsec_pki.lint import Severity, check
from pqsec_pki.selfcheck import verify_handshake
from pqsec_pki.smime import verify
from pqsec_pki.tokens import reference_to
from tests.unit.keystores import DAY, NOW, made, rotate
from tests.unit.sros2_keystore import NO_CA, SROS2, permissions


@pytest.fixture
def sros2(tmp_path):
    keystore = SROS2(tmp_path / "k")
    keystore.enclave("/talker")
    keystore.enclave("/fleet/robot1")
    return keystore


def files(root):
    """Everything that is there: kind, mode, time and content."""
    found = {}
    for path in root.rglob("*"):
        state = path.lstat()
        content = path.read_bytes() if path.is_file() else None
        where = path.readlink() if path.is_symlink() else None
        # The time of a folder that gets a new file changes; its mode does not.
        changed = None if path.is_dir() else state.st_mtime_ns
        found[path] = (oct(state.st_mode), where, changed, content)
    return found


# What becomes of it


def test_no_file_that_was_there_is_changed(sros2):
    before, mode = files(sros2.root), sros2.root.stat().st_mode
    done = adopt(sros2.root, now=NOW)
    after = files(sros2.root)
    assert {path: after[path] for path in before} == before
    assert sros2.root.stat().st_mode == mode
    added = {str(path.relative_to(sros2.root)) for path in after.keys() - before.keys()}
    assert {name for name in added if "-" not in name} == {
        "pqsec.json",
        "private/ledger.sqlite3",
    }
    assert done.participants == ["/fleet/robot1", "/talker"]
    assert done.refused == {}


def test_a_governance_for_domains_that_stacks_read_differently_is_adopted(tmp_path):
    keystore = made(tmp_path / "k", "classical")
    endless = DomainSet(parts=(DomainRange(first=0),))
    sign_governance(keystore, keystore.unlock(None), Governance.protected(endless), now=NOW)
    (keystore.root / "pqsec.json").unlink()
    (keystore.root / "private/ledger.sqlite3").unlink()
    adopt(keystore.root, now=NOW)
    assert Keystore.open(keystore.root).domains == DomainSet.of(0)


@pytest.mark.parametrize("mode", [0o700, 0o775])
def test_the_mode_of_the_folder_stays(sros2, mode):
    sros2.root.chmod(mode)
    adopt(sros2.root, now=NOW)
    assert sros2.root.stat().st_mode & 0o777 == mode


def test_the_ledger_knows_everything(sros2):
    done = adopt(sros2.root, now=NOW)
    keystore = Keystore.open(sros2.root)
    assert keystore == done.keystore
    audit(keystore)
    kinds = [each.kind for each in keystore.ledger()]
    assert sorted(kinds) == sorted(
        # One certificate is both CAs, and so has a line as each.
        ["identity-ca", "permissions-ca", "governance", *["participant", "permissions"] * 2]
    )
    found = status(keystore, now=NOW)
    assert [(each.name, each.state, each.domains) for each in found.participants] == [
        ("/fleet/robot1", "valid", "0"),
        ("/talker", "valid", "0"),
    ]
    assert {each.profile for each in found.participants} == {"classical"}


def test_the_check_tells_of_the_one_ca(sros2):
    assert adopt(sros2.root, now=NOW).one_ca
    report = check([sros2.root], now=NOW)
    errors = [str(each) for each in report.findings if each.rule.severity is Severity.ERROR]
    assert any("CVE-2023-24010" in each for each in errors)


def test_one_key_for_two_cas_issues_nothing(sros2):
    keystore = adopt(sros2.root, now=NOW).keystore
    with pytest.raises(KeystoreError, match="CVE-2023-24010") as caught:
        keystore.unlock(None)
    assert "pqsec ca rotate" in caught.value.hint


@pytest.mark.parametrize("profile", ["classical", "transition", "pq"])
@pytest.mark.parametrize("destroy", [False, True], ids=["kept", "destroyed"])
def test_the_way_out_is_to_rotate(sros2, profile, destroy):
    keystore = adopt(sros2.root, now=NOW).keystore
    before = {name: keystore.participant(name).certificate for name in keystore.names()}
    terms = Rollover(profile=profile_named(profile), destroy=destroy)
    done = rotate(keystore, terms, passphrase=None, now=NOW)
    new = done.keystore
    assert sorted(each.name for each in done.issued) == ["/fleet/robot1", "/talker"]
    assert new.identity_ca.subject_name == "CN=sros2CA G2 Identity CA"
    for name, old in before.items():
        one = new.participant(name)
        verify_chain(one.certificate, new.identity_ca, now=NOW)
        assert (one.certificate.spki == old.spki) == (profile == "classical")
    assert verify_handshake(new, "/talker", "/fleet/robot1", domain=0, now=NOW).ok
    audit(new)
    assert not list(sros2.root.glob("p*/ca.*")), "SROS2's CA is still there"
    kept = {path.name for path in done.plan.archive.glob("*.key.pem")}
    assert kept == (
        set() if destroy else {"ca.key.pem", "identity_ca.key.pem", "permissions_ca.key.pem"}
    )
    assert (sros2.root / "private").stat().st_mode & 0o777 == 0o700
    issue(new, new.unlock(None), [spec("/new")], now=NOW)


def spec(name):
    return ParticipantSpec(name=name, domains=DomainSet.of(0), publish=("x",), validity=90 * DAY)


def test_a_keystore_of_ours_that_lost_its_settings_and_ledger_is_adopted(tmp_path):
    keystore = made(tmp_path / "k", "transition")
    (keystore.root / "pqsec.json").unlink()
    (keystore.root / "private/ledger.sqlite3").unlink()
    done = adopt(keystore.root, now=NOW)
    assert done.refused == {}
    assert done.fitting
    assert done.keystore.profile.to_names() == keystore.profile.to_names()
    audit(done.keystore)
    renew(done.keystore, done.keystore.unlock(None), ["/talker"], now=NOW + DAY)
    revoke(done.keystore, done.keystore.unlock(None), ["/talker"], now=NOW + DAY)


def test_a_keystore_whose_ca_keys_are_in_tokens_is_adopted(tmp_path):
    keystore = made(tmp_path / "k", "transition")
    for path in (keystore.root / "private").glob("*.key.pem"):
        path.write_bytes(reference_to(f"pkcs11:token=lab;object={path.stem}"))
    (keystore.root / "pqsec.json").unlink()
    (keystore.root / "private/ledger.sqlite3").unlink()
    done = adopt(keystore.root, now=NOW)
    assert (done.refused, done.fitting) == ({}, True)
    assert len(done.keystore.key_uris()) == 4


def test_what_a_profile_promised_is_promised_again(tmp_path):
    """A composite keystore came out as pq, whose promise a later key could keep without a half."""
    wrong = {}
    for profile in PROFILES:
        keystore = made(tmp_path / profile.name, profile.name, names=("/talker",))
        (keystore.root / "pqsec.json").unlink()
        (keystore.root / "private/ledger.sqlite3").unlink()
        done = adopt(keystore.root, now=NOW)
        if (done.keystore.profile, done.fitting) != (keystore.profile, True):
            wrong[profile.name] = done.keystore.profile.to_names()
    assert not wrong


def test_any_composite_keys_are_hybrid_and_one_that_is_not_makes_it_pq(tmp_path):
    composite = {"identity_key": "mldsa44-ecdsa-p256-sha256"}
    for number, (more, name) in enumerate([({}, "hybrid"), ({"participant": "ml-dsa-65"}, "pq")]):
        keys = composite | dict.fromkeys(
            ["permissions_key", "participant_key"], composite["identity_key"]
        )
        keys |= {f"{kind}_key": row for kind, row in more.items()}
        profile = profile_named(name).changed(keys)
        options = {"domains": DomainSet.of(0), "validity": 900 * DAY, "now": NOW}
        root = tmp_path / str(number)
        keystore = Keystore.create(root, profile, name="Test", passphrase=None, **options)
        issue(keystore, keystore.unlock(None), [spec("/talker")], now=NOW)
        (root / "pqsec.json").unlink()
        (root / "private/ledger.sqlite3").unlink()
        assert adopt(root, now=NOW).keystore.profile.name == name


def test_a_keystore_whose_ca_keys_are_elsewhere_is_adopted(sros2):
    for path in [*(sros2.root / "private").iterdir()]:
        path.unlink()
    (sros2.root / "private").rmdir()
    keystore = adopt(sros2.root, now=NOW).keystore
    audit(keystore)
    assert (sros2.root / "private").stat().st_mode & 0o777 == 0o700


def test_an_old_revocation_list_stays_in_force(sros2):
    folder = sros2.enclave("/stolen")
    serial = Certificate.from_pem((folder / "cert.pem").read_bytes()).serial_number
    for name in ("stolen", "talker"):
        (sros2.root / f"enclaves/{name}/crl.pem").write_bytes(sros2.revoke(serial, 4711))
    done = adopt(sros2.root, now=NOW)
    keystore = done.keystore
    audit(keystore)
    states = {each.name: each.state for each in status(keystore, now=NOW).participants}
    assert states == {"/stolen": "revoked", "/talker": "valid", "/fleet/robot1": "valid"}
    assert {each.serial_number for each in keystore.revocation_list.revoked} == {serial, 4711}
    terms = Rollover(profile=keystore.profile)
    assert rotate(keystore, terms, passphrase=None, now=NOW).plan.left_out == {"/stolen": "revoked"}


def test_what_openssl_named_otherwise_may_do_the_same_after_a_rollover(sros2):
    folder = sros2.enclave("/named")
    other = "CN=other,O=Lab"
    parts = [(NameOID.ORGANIZATION_NAME, "Lab"), (NameOID.COMMON_NAME, "other")]
    name = x509.Name([x509.NameAttribute(oid, text) for oid, text in parts])
    key = ec.generate_private_key(ec.SECP256R1())
    certificate = sros2.certificate(name, key, NO_CA)
    (folder / "cert.pem").write_bytes(certificate.public_bytes(Encoding.PEM))
    sros2.sign("enclaves/named/permissions", permissions("/named", other))
    keystore = adopt(sros2.root, now=NOW).keystore
    assert keystore.participant("/named").certificate.subject_name == other
    new = rotate(keystore, Rollover(profile=keystore.profile), passphrase=None, now=NOW).keystore
    one = new.participant("/named")
    [grant] = Permissions.from_xml(verify(one.permissions, one.permissions_ca).document).grants
    assert grant.subject_name == one.certificate.subject_name == "CN=/named"


# What is told, and kept out of the ledger


def foreign_certificate(sros2, other):
    return "cert.pem", (other.enclave("/x") / "cert.pem").read_bytes()


def foreign_permissions(sros2, other):
    return "permissions.p7s", (other.enclave("/x") / "permissions.p7s").read_bytes()


def broken_certificate(sros2, other):
    return "cert.pem", b"-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n"


def altered_permissions(sros2, other):
    path = sros2.root / "enclaves/talker/permissions.p7s"
    return "permissions.p7s", path.read_bytes().replace(b"rt/*", b"rt/x")


@pytest.mark.parametrize(
    ("flaw", "words"),
    [
        (foreign_certificate, "not signed by this CA"),
        (foreign_permissions, "sign"),
        (broken_certificate, "certificate"),
        (altered_permissions, "the content was changed after signing"),
    ],
)
def test_what_is_not_the_cas_is_told_and_stays_out_of_the_ledger(sros2, tmp_path, flaw, words):
    name, data = flaw(sros2, SROS2(tmp_path / "other"))
    (sros2.root / "enclaves/talker" / name).write_bytes(data)
    done = adopt(sros2.root, now=NOW)
    assert list(done.refused) == [f"enclaves/talker/{name}"]
    assert words in done.refused[f"enclaves/talker/{name}"]
    assert ("/talker" in done.participants) == (name == "permissions.p7s")
    with pytest.raises(PqsecError):
        audit(done.keystore)
    with pytest.raises(PqsecError):  # nor does it come along
        rotate(done.keystore, Rollover(profile=done.keystore.profile), passphrase=None, now=NOW)


def test_a_first_participant_that_cannot_be_read_is_told_like_any_other(sros2):
    (sros2.root / "enclaves/fleet/robot1/cert.pem").write_bytes(b"garbage")
    done = adopt(sros2.root, now=NOW)
    assert done.participants == ["/talker"]
    assert done.fitting
    assert done.refused == {"enclaves/fleet/robot1/cert.pem": "no certificate in PEM"}
    with pytest.raises(VerificationError) as caught:
        audit(done.keystore)
    assert len(caught.value.lines) == 2  # its certificate and its permissions


def strange(sros2, name, place, *, ca=False):
    """A certificate of a kind that no stack has, signed as it should be."""
    key = ec.generate_private_key(ec.SECP256K1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    constraints = x509.BasicConstraints(ca=True, path_length=None) if ca else NO_CA
    certificate = sros2.certificate(subject, key, constraints)
    (sros2.root / place).write_bytes(certificate.public_bytes(Encoding.PEM))


def test_a_participant_whose_key_is_of_no_known_kind_gets_one_that_is(sros2):
    strange(sros2, "/talker", "enclaves/talker/cert.pem")
    done = adopt(sros2.root, now=NOW)
    assert (done.refused, done.participants) == ({}, ["/fleet/robot1", "/talker"])
    told = plan_rollover(done.keystore, Rollover(profile=done.keystore.profile), now=NOW)
    assert told.rekeyed == ("/talker",)
    rotate(done.keystore, Rollover(profile=done.keystore.profile), passphrase=None, now=NOW)
    done.keystore.participant("/talker")


def test_a_ca_whose_key_is_of_no_known_kind_is_refused_by_name(sros2):
    strange(sros2, "sros2CA", "public/ca.cert.pem", ca=True)
    with pytest.raises(UnknownAlgorithmError, match=r"identity_ca\.cert\.pem: .*secp256k1"):
        adopt(sros2.root, now=NOW)


def a_link_to_nowhere(path):
    path.unlink(missing_ok=True)
    path.symlink_to("nowhere")


def a_link_to_itself(path):
    path.unlink(missing_ok=True)
    path.symlink_to(path.name)


def a_link_to_zeros_without_end(path):
    path.unlink(missing_ok=True)
    path.symlink_to("/dev/zero")


def a_folder(path):
    path.unlink(missing_ok=True)
    path.mkdir()


@pytest.mark.parametrize("name", ["cert.pem", "permissions.p7s", "crl.pem"])
@pytest.mark.parametrize(
    "put", [a_link_to_nowhere, a_link_to_itself, a_link_to_zeros_without_end, a_folder]
)
def test_what_is_no_file_is_told_and_adopted_is_the_rest(sros2, put, name):
    put(sros2.root / "enclaves/talker" / name)
    done = adopt(sros2.root, now=NOW)
    [(place, reason)] = done.refused.items()
    assert place == f"enclaves/talker/{name}"
    assert str(sros2.root) not in reason
    assert "/fleet/robot1" in done.participants
    assert ("/talker" in done.participants) == (name != "cert.pem")


def test_several_certificates_in_a_cas_file_are_told(sros2, tmp_path):
    path = sros2.root / "public/ca.cert.pem"
    other = SROS2(tmp_path / "other").root / "public/ca.cert.pem"
    path.write_bytes(path.read_bytes() + other.read_bytes())
    done = adopt(sros2.root, now=NOW)
    assert done.refused == dict.fromkeys(
        ["public/identity_ca.cert.pem", "public/permissions_ca.cert.pem"],
        "2 certificates: the first one is the CA",
    )
    with pytest.raises(VerificationError, match=r"identity_ca\.cert\.pem is not in the ledger"):
        audit(done.keystore)


def test_a_participant_with_several_certificates_is_not_adopted_for_the_first(sros2):
    path = sros2.root / "enclaves/talker/cert.pem"
    second = sros2.root / "enclaves/fleet/robot1/cert.pem"
    path.write_bytes(path.read_bytes() + second.read_bytes())
    done = adopt(sros2.root, now=NOW)
    assert done.refused == {"enclaves/talker/cert.pem": "2 certificates, not one"}
    assert done.participants == ["/fleet/robot1"]


def test_a_key_that_is_not_the_cas_is_told(sros2, tmp_path):
    key = SROS2(tmp_path / "other").root / "private/ca.key.pem"
    (sros2.root / "private/ca.key.pem").write_bytes(key.read_bytes())
    refused = adopt(sros2.root, now=NOW).refused
    assert refused["private/identity_ca.key.pem"].startswith(
        "the key does not match the CA's certificate"
    )
    assert list(refused) == ["private/identity_ca.key.pem", "private/permissions_ca.key.pem"]


def test_cas_whose_keys_are_elsewhere_are_adopted_and_that_is_told(sros2):
    shutil.rmtree(sros2.root / "private")
    done = adopt(sros2.root, now=NOW)
    assert done.refused["private/identity_ca.key.pem"] == "no such file or directory"
    assert done.participants == ["/fleet/robot1", "/talker"]
    audit(done.keystore)


def test_an_encrypted_key_is_no_matter_and_either_asks_for_the_passphrase(tmp_path):
    for which in ("identity_ca", "permissions_ca"):
        keystore = made(tmp_path / which, "classical")
        path = keystore.root / f"private/{which}.key.pem"
        key = load_private_key(path.read_bytes())
        path.write_bytes(private_key_pem(key, b"secret"))
        (keystore.root / "pqsec.json").unlink()
        (keystore.root / "private/ledger.sqlite3").unlink()
        done = adopt(keystore.root, now=NOW)
        assert done.refused == {}
        assert done.keystore.is_locked()
        issue(done.keystore, done.keystore.unlock(b"secret"), [spec("/new")], now=NOW)


def test_two_participants_with_one_serial_number_are_told(sros2):
    sros2.enclave("/a", serial=1)
    sros2.enclave("/b", serial=1)
    done = adopt(sros2.root, now=NOW)
    assert done.refused == {"enclaves/b/cert.pem": "its serial number is also that of /a"}


def test_a_governance_that_the_ca_did_not_sign_is_told(sros2, tmp_path):
    other = SROS2(tmp_path / "other")
    data = (other.root / "enclaves/governance.p7s").read_bytes()
    (sros2.root / "enclaves/governance.p7s").write_bytes(data)
    assert list(adopt(sros2.root, now=NOW).refused) == ["enclaves/governance.p7s"]


def test_a_list_that_is_not_the_cas_is_told_and_left_alone(sros2, tmp_path):
    (sros2.root / "enclaves/talker/crl.pem").write_bytes(SROS2(tmp_path / "other").revoke(1))
    done = adopt(sros2.root, now=NOW)
    assert list(done.refused) == ["enclaves/talker/crl.pem"]
    assert not done.keystore.has_revocation_list


def test_a_list_without_the_alternative_signature_is_told_and_left_alone(tmp_path):
    keystore = made(tmp_path / "k", "transition")
    ca = keystore.unlock(None).identity
    once = revocation_list(
        Authority(ca.certificate, ca.key), [], number=7, now=NOW, validity=30 * DAY
    )
    for path in (keystore.root / "pqsec.json", keystore.root / "private/ledger.sqlite3"):
        path.unlink()
    for folder in ("talker", "listener"):
        (keystore.root / "enclaves" / folder / "crl.pem").write_bytes(once.pem)

    done = adopt(keystore.root, now=NOW)
    assert list(done.refused) == ["enclaves/listener/crl.pem", "enclaves/talker/crl.pem"]
    assert not done.keystore.has_revocation_list


# What is refused


def test_a_keystore_of_ours_is_not_adopted(tmp_path):
    keystore = made(tmp_path / "k", "classical")
    with pytest.raises(ExistsError, match="is a pqsec keystore already"):
        adopt(keystore.root, now=NOW)


@pytest.mark.parametrize("name", ["public", "private", "enclaves"])
def test_a_folder_that_is_a_link_is_refused_as_it_would_be_later(sros2, tmp_path, name):
    (sros2.root / name).rename(tmp_path / name)
    (sros2.root / name).symlink_to(tmp_path / name)
    with pytest.raises(KeystoreError, match=f"{name} should be a folder, and is a link"):
        adopt(sros2.root, now=NOW)
    assert not (sros2.root / "pqsec.json").exists()


def test_settings_that_are_a_link_to_nowhere_are_not_replaced(sros2):
    (sros2.root / "pqsec.json").symlink_to("nowhere")
    with pytest.raises(ExistsError):
        adopt(sros2.root, now=NOW)
    assert (sros2.root / "pqsec.json").is_symlink()


def test_a_ca_in_der_is_refused_with_the_way_out(sros2):
    path = sros2.root / "public/ca.cert.pem"
    path.write_bytes(Certificate.from_pem(path.read_bytes()).der)
    with pytest.raises(MalformedError, match="no certificate in PEM") as caught:
        adopt(sros2.root, now=NOW)
    assert "openssl x509 -inform DER" in caught.value.hint
    assert not (sros2.root / "pqsec.json").exists()


@pytest.mark.parametrize(
    "lost",
    ["public/identity_ca.cert.pem", "public/permissions_ca.cert.pem", "enclaves/governance.p7s"],
)
def test_what_is_no_keystore_is_refused_and_left_alone(sros2, lost):
    (sros2.root / lost).unlink()
    before = files(sros2.root)
    with pytest.raises(KeystoreError, match=f"lacks {lost}"):
        adopt(sros2.root, now=NOW)
    assert files(sros2.root) == before


def test_a_folder_that_is_not_there_is_not_made(tmp_path):
    with pytest.raises(KeystoreError, match="lacks public/identity_ca"):
        adopt(tmp_path / "no", now=NOW)
    assert not (tmp_path / "no").exists()
