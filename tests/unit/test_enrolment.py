"""Requests that may be answered, and bundles that hold: each flaw is seen, and named."""

import json
import stat
from dataclasses import replace

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding

from pqsec_pki.algorithms import (
    PROFILES,
    SIGNATURES,
    SealingPrivateKey,
    SealingPublicKey,
    profile_named,
)
from pqsec_pki.certificates import (
    Authority,
    Certificate,
    CertificateRequest,
    certificate_request,
    revocation_list,
)
from pqsec_pki.credentials import IDENTITY_CA, PERMISSIONS_ALT_CA
from pqsec_pki.documents import DomainSet, Grant, Permissions
from pqsec_pki.enrolment import (
    Bundle,
    is_sealed,
    open_sealed,
    request,
    seal,
    tarball,
    validate_csrs,
    verify_bundle,
)
from pqsec_pki.enrolment.archive import Archive
from pqsec_pki.enrolment.csr_validation import NAMELESS
from pqsec_pki.errors import (
    ExistsError,
    FileError,
    KeystoreError,
    MalformedError,
    PqsecError,
    UsageError,
    VerificationError,
)
from pqsec_pki.keystore import Authorities, Keystore, audit, enclave_files
from pqsec_pki.lifecycle import ParticipantSpec, Renewal, issue, renew, revoke
from tests.some_keys import some_key
from tests.unit.enrolling import DAY, ROBOT, answered, asked_of, with_files
from tests.unit.keystores import made
from tests.unit.killing import NOW, YEAR


@pytest.fixture(scope="module")
def keystores(tmp_path_factory):
    """keystores("pq") is that profile's; keystores("pq", "other") is another with that name."""
    found = {}

    def keystore(profile="transition", label="ours"):
        if (profile, label) not in found:
            root = tmp_path_factory.mktemp(profile) / label
            found[profile, label] = made(root, profile, names=("/listener",))
        return found[profile, label]

    return keystore


@pytest.fixture(scope="module")
def good(keystores, tmp_path_factory):
    """A bundle that holds, of profile transition."""
    return answered(keystores(), asked_of(keystores(), tmp_path_factory.mktemp("robot")))


@pytest.fixture(scope="module")
def foreign(keystores, tmp_path_factory):
    """A bundle for the same name, of somebody else's CAs."""
    other = keystores(label="other")
    return answered(other, asked_of(other, tmp_path_factory.mktemp("stranger")))


def signed_request(name=ROBOT, profile=PROFILES[0]):
    key, second = profile.participant_key.generate(), profile.alternative_key
    return certificate_request(name, key, second.generate() if second else None)


# On the robot


@pytest.mark.parametrize("profile", PROFILES, ids=lambda each: each.name)
def test_a_request_leaves_keys_for_their_owner_only_and_proves_that_they_are_there(
    tmp_path, profile
):
    found = request("fleet//robot1/", profile, tmp_path / "robot")
    assert found.name == found.request.common_name == ROBOT
    found.request.verify()
    folder = found.path.parent
    modes = {each.name: stat.S_IMODE(each.stat().st_mode) for each in folder.iterdir()}
    keys = {"key.pem": 0o600} | ({"alt.key.pem": 0o600} if profile.alternative_key else {})
    assert modes == keys | {"request.csr": 0o644}
    assert {stat.S_IMODE(each.stat().st_mode) for each in (folder, tmp_path / "robot")} == {0o700}
    assert (
        validate_csrs([found.request], [profile], names=[ROBOT])[ROBOT].key.spki
        == found.request.spki
    )


def test_a_second_request_takes_nobodys_keys_away_unless_told(tmp_path):
    first = request(ROBOT, PROFILES[0], tmp_path)
    before = {each: each.read_bytes() for each in first.path.parent.iterdir()}
    with pytest.raises(ExistsError, match=r"fleet\+robot1 exists"):
        request(ROBOT, PROFILES[0], tmp_path)
    assert {each: each.read_bytes() for each in first.path.parent.iterdir()} == before
    again = request(ROBOT, PROFILES[0], tmp_path, force=True)
    assert again.path == first.path
    assert again.request.spki != first.request.spki
    assert {each.name for each in tmp_path.iterdir()} == {"requests"}


