"""Fast DDS takes what we make for it, and refuses what was tampered with.

Its own plugins judge. And they meet Cyclone DDS's: what fails there fails without us.
"""

from contextlib import ExitStack
from datetime import timedelta
from functools import partial

import pytest

from pqsec_pki.algorithms import load_private_key, private_key_pem
from pqsec_pki.certificates import Certificate
from pqsec_pki.documents import DomainSet
from pqsec_pki.handshake import IdentityToken
from tests.interop.conftest import DOMAINS, NOT_STOCK, STOCK, permissions_of
from tests.interop.credentials import enrolled
from tests.interop.cyclone import participant as cyclone_participant
from tests.interop.der import Der
from tests.interop.fastdds import participant as fastdds_participant
from tests.interop.fastdds_meeting import refused
from tests.interop.test_cyclone import ALTERED, altered, shake_hands

pytestmark = pytest.mark.interop

DOMAIN = 0
ECDSA, RSA = "ECDSA-SHA256", "RSASSA-PSS-SHA256"
SILENCE = " (code 1)"


refused_identity = partial(refused, "validate_local_identity")
refused_documents = partial(refused, "validate_local_permissions")


@pytest.fixture
def joins(fastdds, enclave):
    """joins(folder, {file: content}) starts a participant; RefusedError if it may not."""

    def join(folder, replaced=None, *, domain=DOMAIN, passphrase=""):
        files = enclave(folder, replaced or {})
        with fastdds_participant(fastdds, files, passphrase=passphrase) as one:
            one.join(domain)
            return dict(one.identity_token.properties)

    return join


@pytest.mark.parametrize("profile", STOCK)
def test_a_participant_joins_with_our_files(labs, joins, profile):
    folder = labs(profile).alice
    said = joins(folder)
    certificate, ca = (
        Certificate.from_pem((folder / name).read_bytes())
        for name in ("cert.pem", "identity_ca.cert.pem")
    )
    ours = dict(IdentityToken.of(certificate, ca).to_holder().properties)
    # Not the names of keys that DDS-Security 1.1 has for these two (9.3.2.1, table 45).
    name = certificate.public_key.algorithm.wire_name
    assert said == ours | {"dds.cert.algo": name, "dds.ca.algo": name}


def test_a_participant_joins_with_an_encrypted_key(labs, joins):
    folder = labs("transition").alice
    key = load_private_key((folder / "key.pem").read_bytes())
    encrypted = {"key.pem": private_key_pem(key, b"corr\xc3\xa9ct horse")}

    joins(folder, encrypted, passphrase="corréct horse")
    with refused_identity("Error obtaining private key"):
        joins(folder, encrypted, passphrase="wrong")


@pytest.mark.parametrize("profile", NOT_STOCK)
def test_an_identity_without_a_classical_key_is_refused_as_documented(labs, joins, profile):
    with refused_identity(SILENCE):
        joins(labs(profile).alice)


@pytest.mark.parametrize("profile", STOCK)
def test_a_certificate_of_a_ca_with_the_same_name_is_refused(labs, other_labs, joins, profile):
    theirs = other_labs(profile).alice
    stolen = {name: (theirs / name).read_bytes() for name in ("cert.pem", "key.pem")}
    words = "Invalidation error of certificate  (unable to get local issuer certificate)"
    with refused_identity(words):
        joins(labs(profile).alice, stolen)


TAKEN = {
    ("ecdsa-p256", "ecdsa-p384"): ECDSA,
    ("ecdsa-p256", "rsa-2048"): ECDSA,
    ("ecdsa-p256", "rsa-3072"): ECDSA,
    ("rsa-2048", "ecdsa-p256"): RSA,
    ("rsa-3072", "ecdsa-p384"): RSA,
    ("rsa-4096", "rsa-3072"): RSA,
}
"""What a participant's key is called whose CA has the first kind of key, and it the second."""
UNKNOWN_KEY = "Invalidation error of certificate  (unspecified certificate verification error)"
NOT_TAKEN = {
    # It knows certificates by how they are signed, and ECDSA with SHA-256 alone.
    ("ecdsa-p384", "ecdsa-p256"): SILENCE,
    ("ecdsa-p384", "ecdsa-p384"): SILENCE,
    ("ml-dsa-65", "ecdsa-p256"): SILENCE,
    # OpenSSL 3.0 does not know the key.
    ("ecdsa-p256", "ml-dsa-65"): UNKNOWN_KEY,
    ("rsa-2048", "ml-dsa-65"): UNKNOWN_KEY,
}


