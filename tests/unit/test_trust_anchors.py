"""The CAs by their roles: who must be good, which list counts, and who signs what."""

from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import partial

import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    PrivateFormat,
)

from pqsec_pki.algorithms import SIGNATURES
from pqsec_pki.certificates import Authority, RevokedCertificate, revocation_list
from pqsec_pki.credentials import (
    ALT_KEY,
    IDENTITY_CA,
    KEY,
    PERMISSIONS_CA,
    Credentials,
    TrustAnchors,
    certificates_in,
    distinct,
    identity_problems,
    verify_documents,
)
from pqsec_pki.documents import DomainSet, Governance
from pqsec_pki.errors import KeystoreError, MalformedError, VerificationError
from pqsec_pki.keystore import enclave_files
from pqsec_pki.problems import Code, Problem
from pqsec_pki.smime import Require, Signer, sign
from tests.unit.keystores import made

NOW = datetime(2026, 11, 21, 12, tzinfo=UTC)
DAY = timedelta(days=1)
DOCUMENT = Governance.protected(DomainSet.of(0)).to_xml()


def authority(name, kind="ecdsa-p256", *, days=100):
    return Authority.create(name, SIGNATURES.named(kind), now=NOW, validity=days * DAY)


def issued(ca, name="/talker"):
    key = SIGNATURES.named("ecdsa-p256").generate().public_key
    return ca.issue(name, key, now=NOW, validity=DAY)


@pytest.fixture(scope="module")
def identity():
    return authority("Identity CA", days=10)


@pytest.fixture(scope="module")
def permissions():
    return authority("Permissions CA", days=20)


def anchors(permissions, *identities, **more):
    found = tuple(each.certificate for each in identities)
    return TrustAnchors(identity_cas=found, permissions_ca=permissions.certificate, **more)


def signed(ca, countersigner=None):
    both = [Signer(each.certificate, each.key) for each in (ca, countersigner) if each]
    return sign(DOCUMENT, both[0], countersigner=(*both, None)[1], now=NOW)


@pytest.mark.parametrize("read", ["governance", "verified"])
def test_who_signs_must_be_good_now_and_the_identity_ca_need_not(identity, permissions, read):
    trusted, message = anchors(permissions, identity), signed(permissions)
    accepted = getattr(trusted, read)

    assert accepted(message, NOW)
    assert [each.subject for each in trusted.problems(NOW + 15 * DAY)] == [IDENTITY_CA]
    assert accepted(message, NOW + 15 * DAY)
    with pytest.raises(VerificationError) as refusal:
        accepted(message, NOW + 25 * DAY)
    [problem] = refusal.value.problems
    assert problem.subject == PERMISSIONS_CA
    assert trusted.signed_governance(message)  # where nobody asks when


def test_in_an_overlap_each_identity_ca_vouches_for_those_it_issued(identity, permissions):
    new = authority("New Identity CA")
    trusted = anchors(permissions, identity, new)

    for ca in (identity, new):
        certificate = issued(ca)
        assert trusted.issuer_of(certificate) == ca.certificate
        assert list(trusted.identity_problems(certificate, NOW)) == []
    stranger = issued(authority("New Identity CA"))
    assert trusted.issuer_of(stranger) == identity.certificate
    [problem, *_] = trusted.identity_problems(stranger, NOW)
    assert problem.code is Code.WRONG_ISSUER


def test_two_identity_cas_of_one_name_each_vouch_for_their_own(identity, permissions):
    namesake = authority("Identity CA")
    trusted = anchors(permissions, identity, namesake)

    for ca in (identity, namesake):
        assert list(trusted.identity_problems(issued(ca), NOW)) == []


def test_beside_a_revocation_list_only_its_issuer_counts(identity, permissions):
    new, peer = authority("New Identity CA"), issued(identity)
    revoked = [RevokedCertificate(peer.serial_number, NOW, None)]
    lists = [
        revocation_list(identity, each, number=1, now=NOW, validity=DAY) for each in ([], revoked)
    ]
    trusted, strict = (anchors(permissions, identity, new, revocation_list=each) for each in lists)

    assert list(trusted.identity_problems(peer, NOW)) == []
    assert [each.code for each in strict.identity_problems(peer, NOW)] == [Code.REVOKED]
    assert list(trusted.identity_problems(issued(new), NOW))


def test_what_a_document_must_be_signed_with(identity, permissions):
    quantum, hybrid = authority("PQ", "ml-dsa-44"), authority("Hybrid", "mldsa65+p256")
    both = twice(SIGNATURES.named("ml-dsa-44"))

    assert anchors(permissions, identity).required is Require.CLASSICAL
    assert anchors(permissions).required is Require.CLASSICAL
    assert anchors(quantum, identity).required is Require.PQ
    assert anchors(hybrid, identity).required is Require.BOTH
    assert (
        anchors(permissions, identity, countersigner=quantum.certificate).required is Require.BOTH
    )
    assert anchors(permissions, both).required is Require.BOTH
    assert anchors(permissions, identity, both).required is Require.CLASSICAL  # the first says
    assert anchors(permissions, both, stock_peers=True).required is Require.CLASSICAL