# Where the CAs are


@pytest.mark.parametrize(
    ("name", "choice"),
    [
        (ROBOT, {"names": [ROBOT]}),
        (ROBOT, {"names": ["fleet/robot1"]}),
        (ROBOT, {"patterns": ["/fleet/*"]}),
        (ROBOT, {"patterns": ["/other", "/*/robot?"]}),
        (ROBOT, {"names": [ROBOT], "patterns": ["/other"]}),
    ],
)
def test_a_request_whose_name_is_allowed_is_admitted(name, choice):
    asked = signed_request(name)
    assert validate_csrs([asked], PROFILES[:1], **choice)[name].request == asked.fingerprint


@pytest.mark.parametrize(
    ("name", "choice", "words"),
    [
        (ROBOT, {"names": ["/fleet/robot2"]}, "its name is not one of the allowed names"),
        (ROBOT, {"patterns": ["/fleet"]}, "not one of the allowed names: /fleet"),
        (ROBOT, {"patterns": ["/*"]}, "not one of the allowed names"),
        ("/fleet/sub/robot1", {"patterns": ["/fleet/*"]}, "not one of the allowed names"),
        ("/Fleet/robot1", {"patterns": ["/fleet/*"]}, "not one of the allowed names"),
        ("fleet/robot1", {"patterns": ["/fleet/*"]}, "not the CN of a participant alone"),
        ("/fleet//robot1", {"patterns": ["/fleet/*"]}, "not the CN of a participant alone"),
        ("/fleet/../admin", {"patterns": ["/fleet/*"]}, "not the CN of a participant alone"),
        ("/fleet/key.pem", {"patterns": ["/fleet/*"]}, "not the CN of a participant alone"),
        ("Fleet Robot", {"patterns": ["/*"]}, "not the CN of a participant alone"),
    ],
)
def test_a_request_with_a_name_that_is_not_allowed_is_refused(name, choice, words):
    with pytest.raises(VerificationError, match=words):
        validate_csrs([signed_request(name)], PROFILES[:1], **choice)


def test_a_request_may_not_choose_its_own_name():
    with pytest.raises(UsageError, match="must not choose its own name"):
        validate_csrs([signed_request()], PROFILES[:1])
    with pytest.raises(UsageError, match="begin with a slash"):
        validate_csrs([signed_request()], PROFILES[:1], patterns=["*"])


def test_requests_are_answered_once_each_and_all():
    asked = signed_request()
    with pytest.raises(VerificationError, match="2 requests are for /fleet/robot1"):
        validate_csrs([asked, signed_request()], PROFILES[:1], names=[ROBOT])
    with pytest.raises(VerificationError, match="no request is for /other"):
        validate_csrs([asked], PROFILES[:1], names=[ROBOT, "/other"])


def test_requests_without_a_name_are_each_told_and_not_taken_for_one_name_twice():
    with pytest.raises(VerificationError) as caught:
        validate_csrs(
            [signed_request("Fleet Robot"), signed_request("x y")], PROFILES[:1], names=[ROBOT]
        )
    assert [line.partition(": ")[2] for line in caught.value.lines[:2]] == [NAMELESS] * 2
    assert caught.value.lines[2:] == (f"no request is for {ROBOT}",)


@pytest.mark.parametrize("profile", PROFILES, ids=lambda each: each.name)
def test_a_request_with_keys_of_another_profile_is_refused(profile):
    for other in (each for each in PROFILES if each is not profile):
        with pytest.raises(VerificationError, match=f"; profile {profile.name} here has"):
            validate_csrs([signed_request(profile=other)], [profile], names=[ROBOT])


def test_a_request_whose_proof_is_not_its_keys_is_refused():
    asked, other = signed_request(), signed_request()
    bad = replace(asked, signature=other.signature)
    with pytest.raises(VerificationError, match="no proof that the requester has the private key"):
        validate_csrs([bad], PROFILES[:1], names=[ROBOT])
    bad = replace(asked, alternative=replace(asked.alternative, signature=bytes(3309)))
    with pytest.raises(VerificationError, match=r"no proof .* the alternative private key"):
        validate_csrs([bad], PROFILES[:1], names=[ROBOT])