@pytest.mark.slow(but=2)
@pytest.mark.parametrize("kinds", TAKEN, ids=" for ".join)
def test_two_participants_whose_ca_has_another_kind_of_key_agree(labs, enclave, meet, now, kinds):
    lab = labs("classical")
    folders = map(enclave, (lab.alice, lab.bob), enrolled(*kinds, now, "alice", "bob"))
    (first, of_second, _), (second, of_first, _) = meet(*(("fastdds", each) for each in folders))
    begun, answered, messages = shake_hands(first, of_second, second, of_first)

    assert first.secret(begun) == second.secret(answered)
    assert dict(first.identity_token.properties)["dds.cert.algo"] == TAKEN[kinds]
    for message in messages[:2]:
        assert dict(message.binary)["c.dsign_algo"].decode() == TAKEN[kinds]


@pytest.mark.parametrize("kinds", NOT_TAKEN, ids=" for ".join)
def test_an_identity_that_the_table_denies_to_fastdds_is_refused(labs, joins, now, kinds):
    (files,) = enrolled(*kinds, now, "alice")
    with refused_identity(NOT_TAKEN[kinds]):
        joins(labs("classical").alice, files)


@pytest.mark.parametrize("file", ALTERED)
@pytest.mark.parametrize("profile", STOCK)
def test_an_altered_document_is_refused(labs, joins, profile, file):
    folder = labs(profile).alice
    with refused_documents("Failed verification of the file"):
        joins(folder, altered(folder, file))


@pytest.mark.parametrize("file", ALTERED)
@pytest.mark.parametrize("profile", STOCK)
def test_a_document_of_another_permissions_ca_is_refused(labs, other_labs, joins, profile, file):
    foreign = (other_labs(profile).alice / file).read_bytes()
    with refused_documents("Failed verification of the file"):
        joins(labs(profile).alice, {file: foreign})


@pytest.mark.parametrize("profile", NOT_STOCK)
def test_documents_without_a_classical_signature_are_refused_as_documented(labs, joins, profile):
    names = ("permissions_ca.cert.pem", "governance.p7s", "permissions.p7s")
    files = {name: (labs(profile).alice / name).read_bytes() for name in names}
    with refused_documents(SILENCE):
        joins(labs("classical").alice, files)


def test_an_unsigned_document_is_refused(labs, joins, now):
    unsigned = permissions_of("/lab/alice", now)
    with refused_documents("Cannot read as PKCS7 the file"):
        joins(labs("transition").alice, {"permissions.p7s": unsigned})


MONTHS = timedelta(days=60)
NO_GRANT = {
    "for another": lambda now: permissions_of("/lab/bob", now),
    "expired": lambda now: permissions_of("/lab/alice", now - MONTHS),
    "not yet valid": lambda now: permissions_of("/lab/alice", now + MONTHS),
}


@pytest.mark.parametrize("flaw", NO_GRANT)
def test_permissions_without_a_grant_of_now_are_refused(labs, joins, now, flaw):
    lab = labs("transition")
    signed = lab.sign(NO_GRANT[flaw](now))
    with refused_documents("Not found the identity subject name in permissions file"):
        joins(lab.alice, {"permissions.p7s": signed})


def test_fastdds_itself_joins_domains_that_its_documents_do_not_name(labs, joins, now):
    """2.9.1 drops the rules of other domains from a copy that it does not use."""
    lab = labs("transition")
    elsewhere = lab.sign(permissions_of("/lab/alice", now, domains=DomainSet.of(10)))
    joins(lab.alice, {"permissions.p7s": elsewhere}, domain=0)
    assert 11 not in DOMAINS
    joins(lab.alice, domain=11)


