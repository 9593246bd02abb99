"""Cyclone DDS takes what we make for it, and refuses what was tampered with.

Its own plugins judge: authentication reads the certificates and shakes hands, access
control reads the signed documents.
"""

from contextlib import ExitStack, contextmanager
from datetime import timedelta

import pytest

from pqsec_pki.algorithms import SIGNATURES, load_private_key, private_key_pem
from pqsec_pki.certificates import Certificate
from pqsec_pki.documents import DomainSet
from tests.interop.conftest import DOMAINS, NOT_STOCK, STOCK, permissions_of
from tests.interop.cyclone import RefusedError, participant

pytestmark = pytest.mark.interop

DOMAIN = 0

# dds_security_api_err.h and, for 200, a plugin's own words
UNKNOWN_ALGORITHM, DOCUMENT, OTHER = 125, 127, 200
DOMAIN_NOT_FOUND, DENIED, SUBJECT, EXPIRED, NOT_YET_VALID = 141, 145, 146, 147, 148


@contextmanager
def refused(code, words=None):
    """What is inside must be refused by a plugin, with this code."""
    with pytest.raises(RefusedError, match=words) as refusal:
        yield
    assert refusal.value.code == code, refusal.value


@pytest.fixture
def joins(plugins, enclave):
    """joins(folder, {file: content}) starts a participant; RefusedError if it may not."""

    def join(folder, replaced=None, *, domain=DOMAIN, passphrase=""):
        files = enclave(folder, replaced or {})
        with participant(plugins, files, passphrase=passphrase) as one:
            one.join(domain)

    return join


@pytest.mark.parametrize("profile", STOCK)
def test_a_participant_joins_with_our_files(labs, joins, profile):
    joins(labs(profile).alice)


@pytest.mark.parametrize("profile", STOCK)
def test_a_participant_joins_with_an_encrypted_key(labs, joins, profile):
    folder = labs(profile).alice
    key = load_private_key((folder / "key.pem").read_bytes())
    encrypted = {"key.pem": private_key_pem(key, b"corr\xc3\xa9ct horse")}

    joins(folder, encrypted, passphrase="corréct horse")
    with refused(OTHER, "Failed to parse certificate"):
        joins(folder, encrypted, passphrase="wrong")


@pytest.mark.parametrize("profile", STOCK)
def test_the_identity_token_names_algorithms_as_we_do(labs, plugins, profile):
    folder = labs(profile).alice
    certificate = Certificate.from_pem((folder / "cert.pem").read_bytes())
    with participant(plugins, folder) as alice:
        token = dict(alice.identity_token.properties)
    assert token["dds.cert.algo"] == certificate.public_key.algorithm.token_name
    assert token["dds.ca.algo"] == certificate.public_key.algorithm.token_name


@pytest.mark.parametrize("profile", NOT_STOCK)
def test_an_identity_without_a_classical_key_is_refused_as_documented(labs, joins, profile):
    with refused(UNKNOWN_ALGORITHM, "validate_local_identity"):
        joins(labs(profile).alice)


@pytest.mark.parametrize("algorithm", ["ecdsa-p384", "rsa-3072"])
def test_an_identity_that_the_table_denies_to_stock_stacks_is_refused(labs, joins, now, algorithm):
    lab, key = labs("classical"), SIGNATURES.named(algorithm).generate()
    certificate = lab.authorities.identity.issue(
        "/lab/alice", key.public_key, now=now, validity=timedelta(days=1)
    )
    with refused(UNKNOWN_ALGORITHM):
        joins(lab.alice, {"cert.pem": certificate.pem, "key.pem": private_key_pem(key)})


@pytest.mark.parametrize("profile", STOCK)
def test_a_certificate_of_a_ca_with_the_same_name_is_refused(labs, other_labs, joins, profile):
    theirs = other_labs(profile).alice
    stolen = {name: (theirs / name).read_bytes() for name in ("cert.pem", "key.pem")}
    with refused(OTHER, "Certificate not valid"):
        joins(labs(profile).alice, stolen)