def test_a_request_for_a_key_of_an_unknown_kind_is_refused():
    key = ec.generate_private_key(ec.SECP521R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, ROBOT)])
    made = x509.CertificateSigningRequestBuilder().subject_name(name).sign(key, hashes.SHA256())
    asked = CertificateRequest.from_der(made.public_bytes(Encoding.DER))
    with pytest.raises(VerificationError, match="no signature algorithm here is for"):
        validate_csrs([asked], PROFILES[:1], names=[ROBOT])


def test_a_request_with_more_than_a_name_is_refused():
    key = ec.generate_private_key(ec.SECP256R1())
    names = [
        x509.NameAttribute(x509.NameOID.COMMON_NAME, ROBOT),
        x509.NameAttribute(x509.NameOID.ORGANIZATION_NAME, "Lab"),
    ]
    for subject in (names, names[1:], [names[0], names[0]], []):
        builder = x509.CertificateSigningRequestBuilder().subject_name(x509.Name(subject))
        made = builder.sign(key, hashes.SHA256())
        asked = CertificateRequest.from_der(made.public_bytes(Encoding.DER))
        with pytest.raises(VerificationError, match="not the CN of a participant alone"):
            validate_csrs([asked], [profile_named("classical")], names=[ROBOT])


def test_every_flaw_of_every_request_is_told_at_once():
    first, second = signed_request("/a"), signed_request("/b", PROFILES[-1])
    bad = replace(first, signature=b"x")
    with pytest.raises(VerificationError) as caught:
        validate_csrs([bad, second], PROFILES[:1], names=["/a", "/c"])
    assert len(caught.value.lines) == 4


# Issuing for keys that are elsewhere


def test_what_is_issued_for_a_request_has_no_key_here_and_says_whose_it_is(keystores, tmp_path):
    keystore = keystores("pq")
    asked = asked_of(keystore, tmp_path)
    answered(keystore, asked)
    folder = keystore.root / f"enclaves{ROBOT}"
    assert not list(folder.glob("*key.pem"))
    assert CertificateRequest.from_pem((folder / "request.pem").read_bytes()).der == asked.der
    [line] = [each for each in keystore.ledger() if each.details.get("request")]
    assert line.details["request"] == asked.fingerprint
    audit(keystore)
    with pytest.raises(KeystoreError, match="its keys are on its robot"):
        keystore.participant(ROBOT)


def test_keys_that_were_made_here_go_when_a_request_is_answered_and_come_back(tmp_path):
    keystore = made(tmp_path / "k", "transition", names=(ROBOT,))
    folder = keystore.root / f"enclaves{ROBOT}"
    assert (folder / "key.pem").exists()
    answered(keystore, asked_of(keystore, tmp_path / "robot"))
    assert {each.name for each in folder.iterdir()} & {"key.pem", "alt.key.pem"} == set()
    spec = ParticipantSpec(name=ROBOT, domains=DomainSet.of(0), validity=YEAR)
    issue(keystore, keystore.unlock(None), [spec], now=NOW, force=True)
    assert not (folder / "request.pem").exists()
    one = keystore.participant(ROBOT)
    assert one.key.public_key.spki == one.certificate.spki


def test_a_renewal_keeps_the_keys_of_a_request(keystores, tmp_path):
    keystore = keystores("classical")
    asked = asked_of(keystore, tmp_path)
    answered(keystore, asked)
    renew(keystore, keystore.unlock(None), [ROBOT], Renewal(), now=NOW + DAY)
    bundle = Bundle.of(keystore, [ROBOT], now=NOW)
    certificate = Certificate.from_pem(bundle.enclaves[ROBOT]["cert.pem"])
    assert certificate.spki == asked.spki
    assert certificate.not_before == NOW
    assert not bundle.has_keys


# Bundles