@pytest.mark.parametrize("remembers_all", [False, True])
def test_a_hybrid_ca_alone_does_not_sign_for_the_countersigner(identity, remembers_all):
    """Its signature is classical and post-quantum, and the countersigner is demanded by name."""
    hybrid, counter = authority("Hybrid", "mldsa65+p256"), authority("PQ", "ml-dsa-44")
    named = {"countersigner": counter.certificate, "remembers_all": remembers_all}
    trusted = anchors(hybrid, identity, **named)
    alone = signed(hybrid)
    for read in (trusted.signed, trusted.signed_governance, partial(trusted.governance, now=NOW)):
        with pytest.raises(VerificationError, match="there is no countersignature by CN=PQ"):
            read(alone)
    assert trusted.signed_governance(signed(hybrid, counter)).verified.signatures[1:]
    assert trusted.signed(alone, Require.BOTH).document  # the user says what is demanded


def test_a_file_of_a_ca_has_nothing_else():
    """A traditional key under a passphrase is no value to be read, and another reader minds it."""
    ca = authority("CA").certificate.pem
    key = ec.generate_private_key(ec.SECP256R1())
    form, secret = PrivateFormat.TraditionalOpenSSL, BestAvailableEncryption(b"secret")
    kept = key.private_bytes(Encoding.PEM, form, secret)
    assert b"Proc-Type" in kept
    for file in (ca + kept, kept + ca, ca + kept + ca):
        with pytest.raises(MalformedError, match=r"ca\.pem: not certificates in PEM, and nothing"):
            certificates_in(file, "ca.pem")


def test_a_certificate_of_a_cut_file_is_not_taken():
    pem = authority("CA").certificate.pem
    assert len(certificates_in(pem + pem, "ca.pem")) == 2
    for broken in (b"", pem + b"-----BEGIN CERTIFICATE-----\n", pem + pem[:-30]):
        with pytest.raises(MalformedError, match=r"ca\.pem"):
            certificates_in(broken, "ca.pem")


def twice(second):
    """An identity CA whose alternative key is of that kind, or is that key itself."""
    return Authority.create(
        "Twice", SIGNATURES.named("ecdsa-p256"), alternative=second, now=NOW, validity=DAY
    )


def test_a_ca_of_two_kinds_in_one_key_needs_no_countersigner(permissions):
    both = twice(SIGNATURES.named("ml-dsa-44"))

    assert anchors(authority("Hybrid", "mldsa65+p256"), both).problems(NOW) == ()
    [problem] = anchors(permissions, both).problems(NOW)
    assert problem.code is Code.COUNTERSIGNER_MISSING


def test_an_alternative_key_may_not_have_another_role(permissions):
    quantum = authority("PQ", "ml-dsa-44")

    @dataclass
    class SameKey:
        def generate(self):
            return quantum.key

    trusted = anchors(permissions, twice(SameKey()), countersigner=quantum.certificate)
    [problem] = trusted.problems(NOW)
    assert problem.code is Code.ONE_KEY_TWO_ROLES


def test_credentials_of_a_robot_have_no_key_here(tmp_path):
    keystore = made(tmp_path / "k", "classical")
    files = enclave_files(keystore.root, "/talker")
    credentials = Credentials.of("/talker", {k: v for k, v in files.items() if k != KEY})

    assert Credentials.of("/talker", files).key
    with pytest.raises(KeystoreError, match="not here but on its robot"):
        _ = credentials.key


def test_an_alternative_key_is_missed_where_the_first_one_is_here(tmp_path):
    files = enclave_files(made(tmp_path / "k", "transition").root, "/talker")

    def problems(*left_out):
        kept = {name: data for name, data in files.items() if name not in left_out}
        return list(identity_problems(Credentials.of("/talker", kept), NOW))

    assert problems() == problems(KEY, ALT_KEY) == []
    [missed] = problems(ALT_KEY)
    assert (missed.code, missed.subject) == (Code.KEY_MISMATCH, ALT_KEY)


def test_documents_of_cas_that_cannot_be_trusted_are_refused_though_their_signatures_hold(tmp_path):
    """The plugin asks about a peer's documents alone, without its identity."""
    keystore = made(tmp_path / "k", "classical")
    credentials = Credentials.of("/talker", enclave_files(keystore.root, "/talker"))

    def verified(anchors):
        return verify_documents(
            credentials.certificate,
            anchors,
            governance=credentials.governance,
            permissions=credentials.permissions,
            now=NOW,
        )

    own = credentials.anchors
    assert verified(own).grant.subject_name == "CN=/talker"
    with pytest.raises(VerificationError) as refusal:
        verified(replace(own, identity_cas=(own.permissions_ca,)))
    assert [each.code for each in refusal.value.problems] == [Code.ONE_KEY_TWO_ROLES]


def test_a_problem_that_two_steps_found_is_told_once_with_its_file():
    placed = Problem("it has ended", Code.EXPIRED, subject="cert.pem")
    bare, other = Problem("it has ended", Code.EXPIRED), Problem("unknown", Code.EXPIRED)
    assert distinct([bare, placed, placed, other]) == [placed, other]