ALTERED = {
    "governance.p7s": (
        b"<allow_unauthenticated_participants>false",
        b"<allow_unauthenticated_participants>true",
    ),
    "permissions.p7s": (b"<topic>rt/chatter</topic>", b"<topic>*</topic>"),
}


def altered(folder, file):
    """The signed document, changed after that."""
    signed = (folder / file).read_bytes()
    changed = signed.replace(*ALTERED[file])
    assert changed != signed
    return {file: changed}


@pytest.mark.parametrize("file", ALTERED)
@pytest.mark.parametrize("profile", STOCK)
def test_an_altered_document_is_refused(labs, joins, profile, file):
    folder = labs(profile).alice
    with refused(DOCUMENT, "digest failure"):
        joins(folder, altered(folder, file))


@pytest.mark.parametrize("file", ALTERED)
@pytest.mark.parametrize("profile", STOCK)
def test_a_document_of_another_permissions_ca_is_refused(labs, other_labs, joins, profile, file):
    foreign = (other_labs(profile).alice / file).read_bytes()
    with refused(DOCUMENT, "certificate verify error"):
        joins(labs(profile).alice, {file: foreign})


@pytest.mark.parametrize("profile", NOT_STOCK)
def test_documents_without_a_classical_signature_are_refused_as_documented(labs, joins, profile):
    names = ("permissions_ca.cert.pem", "governance.p7s", "permissions.p7s")
    files = {name: (labs(profile).alice / name).read_bytes() for name in names}
    with refused(DOCUMENT):
        joins(labs("classical").alice, files)


@pytest.mark.parametrize("profile", STOCK)
def test_the_permissions_of_another_participant_are_refused(labs, joins, profile):
    lab = labs(profile)
    bobs = (lab.bob / "permissions.p7s").read_bytes()
    with refused(SUBJECT):
        joins(lab.alice, {"permissions.p7s": bobs})


@pytest.mark.parametrize("profile", STOCK)
def test_an_expired_grant_is_refused(labs, joins, now, profile):
    lab = labs(profile)
    expired = lab.sign(permissions_of("/lab/alice", now - timedelta(days=60)))
    with refused(EXPIRED):
        joins(lab.alice, {"permissions.p7s": expired})


@pytest.mark.parametrize("profile", STOCK)
def test_a_grant_that_has_not_begun_is_refused(labs, joins, now, profile):
    lab = labs(profile)
    early = lab.sign(permissions_of("/lab/alice", now + timedelta(days=60)))
    with refused(NOT_YET_VALID):
        joins(lab.alice, {"permissions.p7s": early})


@pytest.mark.parametrize("profile", STOCK)
def test_an_unsigned_document_is_refused(labs, joins, now, profile):
    unsigned = permissions_of("/lab/alice", now)
    with refused(DOCUMENT, "no content type"):
        joins(labs(profile).alice, {"permissions.p7s": unsigned})


@pytest.mark.parametrize("profile", STOCK)
def test_permissions_for_another_domain_are_refused(labs, joins, now, profile):
    lab = labs(profile)
    elsewhere = permissions_of("/lab/alice", now, domains=DomainSet.of(10))
    files = {"permissions.p7s": lab.sign(elsewhere)}
    joins(lab.alice, files, domain=10)
    with refused(DENIED):
        joins(lab.alice, files)


@pytest.mark.parametrize("domain", [0, 5, 10])
def test_every_domain_of_a_range_is_open(labs, joins, domain):
    assert domain in DOMAINS
    joins(labs("transition").alice, domain=domain)


def test_a_domain_outside_the_range_is_closed(labs, joins):
    with refused(DOMAIN_NOT_FOUND):
        joins(labs("transition").alice, domain=11)