def test_a_bundle_is_the_same_bytes_for_the_same_participant(keystores, good):
    again = Bundle.of(keystores(), [ROBOT], now=NOW)
    assert again.to_bytes() == good.to_bytes()
    assert Bundle.from_bytes(good.to_bytes()).sha256 == good.sha256


def test_a_bundle_says_in_its_manifest_what_it_holds(good):
    files = tarball.unpack(good.to_bytes())
    manifest = json.loads(files.pop("manifest.json"))
    assert manifest["kind"] == "bundle"
    assert manifest["names"] == [ROBOT]
    assert manifest["created"] == NOW.isoformat()
    assert manifest["ca_sha256"] == list(good.fingerprints)
    assert set(manifest["files"]) == set(files)


@pytest.mark.parametrize("profile", PROFILES, ids=lambda each: each.name)
def test_a_bundle_never_holds_a_key_of_a_ca(keystores, profile):
    keystore = keystores(profile.name)
    bundle = Bundle.of(keystore, ["/listener"], now=NOW)
    assert bundle.has_keys
    content = b"".join(tarball.unpack(bundle.to_bytes()).values())
    for key in (keystore.root / "private").glob("*.pem"):
        secret = b"".join(key.read_bytes().splitlines()[1:-1])
        assert secret not in content.replace(b"\n", b"")
    own = (keystore.root / "enclaves/listener/key.pem").read_bytes()
    assert own in content
    assert not Bundle.of(keystore, ["/listener"], now=NOW, keys=False).has_keys


def test_a_bundle_for_nobody_or_for_who_is_not_there_is_refused(keystores):
    with pytest.raises(UsageError, match="at least one"):
        Bundle.of(keystores(), [], now=NOW)
    with pytest.raises(KeystoreError, match="no participant /nobody"):
        Bundle.of(keystores(), ["/nobody"], now=NOW)


@pytest.mark.parametrize(
    ("names", "path", "words"),
    [
        (
            [ROBOT],
            "enclaves/fleet/robot1/identity_ca.key.pem",
            "a bundle must not contain enclaves",
        ),
        ([ROBOT], "private/key.pem", "a bundle must not contain private"),
        ([ROBOT], "enclaves/other/cert.pem", "a bundle must not contain enclaves/other"),
        ([ROBOT], "enclaves/cert.pem", "a bundle must not contain enclaves/cert.pem"),
        ([ROBOT, "/other"], None, "lacks cert.pem, .* of /other"),
        ([ROBOT, "/x/../y"], None, "is for '/x/../y'"),
        ([ROBOT, "x"], None, "is for 'x'"),
        ("x", None, "the manifest lacks names"),
    ],
)
def test_a_bundle_with_anything_else_in_it_is_refused(good, names, path, words):
    parcel = Archive.unpack(good.to_bytes(), "bundle")
    files = {**parcel.files, **({path: b"x"} if path else {})}
    bad = Archive("bundle", {**parcel.about, "names": names}, files)
    with pytest.raises(MalformedError, match=words):
        Bundle.from_bytes(bad.pack())


def test_a_bundle_that_is_empty_is_refused():
    empty = Archive("bundle", {"names": [], "ca_sha256": [], "created": NOW.isoformat()}, {})
    with pytest.raises(MalformedError, match="the bundle has no participants"):
        Bundle.from_bytes(empty.pack())


def test_a_manifest_that_names_other_cas_is_refused(good):
    parcel = Archive.unpack(good.to_bytes(), "bundle")
    bad = Archive("bundle", {**parcel.about, "ca_sha256": ["00" * 32]}, parcel.files)
    with pytest.raises(MalformedError, match="names other CAs"):
        Bundle.from_bytes(bad.pack())


@pytest.mark.slow
def test_a_bit_that_flips_anywhere_in_a_bundle_is_seen_or_changes_nothing(good):
    data = good.to_bytes()
    places = range(0, len(data), 11)
    refused = 0
    for place in places:
        bad = bytearray(data)
        bad[place] ^= 1 << place % 8
        try:
            same = Bundle.from_bytes(bytes(bad)).sha256 == good.sha256
        except PqsecError:
            refused += 1
        else:
            assert same, place
    # gzip says on what system, and how hard it pressed; and some codes nobody uses
    assert refused >= 0.99 * len(places)


