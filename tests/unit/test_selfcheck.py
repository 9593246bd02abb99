"""The self-check refuses what would break a promise though every signature holds."""

import shutil
from collections import Counter
from datetime import UTC, datetime, timedelta

import pytest

from pqsec_pki.algorithms import SIGNATURES, private_key_pem, profile_named
from pqsec_pki.certificates import Authority
from pqsec_pki.credentials import _signed_documents as signed
from pqsec_pki.documents import DomainSet, Governance, Permissions
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.lifecycle.issuing import permissions_for
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck import HandshakeParty, HandshakeSetup, run_handshake
from pqsec_pki.smime import Signer, sign

NOW = datetime(2026, 11, 21, 12, tzinfo=UTC)
YEAR = timedelta(days=365)
DOMAIN = DomainSet.of(0)


def spec(name):
    return ParticipantSpec(name=name, domains=DOMAIN, publish=("rt/chatter",), validity=YEAR)


@pytest.fixture
def made(tmp_path):
    def make(profile):
        keystore = Keystore.create(
            tmp_path / "k",
            profile_named(profile),
            name="Lab",
            domains=DOMAIN,
            validity=10 * YEAR,
            passphrase=None,
            now=NOW,
        )
        issue(keystore, keystore.unlock(None), [spec("/talker"), spec("/listener")], now=NOW)
        return keystore

    return make


def failing(keystore):
    setup = HandshakeSetup(keystore=keystore, domain=0, now=NOW)
    report = run_handshake(setup, HandshakeParty(name="/talker"), HandshakeParty(name="/listener"))
    assert not report.ok
    return report.steps[-1]


def sign_all_again(keystore, signer, counter=None):
    """Everything signed by another permissions CA."""
    root = keystore.root

    def signed(document):
        return sign(document, signer, countersigner=counter, now=NOW)

    (root / "enclaves/governance.p7s").write_bytes(signed(Governance.protected(DOMAIN).to_xml()))
    for name in keystore.names():
        certificate = keystore.participant(name).certificate
        permissions = permissions_for(spec(name), certificate).to_xml()
        (root / f"enclaves{name}/permissions.p7s").write_bytes(signed(permissions))


def test_an_expired_countersigner_is_refused(made):
    keystore = made("transition")
    unlocked = keystore.unlock(None)
    row = SIGNATURES.named("ml-dsa-65")
    old = Authority.create("Lab Permissions CA ml-dsa-65", row, now=NOW - 5 * YEAR, validity=YEAR)
    (keystore.root / "public/permissions_ca.alt.cert.pem").write_bytes(old.certificate.pem)
    main = Signer(unlocked.permissions.certificate, unlocked.permissions.key)
    sign_all_again(keystore, main, Signer(old.certificate, old.key))
    step = failing(keystore)
    assert step.name == "documents of /talker"
    assert "the CA certificate expired on 2022-11-22" in step.detail


def pinned_beside(keystore):
    """A countersigner for a profile that has none, as the owner of a robot may pin one."""
    row = SIGNATURES.named("ml-dsa-65")
    second = Authority.create("Lab Permissions CA ml-dsa-65", row, now=NOW, validity=YEAR)
    place = keystore.root / "public/permissions_ca.alt.cert.pem"
    place.write_bytes(second.certificate.pem)
    for name in keystore.names():
        enclave = keystore.root / f"enclaves{name}/permissions_ca.alt.cert.pem"
        if not enclave.exists():
            enclave.write_bytes(second.certificate.pem)
    return Signer(second.certificate, second.key)


@pytest.mark.parametrize("profile", ["classical", "hybrid", "transition"])
def test_every_signature_that_is_pinned_must_be_there(made, profile):
    """C25: where a countersigner is pinned, a document without its signature is refused."""
    keystore = made(profile)
    permissions = keystore.unlock(None).permissions
    main, second = Signer(permissions.certificate, permissions.key), pinned_beside(keystore)
    sign_all_again(keystore, main, second)
    setup = HandshakeSetup(keystore=keystore, domain=0, now=NOW)
    assert run_handshake(setup, HandshakeParty(name="/talker"), HandshakeParty(name="/listener")).ok
    sign_all_again(keystore, main)
    step = failing(keystore)
    assert step.name == "documents of /talker"
    assert step.codes == {Code.SIGNATURE_MISSING}


def test_a_participant_as_permissions_ca_is_refused(made):
    keystore = made("classical")
    talker = keystore.participant("/talker")
    (keystore.root / "public/permissions_ca.cert.pem").write_bytes(talker.certificate.pem)
    sign_all_again(keystore, Signer(talker.certificate, talker.key))
    step = failing(keystore)
    assert step.name == "documents of /talker"
    assert "is not marked as a CA" in step.detail


def test_one_ca_for_both_is_refused(made):
    keystore = made("classical")
    identity = keystore.unlock(None).identity
    (keystore.root / "public/permissions_ca.cert.pem").write_bytes(identity.certificate.pem)
    sign_all_again(keystore, Signer(identity.certificate, identity.key))
    step = failing(keystore)
    assert step.name == "documents of /talker"
    assert "this CA has the same key as identity_ca.cert.pem" in step.detail


def test_a_weaker_key_than_the_profile_promises_is_refused(made):
    keystore = made("pq")
    unlocked = keystore.unlock(None)
    key = SIGNATURES.named("ecdsa-p256").generate()
    weak = unlocked.identity.issue("/talker", key.public_key, now=NOW, validity=YEAR)
    folder = keystore.root / "enclaves/talker"
    (folder / "cert.pem").write_bytes(weak.pem)
    (folder / "key.pem").write_bytes(private_key_pem(key))
    step = failing(keystore)
    assert step.name == "identity of /talker"
    assert step.detail == "cert.pem: ecdsa-p256 participant key, where profile pq has ml-dsa-65"


def test_an_enclave_with_anothers_credentials_is_refused(made):
    keystore = made("classical")
    enclaves = keystore.root / "enclaves"
    for file in ("cert.pem", "key.pem", "permissions.p7s"):
        shutil.copy(enclaves / "listener" / file, enclaves / "talker" / file)
    step = failing(keystore)
    assert step.name == "identity of /talker"
    assert step.detail == "cert.pem: the certificate is for CN=/listener"


def test_a_needless_alternative_key_is_refused(made):
    keystore = made("classical")
    stray = private_key_pem(SIGNATURES.named("ml-dsa-65").generate())
    (keystore.root / "enclaves/talker/alt.key.pem").write_bytes(stray)
    step = failing(keystore)
    assert step.name == "identity of /talker"
    assert step.detail == "alt.key.pem: not the alternative key of the certificate"


def test_each_document_is_verified_once_per_reader(made, monkeypatch):
    """Two readers, each of its own two documents and of its peer's permissions: six at most."""
    keystore = made("transition")
    calls = Counter()

    def counted(name, check):
        def count(*arguments, **options):
            calls[name] += 1
            return check(*arguments, **options)

        return count

    for check in (signed.verified_by, signed.governance_in, signed.permissions_in):
        check.cache_clear()
    monkeypatch.setattr(signed, "verify", counted("signatures", signed.verify))
    for kind in (Governance, Permissions):
        monkeypatch.setattr(kind, "from_xml", counted("schemas", kind.from_xml))
    setup = HandshakeSetup(keystore=keystore, domain=0, now=NOW)
    assert run_handshake(setup, HandshakeParty(name="/talker"), HandshakeParty(name="/listener")).ok
    assert 0 < calls["signatures"] <= 6
    assert 0 < calls["schemas"] <= 6