@pytest.fixture
def stacks(plugins, fastdds):
    """stacks["cyclone"](folder) is a participant of that stack."""
    return {
        "cyclone": partial(cyclone_participant, plugins),
        "fastdds": partial(fastdds_participant, fastdds),
    }


@pytest.fixture
def meet(stacks):
    """meet((stack, folder), (stack, folder)) lets two join and hear of each other.

    As ((participant, meeting, credential), ...), the one who begins the handshake first.
    """
    with ExitStack() as stack:

        def start(*both):
            a, b = (stack.enter_context(stacks[name](folder)) for name, folder in both)
            shown = {each: each.join(DOMAIN) for each in (a, b)}
            for each in (a, b):
                each.show(*shown[each])
            of_b = a.meet(b.guid, b.identity_token)
            of_a = b.meet(a.guid, a.identity_token, of_b.auth_request)
            assert of_a.begins != of_b.begins
            sides = (a, of_b, shown[a]), (b, of_a, shown[b])
            return sides if of_b.begins else sides[::-1]

        yield start


@pytest.mark.parametrize("profile", STOCK)
def test_cyclone_begins_with_fastdds_and_both_agree(labs, meet, profile):
    lab = labs(profile)
    first, second = meet(("cyclone", lab.bob), ("fastdds", lab.alice))
    (cyclone, of_fastdds, shown), (fastdds, of_cyclone, shown_back) = first, second
    begun, answered, _ = shake_hands(cyclone, of_fastdds, fastdds, of_cyclone)

    assert cyclone.secret(begun) == fastdds.secret(answered)
    cyclone.admit(of_fastdds, begun, shown_back[1])
    fastdds.admit(of_cyclone, answered, shown[1])


@pytest.mark.parametrize("kinds", [("rsa-2048", "ecdsa-p256"), ("ecdsa-p256", "rsa-2048")])
def test_cyclone_does_not_mind_what_fastdds_calls_its_key(labs, enclave, meet, now, kinds):
    lab = labs("classical")
    bob, alice = map(enclave, (lab.bob, lab.alice), enrolled(*kinds, now, "bob", "alice"))
    first, second = meet(("cyclone", bob), ("fastdds", alice))
    (cyclone, of_fastdds, _), (fastdds, of_cyclone, _) = first, second
    begun, answered, (request, reply, _) = shake_hands(cyclone, of_fastdds, fastdds, of_cyclone)

    assert cyclone.secret(begun) == fastdds.secret(answered)
    names = [dict(each.binary)["c.dsign_algo"].rstrip(b"\0") for each in (request, reply)]
    assert sorted(names) == [ECDSA.encode(), RSA.encode()]


@pytest.mark.parametrize("profile", STOCK)
def test_fastdds_begins_with_cyclone_and_neither_understands_the_other(labs, meet, profile):
    lab = labs(profile)
    first, second = meet(("cyclone", lab.alice), ("fastdds", lab.bob))
    (fastdds, of_cyclone, _), (cyclone, of_fastdds, _) = first, second
    begun, request = fastdds.request(of_cyclone)
    with refused("begin_handshake_reply", "Failed to convert octet sequence to ASN1 integer"):
        cyclone.reply(of_fastdds, request)

    # Were dh1 the DER INTEGER that Cyclone DDS reads, it would not help.
    y = int.from_bytes(dict(request.binary)["dh1"])
    dh1 = Der.of(0x02, y.to_bytes(y.bit_length() // 8 + 1))
    _, reply = cyclone.reply(of_fastdds, changed(request, dh1=dh1))
    name = dict(reply.binary)["c.dsign_algo"].decode()
    assert name.endswith("\0")
    with refused("process_handshake", f"Not supported signature algorithm ({name})"):
        fastdds.process(begun, reply)


def changed(message, **values):
    binary = tuple((name, values.get(name, value)) for name, value in message.binary)
    return message._replace(binary=binary)