# Sealing


def test_a_sealed_bundle_opens_with_its_robots_key_and_with_no_other(good):
    key, other = SealingPrivateKey.generate(), SealingPrivateKey.generate()
    data = seal(good.to_bytes(), SealingPublicKey.from_pem(key.public_key.pem))
    assert is_sealed(data)
    assert b"BEGIN" not in data
    assert open_sealed(data, SealingPrivateKey.from_pem(key.pem)) == good.to_bytes()
    with pytest.raises(VerificationError, match="sealed for another key"):
        open_sealed(data, other)
    forged = seal(b"", other.public_key)[:54] + data[54:]  # says that it is for the other
    with pytest.raises(VerificationError, match="another key, or altered"):
        open_sealed(forged, other)


def test_a_bit_that_flips_in_a_sealed_bundle_is_seen():
    key = SealingPrivateKey.generate()
    data = seal(b"x" * 200, key.public_key)
    for place in range(len(data)):
        bad = bytearray(data)
        bad[place] ^= 1 << place % 8
        with pytest.raises(VerificationError):
            open_sealed(bytes(bad), key)
    for cut in (0, 22, 53):
        with pytest.raises(MalformedError, match="incomplete"):
            open_sealed(data[:cut], key)
    for cut in (54, 60, len(data) - 1):
        with pytest.raises(VerificationError, match="another key, or altered"):
            open_sealed(data[:cut], key)


def test_a_key_to_seal_for_that_is_none_is_refused():
    key = SealingPrivateKey.generate()
    for bad in (b"", b"x", key.pem, key.public_key.pem[:-400], PROFILES[0].name.encode()):
        with pytest.raises(MalformedError):
            SealingPublicKey.from_pem(bad)
    with pytest.raises(MalformedError, match="1215 bytes"):
        SealingPublicKey.from_raw(key.public_key.raw[:-1])
    for bad in (b"", key.public_key.pem):
        with pytest.raises(MalformedError):
            SealingPrivateKey.from_pem(bad)
    assert key.raw.hex() not in repr(key)


# What a robot checks


def problems(bundle, pins, now=NOW):
    with pytest.raises(VerificationError) as caught:
        verify_bundle(bundle, pins, now=now)
    return caught.value.lines


@pytest.mark.parametrize("profile", PROFILES, ids=lambda each: each.name)
def test_a_good_bundle_of_every_profile_holds(keystores, profile, tmp_path):
    keystore = keystores(profile.name)
    bundle = answered(keystore, asked_of(keystore, tmp_path))
    [found] = verify_bundle(bundle, bundle.roles, now=NOW).verified
    assert found.name == ROBOT


@pytest.mark.parametrize(
    ("days", "words"),
    [
        (-2, ["not valid before", "not valid before", "not valid before", "not valid now"]),
        (366, ["expired on", "not valid now"]),
    ],
)
def test_a_bundle_outside_its_time_is_refused(good, days, words):
    found = problems(good, good.roles, NOW + days * DAY)
    assert all(any(word in each for each in found) for word in words), found


def test_the_cas_must_be_those_that_are_trusted_and_no_others(good, foreign):
    assert len(problems(foreign, good.roles)) == 6
    [countersigner] = good.roles[PERMISSIONS_ALT_CA]
    without = {file: pins for file, pins in good.roles.items() if file != PERMISSIONS_ALT_CA}
    [only] = problems(good, without)
    assert f"the countersigner CA is not trusted in this role: SHA-256 {countersigner}" in only
    more = {**good.roles, IDENTITY_CA: good.roles[IDENTITY_CA] | {"00" * 32}}
    [only] = problems(good, more)
    assert f"the identity CA that is trusted is missing: SHA-256 {'00' * 32}" in only


def test_a_countersigner_that_is_left_out_is_missed(good):
    bad = with_files(good, **{"permissions_ca.alt.cert_pem": None})
    [only] = problems(bad, good.roles)
    assert "the countersigner CA that is trusted is missing" in only
    found = problems(bad, bad.roles)  # even where nobody pinned it
    assert "the countersigner is missing" in found[0]