@pytest.fixture
def meet(plugins):
    """meet(folder, folder, ...) gives two participants that joined and know each other.

    As ((participant, meeting, credential), ...), the one who begins the handshake first.
    """
    with ExitStack() as stack:

        def start(first, second, *, optional=True):
            a, b = (
                stack.enter_context(participant(plugins, folder, optional=optional))
                for folder in (first, second)
            )
            shown_by_a, shown_by_b = a.join(DOMAIN), b.join(DOMAIN)
            a.show(*shown_by_a)
            b.show(*shown_by_b)
            of_b = a.meet(b.guid, b.identity_token)
            of_a = b.meet(a.guid, a.identity_token, of_b.auth_request)
            sides = (a, of_b, shown_by_a), (b, of_a, shown_by_b)
            return sides if of_b.begins else sides[::-1]

        yield start


def shake_hands(initiator, met_by_initiator, replier, met_by_replier):
    """The handles of both sides' finished handshakes, and the messages."""
    begun, request = initiator.request(met_by_initiator)
    answered, reply = replier.reply(met_by_replier, request)
    final = initiator.process(begun, reply)
    assert final is not None
    assert replier.process(answered, final) is None
    return begun, answered, (request, reply, final)


@pytest.mark.parametrize("optional", [True, False], ids=["all fields", "mandatory fields"])
@pytest.mark.parametrize("profile", STOCK)
def test_two_participants_shake_hands_and_admit_each_other(labs, meet, profile, optional):
    lab = labs(profile)
    sides = meet(lab.alice, lab.bob, optional=optional)
    (initiator, of_replier, shown), (replier, of_initiator, shown_back) = sides
    begun, answered, messages = shake_hands(initiator, of_replier, replier, of_initiator)

    assert initiator.secret(begun) == replier.secret(answered)
    assert len(initiator.secret(begun).secret) == 32
    initiator.admit(of_replier, begun, shown_back[1])
    replier.admit(of_initiator, answered, shown[1])
    wire_name = lab.keystore.profile.participant_key.wire_name
    for message in messages[:2]:
        assert dict(message.binary)["c.dsign_algo"].rstrip(b"\0").decode() == wire_name


@pytest.mark.parametrize("profile", STOCK)
def test_a_peer_of_another_identity_ca_is_refused(labs, other_labs, meet, profile):
    first, second = meet(labs(profile).alice, other_labs(profile).bob)
    (initiator, of_replier, _), (replier, of_initiator, _) = first, second
    _, request = initiator.request(of_replier)
    with refused(OTHER, "begin_handshake_reply"):
        replier.reply(of_initiator, request)


@pytest.mark.parametrize("profile", STOCK)
def test_a_peer_that_shows_the_permissions_of_another_is_not_admitted(labs, meet, profile):
    lab = labs(profile)
    first, second = meet(lab.alice, lab.bob)
    (initiator, of_replier, shown), (replier, of_initiator, shown_back) = first, second
    initiator.show(*shown_back)
    _, answered, _ = shake_hands(initiator, of_replier, replier, of_initiator)
    with refused(SUBJECT):
        replier.admit(of_initiator, answered, shown[1])


@pytest.mark.parametrize("field", ["c.id", "c.perm", "dh2", "challenge1", "signature"])
def test_a_changed_handshake_reply_is_refused(labs, meet, field):
    lab = labs("transition")
    first, second = meet(lab.alice, lab.bob)
    (initiator, of_replier, _), (replier, of_initiator, _) = first, second
    begun, request = initiator.request(of_replier)
    _, reply = replier.reply(of_initiator, request)
    changed = tuple(
        (name, value[:-9] + bytes([value[-9] ^ 1]) + value[-8:] if name == field else value)
        for name, value in reply.binary
    )
    assert changed != reply.binary
    with refused(OTHER, "process_handshake"):
        initiator.process(begun, reply._replace(binary=changed))