FLAWS = {
    "a certificate of another CA": ({"cert_pem"}, "is not signed by this CA"),
    "permissions of another CA": ({"permissions_p7s"}, "permissions.p7s: not signed by"),
    "governance of another CA": ({"governance_p7s"}, "governance.p7s: not signed by"),
}


@pytest.mark.parametrize("flaw", FLAWS)
def test_a_file_of_somebody_elses_cas_is_refused(good, foreign, flaw):
    files, words = FLAWS[flaw]
    real = {"cert_pem": "cert.pem", "permissions_p7s": "permissions.p7s"}
    real["governance_p7s"] = "governance.p7s"
    bad = with_files(good, **{each: foreign.enclaves[ROBOT][real[each]] for each in files})
    assert words in "\n".join(problems(bad, good.roles))


def test_a_certificate_and_permissions_for_another_participant_are_refused(keystores, good):
    other = Bundle.of(keystores(), ["/listener"], now=NOW).enclaves["/listener"]
    bad = with_files(good, cert_pem=other["cert.pem"])
    assert f"{ROBOT}: cert.pem: the certificate is for CN=/listener" in problems(bad, good.roles)
    bad = with_files(good, permissions_p7s=other["permissions.p7s"])
    assert problems(bad, good.roles) == (
        f"{ROBOT}: permissions.p7s: they have no grant for CN={ROBOT}",
    )


def test_an_altered_document_is_refused(good):
    for file in ("permissions.p7s", "governance.p7s"):
        data = good.enclaves[ROBOT][file]
        altered = data.replace(b"<id>0</id>", b"<id>9</id>", 1)
        assert altered != data
        bad = with_files(good, **{file.replace(".", "_"): altered})
        assert "was changed after signing" in problems(bad, good.roles)[0]


def test_permissions_that_end_before_the_certificate_are_refused_from_then_on(keystores, tmp_path):
    keystore = keystores("classical", "short")
    grant = Grant.least(
        name=ROBOT,
        subject_name=f"CN={ROBOT}",
        not_before=NOW - DAY,
        not_after=NOW + 10 * DAY,
        domains=DomainSet.of(0),
        publish=["t"],
        subscribe=[],
    )
    bundle = answered(keystore, asked_of(keystore, tmp_path), grants=(grant,))
    verify_bundle(bundle, bundle.roles, now=NOW + 9 * DAY)
    [only] = problems(bundle, bundle.roles, NOW + 11 * DAY)
    assert "not valid now, but 2026-11-20 12:00 UTC to 2026-12-01 12:00 UTC" in only


def resigned(keystore, *, countersigner):
    """The keystore's governance, signed by its CAs; without the countersigner, if told."""
    authorities = keystore.unlock(None)
    if not countersigner:
        authorities = replace(authorities, countersigner=None)
    return authorities.sign((keystore.root / "enclaves/governance.xml").read_bytes(), now=NOW)


def test_a_document_whose_second_signature_is_stripped_is_refused(keystores, good):
    bad = with_files(good, governance_p7s=resigned(keystores(), countersigner=True))
    verify_bundle(bad, good.roles, now=NOW)
    bad = with_files(good, governance_p7s=resigned(keystores(), countersigner=False))
    [only] = problems(bad, good.roles)
    assert "there is no" in only


def test_a_certificate_without_its_second_signature_is_refused(keystores, good):
    identity = keystores().unlock(None).identity
    old = Certificate.from_pem(good.enclaves[ROBOT]["cert.pem"])
    half = Authority(identity.certificate, identity.key, None)
    made = half.issue(
        ROBOT, old.public_key, alternative=old.alternative_key, now=NOW, validity=YEAR
    )
    [only] = problems(with_files(good, cert_pem=made.pem), good.roles)
    assert "has no alternative signature" in only


def test_one_ca_for_both_is_refused(keystores, tmp_path):
    keystore = keystores("classical")
    bundle = answered(keystore, asked_of(keystore, tmp_path))
    identity = keystore.unlock(None).identity
    one = {"permissions_ca.cert_pem": identity.certificate.pem}
    bad = with_files(bundle, **one)
    assert any("CVE-2023-24010" in each for each in problems(bad, bad.roles))


@pytest.mark.parametrize(
    ("signer", "file"),
    [
        ("permissions", "permissions_ca.cert.pem"),
        ("countersigner", "permissions_ca.alt.cert.pem"),
    ],
)
def test_a_signer_whose_own_time_is_over_is_refused(keystores, good, signer, file):
    keystore = keystores()
    short = Authorities.create(keystore.profile, "Short", now=NOW, validity=30 * DAY)
    authorities = replace(keystore.unlock(None), **{signer: getattr(short, signer)})
    enclaves = keystore.root / "enclaves"
    bundle = with_files(
        good,
        permissions_p7s=authorities.sign(
            (enclaves / ROBOT[1:] / "permissions.xml").read_bytes(), now=NOW
        ),
        governance_p7s=authorities.sign((enclaves / "governance.xml").read_bytes(), now=NOW),
        **{
            "permissions_ca.cert_pem": authorities.permissions.certificate.pem,
            "permissions_ca.alt.cert_pem": authorities.countersigner.certificate.pem,
        },
    )
    verify_bundle(bundle, bundle.roles, now=NOW)
    [only] = problems(bundle, bundle.roles, NOW + 60 * DAY)
    assert only.startswith(f"{ROBOT}: {file}: the CA certificate expired")


def test_a_second_ca_behind_the_first_is_trusted_by_nobody_either(good, foreign):
    """Some stacks take all the certificates in the file for CAs."""
    both = b"".join(each.enclaves[ROBOT]["identity_ca.cert.pem"] for each in (good, foreign))
    bad = with_files(good, **{"identity_ca.cert_pem": both})
    [only] = problems(bad, good.roles)
    assert next(iter(foreign.roles[IDENTITY_CA])) in only
    verify_bundle(bad, bad.roles, now=NOW)


@pytest.mark.parametrize("file", ["cert_pem", "permissions_ca.cert_pem", "crl_pem"])
def test_two_of_what_there_is_one_of_are_refused(keystores, good, file):
    bundle = with_files(good, crl_pem=revoked_list(keystores(), 1))
    data = bundle.enclaves[ROBOT][file.replace("_pem", ".pem")]
    with pytest.raises(MalformedError, match=r"2 certificates, not one|not one revocation list"):
        verify_bundle(with_files(bundle, **{file: data + data}), good.roles, now=NOW)


@pytest.mark.parametrize(
    "label", ["TRUSTED CERTIFICATE", "X509 CERTIFICATE", "PRIVATE KEY", "CERTIFICATE-----\n:"]
)
def test_what_a_stack_could_read_beside_a_certificate_is_refused(good, label):
    data = good.enclaves[ROBOT]["identity_ca.cert.pem"]
    hidden = data.replace(b"CERTIFICATE", label.encode())
    for bad in (data + hidden, hidden + data):
        with pytest.raises(MalformedError, match=r"in PEM|certificates alone|PEM says|broken PEM"):
            verify_bundle(with_files(good, **{"identity_ca.cert_pem": bad}), good.roles, now=NOW)


def revoked_list(keystore, *serials, now=NOW):
    from pqsec_pki.certificates import RevokedCertificate  # noqa: PLC0415 -- of this alone

    entries = [RevokedCertificate(serial, now, None) for serial in serials]
    identity = keystore.unlock(None).identity
    return revocation_list(identity, entries, number=1, now=now, validity=10 * DAY).pem


def test_a_revoked_certificate_and_a_list_that_is_no_good_are_refused(keystores, good):
    serial = Certificate.from_pem(good.enclaves[ROBOT]["cert.pem"]).serial_number
    ours, theirs = keystores(), keystores(label="other")
    with_list = with_files(good, crl_pem=revoked_list(ours, 1, 2))
    verify_bundle(with_list, good.roles, now=NOW)
    assert (
        "was revoked on"
        in problems(with_files(good, crl_pem=revoked_list(ours, serial)), good.roles)[0]
    )
    assert (
        "names another key or certificate of the CA"
        in problems(with_files(good, crl_pem=revoked_list(theirs, 1)), good.roles)[0]
    )
    assert "revocation list" in problems(with_list, good.roles, NOW + 11 * DAY)[0]


@pytest.mark.parametrize("file", ["cert_pem", "identity_ca.cert_pem", "crl_pem"])
def test_a_file_that_is_not_what_it_should_be_is_named(good, file):
    bad = with_files(good, **{file: b"nonsense"})
    with pytest.raises(MalformedError, match=file.replace("_pem", ".pem")):
        verify_bundle(bad, good.roles, now=NOW)


def test_a_bundle_of_a_keystore_that_revoked_somebody_carries_the_list(tmp_path):
    keystore = made(tmp_path / "k", "classical", names=("/a", "/b"))
    revoke(Keystore.open(keystore.root), keystore.unlock(None), ["/b"], now=NOW)
    bundle = Bundle.of(keystore, ["/a"], now=NOW)
    [found] = verify_bundle(bundle, bundle.roles, now=NOW).verified
    assert found.anchors.revocation_list.number == 1
    with pytest.raises(VerificationError, match="was revoked on"):
        Bundle.of(keystore, ["/b"], now=NOW)


def test_permissions_may_be_for_others_too(keystores, good):
    """As with one document for a whole domain: the participant's own grant counts."""
    authorities = keystores().unlock(None)
    span = {"not_before": NOW - DAY, "not_after": NOW + DAY, "domains": DomainSet.of(0)}
    grants = tuple(
        Grant.least(name=name, subject_name=f"CN={name}", publish=["t"], subscribe=[], **span)
        for name in ("/listener", ROBOT)
    )
    signed = authorities.sign(Permissions(grants=grants).to_xml(), now=NOW)
    verify_bundle(with_files(good, permissions_p7s=signed), good.roles, now=NOW)


def test_the_tables_have_no_kind_of_key_that_a_request_cannot_carry():
    for row in SIGNATURES:
        made = certificate_request(ROBOT, some_key(row.name))
        made.verify()
        assert CertificateRequest.from_pem(made.pem).spki == made.spki


@pytest.mark.parametrize("file", ["crl.pem", "cert.pem", "key.pem", "permissions.p7s"])
def test_a_link_in_an_enclave_leads_no_file_of_others_into_a_bundle(tmp_path, file):
    keystore = made(tmp_path / "k", "classical", names=("/a",))
    mine = tmp_path / "mine.pem"
    inside = keystore.root / "enclaves/a" / file
    mine.write_bytes(inside.read_bytes() if inside.exists() else b"secret")
    inside.unlink(missing_ok=True)
    inside.symlink_to(mine)
    with pytest.raises(FileError, match=r"leads out of|ymbolic link"):
        Bundle.of(keystore, ["/a"], now=NOW)


def test_a_key_is_no_link_to_what_a_bundle_of_another_has(tmp_path):
    """What the bundles of one batch share is read once, by where its links lead."""
    keystore = made(tmp_path / "k", "classical", names=("/a", "/b"))
    key = keystore.root / "enclaves/b/key.pem"
    key.unlink()
    key.symlink_to((keystore.root / "enclaves/a/governance.p7s").readlink())
    linked = {}
    enclave_files(keystore.root, "/a", linked)
    with pytest.raises(FileError, match=r"key\.pem"):
        enclave_files(keystore.root, "/b", linked)
    with pytest.raises(FileError, match=r"key\.pem"):
        enclave_files(keystore.root, "/b")


def test_a_key_of_a_ca_is_in_no_bundle_though_a_link_shows_it(tmp_path):
    keystore = made(tmp_path / "k", "classical", names=("/a",))
    key = keystore.root / "enclaves/a/key.pem"
    key.unlink()
    key.symlink_to("../../private/identity_ca.key.pem")
    with pytest.raises(FileError, match=r"key\.pem"):
        Bundle.of(keystore, ["/a"], now=NOW)
