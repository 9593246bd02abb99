"""Installing on a robot: the old set or the new one, never a mix, whatever happens."""

import errno
import json
import os
import shutil
import stat
from contextlib import ExitStack
from dataclasses import replace
from datetime import timedelta
from functools import partial

import pytest

from pqsec_pki._locks import lock
from pqsec_pki.algorithms import SealingPrivateKey, SealingPublicKey, profile_named
from pqsec_pki.certificates import Certificate
from pqsec_pki.credentials import IDENTITY_CA
from pqsec_pki.enrolment import (
    Bundle,
    _own_folder,
    credential_store,
    install,
    make_sealing_key,
    read_receipts,
    removed_alone,
    request,
    rollback,
    seal,
)
from pqsec_pki.enrolment._own_folder import locked, make_private
from pqsec_pki.enrolment.credential_store import CredentialStore, changing
from pqsec_pki.enrolment.pins import ROLES, pins_of
from pqsec_pki.enrolment.verification import keys_of, verify_bundle
from pqsec_pki.errors import (
    ExistsError,
    FileError,
    KeystoreError,
    MalformedError,
    PqsecError,
    UsageError,
    VerificationError,
)
from pqsec_pki.keystore import Keystore, audit
from pqsec_pki.lifecycle import Renewal, Rollover, Scope, renew, renew_list, revoke
from pqsec_pki.problems import Code
from tests.unit.enrolling import DAY, ROBOT, answered, asked_of, with_files
from tests.unit.keystores import begin_overlap, made, rotate
from tests.unit.killing import NOW, disturbed_calls, fails_with, survives

NOBODY = 65534


@pytest.fixture(scope="module")
def keystore(memory):
    return made(memory / "keystore", "transition", names=("/arm", "/leg"))


@pytest.fixture(scope="module")
def bundles(keystore, memory):
    """A robot that asked, and two bundles for its keys: the second made a day later."""
    robot = memory / "robot"
    first = answered(keystore, asked_of(keystore, robot))
    renew(keystore, keystore.unlock(None), [ROBOT], Renewal(), now=NOW + DAY)
    return robot, first, Bundle.of(keystore, [ROBOT], now=NOW + DAY)


LATER = NOW + 2 * DAY


@pytest.fixture
def robot(bundles, place):
    """A robot that asked and has nothing installed; the bundles lie beside it, as files."""
    shutil.copytree(bundles[0], place / "robot", symlinks=True)
    for number, bundle in enumerate(bundles[1:], start=1):
        (place / f"{number}.bundle").write_bytes(bundle.to_bytes())
    return place / "robot"


def put(robot, which="1", pins=None, **options):
    path = robot.parent / f"{which}.bundle"
    return install(path, robot, pins, **{"now": LATER, "trust_first": True, **options})


def installed(robot):
    """The fingerprint of the certificate that is in use, once all around it holds; or None."""
    current = CredentialStore(robot).current
    if current is None:
        return None
    found = Bundle(LATER, current.enclaves)
    [credentials] = verify_bundle(found, found.roles, now=LATER).verified
    keys_of(credentials, [found.enclaves[ROBOT]])
    receipt = robot / "installed.receipt"
    assert not receipt.exists() or len(read_receipts(receipt.read_bytes())) == 1
    for file in current.path.rglob("*"):
        private = file.is_dir() or file.name.endswith("key.pem")
        assert stat.S_IMODE(file.stat().st_mode) == (
            (0o700 if file.is_dir() else 0o600) if private else 0o644
        )
    return credentials.certificate.fingerprint


def fingerprint(bundle):
    return Certificate.from_pem(bundle.enclaves[ROBOT]["cert.pem"]).fingerprint


def snapshot(robot):
    return {
        path.relative_to(robot): path.read_bytes() if path.is_file() else None
        for path in robot.rglob("*")
    }


def test_a_bundle_is_installed_with_the_keys_that_were_made_here(robot, bundles):
    done = put(robot)
    assert done.names == (ROBOT,)
    assert not done.already
    assert installed(robot) == fingerprint(bundles[1])
    assert not list((robot / "requests").iterdir())


def test_the_same_bundle_again_changes_nothing(robot):
    put(robot)
    before = snapshot(robot)
    assert put(robot).already
    after = snapshot(robot)
    changed = {path.name for path in before if after[path] != before[path]}
    assert changed == {"installed.receipt", "trust.json"}  # which counts the receipts
    assert after.keys() == before.keys()


def test_the_next_bundle_needs_no_fingerprint_and_the_way_back_stays_open(robot, bundles):
    put(robot)
    put(robot, "2", trust_first=False)
    assert installed(robot) == fingerprint(bundles[2])
    before = snapshot(robot)
    with pytest.raises(VerificationError, match="older than one installed before") as caught:
        rollback(robot, now=LATER)
    assert caught.value.codes == {Code.OLDER}
    assert snapshot(robot) == before
    rollback(robot, now=LATER, older=True)
    assert installed(robot) == fingerprint(bundles[1])
    with pytest.raises(KeystoreError, match="has no installation from before"):
        rollback(robot, now=LATER, older=True)
    put(robot, "2")
    assert installed(robot) == fingerprint(bundles[2])
    rollback(robot, now=LATER, older=True)
    assert installed(robot) == fingerprint(bundles[1])


def test_after_a_rollback_no_older_bundle_is_installed_either(robot, bundles):
    put(robot)
    put(robot, "2")
    rollback(robot, now=LATER, older=True)
    with pytest.raises(VerificationError, match="older than one installed before") as caught:
        put(robot, "1")
    assert caught.value.codes == {Code.OLDER}
    put(robot, "2")
    assert installed(robot) == fingerprint(bundles[2])


def test_a_second_copy_of_the_identity_ca_does_not_switch_the_list_off(place):
    """Audit H2: two certificates of one CA, or the permissions CA as second, are no overlap."""
    keystore = made(place / "k", "classical", names=("/arm", "/leg"))
    answered(keystore, asked_of(keystore, place / "robot"))
    revoke(Keystore.open(keystore.root), keystore.unlock(None), ["/leg"], now=NOW)
    listed = Bundle.of(keystore, [ROBOT], now=NOW)
    (place / "1.bundle").write_bytes(listed.to_bytes())
    put(place / "robot", "1")
    files = listed.enclaves[ROBOT]
    for second, code in (
        (files["identity_ca.cert.pem"], Code.CA_DOUBLED),
        (files["permissions_ca.cert.pem"], Code.CA_UNKNOWN),
    ):
        cas = files["identity_ca.cert.pem"] + second
        stripped = with_files(listed, **{"identity_ca.cert_pem": cas, "crl_pem": None})
        (place / "2.bundle").write_bytes(stripped.to_bytes())
        with pytest.raises(VerificationError) as caught:
            put(place / "robot", "2")
        assert code in caught.value.codes
        with pytest.raises(VerificationError) as caught:  # even where it is pinned as that
            put(place / "robot", "2", stripped.roles)
        assert caught.value.codes & {Code.CA_DOUBLED, Code.ONE_KEY_TWO_ROLES}


def test_a_first_installation_trusts_each_ca_in_its_role_only(robot, bundles):
    """Audit M1: identity_ca.cert.pem with the permissions CA behind the identity CA."""
    pins, files = bundles[1].roles, bundles[1].enclaves[ROBOT]
    cas = files["identity_ca.cert.pem"] + files["permissions_ca.cert.pem"]
    both = with_files(bundles[1], **{"identity_ca.cert_pem": cas})
    (robot.parent / "3.bundle").write_bytes(both.to_bytes())
    with pytest.raises(VerificationError) as caught:
        put(robot, "3", pins)
    assert caught.value.codes == {Code.CA_UNKNOWN}
    assert CredentialStore(robot).current is None


def test_what_an_older_pqsec_installed_tells_all_that_a_trust_state_says(place):
    keystore = made(place / "k", "classical", names=("/arm",))
    answered(keystore, asked_of(keystore, place / "robot"))
    bundle = Bundle.of(keystore, [ROBOT], now=NOW)
    (place / "1.bundle").write_bytes(bundle.to_bytes())
    put(place / "robot", "1", bundle.roles)
    before = CredentialStore(place / "robot").trust_state
    (place / "robot/trust.json").unlink()
    put(place / "robot", "1", trust_first=False)
    after = CredentialStore(place / "robot").trust_state
    assert after.store != before.store  # of the receipts that it made nobody knows
    assert replace(after, store=before.store) == before


def test_what_an_older_pqsec_installed_is_believed_as_it_shows(robot, bundles):
    put(robot, "2")
    (robot / "trust.json").unlink()
    with pytest.raises(VerificationError, match="older than one installed before") as caught:
        put(robot, "1", trust_first=False)
    assert caught.value.hint == "--older installs it anyway"
    put(robot, "2", trust_first=False)
    assert (robot / "trust.json").exists()


@pytest.mark.parametrize(
    "text",
    [
        *('{"format": 2}', "[]", "{", '{"format": 1, "pins": {}, "marks": {}}'),
        '{"format": 1, "pins": {"identity": 7}, "marks": {"lists": {}, "signed": {}}}',
        '{"format": 1, "pins": {}, "marks": {"lists": {}, "signed": {"x": "2026-01-01"}}}',
    ],
)
def test_a_damaged_trust_state_is_told_and_never_taken_for_none(robot, text):
    put(robot)
    (robot / "trust.json").write_text(text)
    with pytest.raises(KeystoreError, match=r"trust\.json") as caught:
        put(robot, "2", trust_first=True)
    assert "--older" in caught.value.hint


def test_a_bundle_is_written_again_from_what_was_verified(robot, bundles):
    files = dict(bundles[1].enclaves[ROBOT])
    files["cert.pem"] = b"what anybody wrote\n" + files["cert.pem"]
    files["permissions.p7s"] = files["permissions.p7s"].replace(
        b"This is an S/MIME signed message", b"whatever"
    )
    noisy = with_files(
        bundles[1], cert_pem=files["cert.pem"], permissions_p7s=files["permissions.p7s"]
    )
    (robot.parent / "3.bundle").write_bytes(noisy.to_bytes())
    put(robot, "3")
    there = CredentialStore(robot).current.enclaves[ROBOT]
    for file in ("cert.pem", "permissions.p7s"):
        assert there[file] == bundles[1].enclaves[ROBOT][file]


def test_only_the_set_before_is_kept(robot):
    for which in ("1", "2", "1", "2"):
        put(robot, which, older=True)
    assert {each.name for each in (robot / "installed").iterdir()} == {"3", "4"}
    assert {each.name for each in robot.iterdir()} == {
        *("current", "installed", "requests", "trust.json", "installed.receipt"),
    }


def test_nothing_is_trusted_without_being_told(robot, bundles):
    pins = bundles[1].roles
    with pytest.raises(UsageError, match="so no CAs are trusted"):
        put(robot, trust_first=False)
    with pytest.raises(VerificationError, match="is not trusted in this role"):
        put(robot, "1", {IDENTITY_CA: pins[IDENTITY_CA]})
    assert CredentialStore(robot).current is None
    put(robot, "1", pins, trust_first=False)
    assert installed(robot)


def test_a_fingerprint_is_written_with_its_role_and_as_people_write_them(bundles):
    pins = bundles[1].roles
    spelled = [
        f"{role}:" + ":".join(pin[i : i + 2] for i in range(0, 64, 2)).upper()
        for role, file in ROLES.items()
        for pin in pins[file]
    ]
    assert pins_of(spelled) == pins
    for text in ("abc", "0" * 64, "identity:abc", "countersign:" + "0" * 64, "identity:"):
        with pytest.raises(UsageError, match="not a role and a SHA-256 fingerprint"):
            pins_of([text])


def test_who_trusted_first_trusts_no_others_after(robot, place):
    put(robot)
    other = made(place / "other", "transition", names=())
    name = place / "stranger"
    foreign = answered(other, asked_of(other, name))
    (place / "3.bundle").write_bytes(foreign.to_bytes())
    before = snapshot(robot)
    with pytest.raises(VerificationError, match="is not trusted in this role"):
        put(robot, "3")
    assert snapshot(robot) == before
    with pytest.raises(VerificationError, match="no private key here matches the certificate"):
        put(robot, "3", foreign.roles)


def test_a_bundle_for_another_robot_is_refused(robot, keystore, place):
    theirs = answered(keystore, asked_of(keystore, place / "twin"))
    (place / "3.bundle").write_bytes(theirs.to_bytes())
    before = snapshot(robot)
    with pytest.raises(VerificationError, match="no private key here") as caught:
        put(robot, "3")
    assert "another robot" in caught.value.hint
    assert snapshot(robot) == before


@pytest.mark.parametrize("key", ["key.pem", "alt.key.pem"])
def test_a_key_that_is_not_the_certificates_is_refused(robot, key):
    request(ROBOT, profile_named("transition"), robot.parent / "twin")
    shutil.copyfile(
        robot.parent / f"twin/requests/fleet+robot1/{key}", robot / f"requests/fleet+robot1/{key}"
    )
    with pytest.raises(VerificationError, match="no private key here matches the certificate"):
        put(robot)


def test_an_older_bundle_brings_no_old_rights_back(robot, bundles):
    put(robot, "2")
    with pytest.raises(VerificationError, match="certificate is older than one installed before"):
        put(robot, "1")
    assert installed(robot) == fingerprint(bundles[2])
    put(robot, "1", older=True)
    assert installed(robot) == fingerprint(bundles[1])


def test_a_revocation_list_cannot_be_left_out_of_the_next_bundle(place):
    keystore = made(place / "k", "classical", names=("/arm", "/leg"))
    first = answered(keystore, asked_of(keystore, place / "robot"))
    revoke(Keystore.open(keystore.root), keystore.unlock(None), ["/leg"], now=NOW)
    second = Bundle.of(keystore, [ROBOT], now=NOW)
    for number, bundle in enumerate((first, second), start=1):
        (place / f"{number}.bundle").write_bytes(bundle.to_bytes())
    put(place / "robot", "2")
    with pytest.raises(VerificationError, match="revocation list is missing"):
        put(place / "robot", "1")


def test_an_older_revocation_list_does_not_come_with_another_participant(place):
    keystore = made(place / "k", "classical", names=("/arm", "/leg"))
    older = Bundle.of(keystore, ["/arm"], now=NOW)
    first = answered(keystore, asked_of(keystore, place / "robot"))
    revoke(Keystore.open(keystore.root), keystore.unlock(None), ["/leg"], now=NOW)
    for number, bundle in enumerate((older, Bundle.of(keystore, [ROBOT], now=NOW)), start=1):
        (place / f"{number}.bundle").write_bytes(bundle.to_bytes())
    put(place / "robot", "2", first.roles)
    with pytest.raises(VerificationError, match=r"/arm: crl\.pem: the revocation list is missing"):
        put(place / "robot", "1")


def test_an_older_revocation_list_does_not_let_who_was_revoked_since_in_again(place):
    keystore = made(place / "k", "classical", names=("/arm", "/leg"))
    answered(keystore, asked_of(keystore, place / "robot"))
    for number, name in enumerate(("/leg", "/arm"), start=1):
        revoke(Keystore.open(keystore.root), keystore.unlock(None), [name], now=NOW)
        bundle = Bundle.of(keystore, [ROBOT], now=NOW)
        (place / f"{number}.bundle").write_bytes(bundle.to_bytes())
    put(place / "robot", "2")
    assert put(place / "robot", "2").already
    with pytest.raises(VerificationError, match="the revocation list is older than one") as caught:
        put(place / "robot", "1")
    assert caught.value.codes == {Code.OLDER}


def test_the_list_goes_with_the_first_bundle_of_an_overlap_and_with_no_other(place):
    keystore = made(place / "k", "classical", names=("/arm",))
    answered(keystore, asked_of(keystore, place / "robot"))
    listless = Bundle.of(keystore, [ROBOT], now=NOW)
    kept, terms = keystore.unlock(None), Rollover(profile=keystore.profile, scope=Scope.IDENTITY)
    renew_list(keystore, kept, now=NOW)
    listed = Bundle.of(keystore, [ROBOT], now=NOW)
    begin_overlap(keystore, terms, kept=kept, passphrase=None, now=NOW)
    begun = Bundle.of(keystore, [ROBOT], now=NOW)
    for number, bundle in enumerate((listed, begun, listless), start=1):
        (place / f"{number}.bundle").write_bytes(bundle.to_bytes())
    robot = place / "robot"
    put(robot, "1")
    with pytest.raises(VerificationError, match="is not trusted in this role"):
        put(robot, "2")
    with pytest.raises(VerificationError, match="revocation list is missing"):
        put(robot, "3", listless.roles)
    put(robot, "2", begun.roles)
    assert not list((robot / "current").rglob("crl.pem"))


def test_the_list_of_one_participant_in_a_bundle_cannot_be_left_out_of_another(place):
    """Nothing signs a bundle: who carries it could leave the list with one of two."""
    keystore = made(place / "k", "classical", names=("/arm", "/leg", "/tail"))
    revoke(Keystore.open(keystore.root), keystore.unlock(None), ["/leg"], now=NOW)
    before = Bundle.of(keystore, ["/arm", "/tail"], now=NOW)
    fresh = made_again(keystore, ["/arm", "/tail"])
    older = before.enclaves["/tail"]["crl.pem"]
    for number, (list_, words) in enumerate(((None, "is missing"), (older, "is older"))):
        mixed = with_files(fresh, "/tail", crl_pem=list_)
        (place / f"{number}.bundle").write_bytes(mixed.to_bytes())
        with pytest.raises(VerificationError, match=f"/tail: crl.pem: the revocation list {words}"):
            put(place / "robot", str(number), mixed.roles)
        assert not (place / "robot").exists()


def made_again(keystore, names):
    """Their bundle with a newer revocation list."""
    renew_list(Keystore.open(keystore.root), keystore.unlock(None), now=NOW + DAY / 2)
    return Bundle.of(keystore, names, now=NOW)


def test_new_cas_count_their_revocation_lists_from_one(place):
    keystore = made(place / "k", "classical", names=("/arm", "/leg"))
    answered(keystore, asked_of(keystore, place / "robot"))
    for name in ("/leg", "/arm"):
        revoke(Keystore.open(keystore.root), keystore.unlock(None), [name], now=NOW)
    old = Bundle.of(keystore, [ROBOT], now=NOW)
    rollover = Rollover(profile=keystore.profile)
    rotate(keystore, rollover, kept=None, passphrase=None, now=NOW + DAY)
    new = Bundle.of(Keystore.open(keystore.root), [ROBOT], now=NOW + DAY)
    for number, bundle in enumerate((old, new), start=1):
        (place / f"{number}.bundle").write_bytes(bundle.to_bytes())
    put(place / "robot", "1")
    with pytest.raises(VerificationError, match="is not trusted in this role"):
        put(place / "robot", "2")
    put(place / "robot", "2", new.roles)
    assert installed(place / "robot") == fingerprint(new)


def test_a_countersigner_does_not_become_the_identity_ca(robot, bundles):
    put(robot)
    names = ("identity_ca.cert.pem", "permissions_ca.alt.cert.pem")
    first, second = (bundles[2].enclaves[ROBOT][name] for name in names)
    swapped = with_files(bundles[2], **dict(zip(names, (second, first), strict=True)))
    (robot.parent / "3.bundle").write_bytes(swapped.to_bytes())
    assert set(swapped.fingerprints) == set(bundles[2].fingerprints)
    with pytest.raises(VerificationError, match="is not trusted in this role") as caught:
        put(robot, "3")
    assert caught.value.codes == {Code.CA_UNKNOWN, Code.CA_MISSING}


@pytest.mark.parametrize("file", ["governance", "permissions"])
def test_an_older_document_beside_a_new_certificate_is_refused(robot, bundles, keystore, file):
    put(robot, "2")
    text = keystore.root / f"enclaves/{'' if file == 'governance' else ROBOT}/{file}.xml"
    authorities = keystore.unlock(None)
    size = len(keystore.ledger())
    for number, which in ((size + 3, "3"), (size + 1, "4")):  # whatever the clock says
        signed = authorities.sign(text.read_bytes(), number=number, now=NOW - number * DAY)
        bundle = with_files(bundles[2], **{f"{file}_p7s": signed})
        (robot.parent / f"{which}.bundle").write_bytes(bundle.to_bytes())
    put(robot, "3")
    with pytest.raises(
        VerificationError, match=rf"{file} (is|are) older than one installed before"
    ):
        put(robot, "4")


@pytest.mark.parametrize("kind", ["nonsense", "cut", "flipped", "expired"])
def test_a_bundle_that_is_refused_changes_nothing(robot, bundles, kind):
    put(robot)
    data = bundles[2].to_bytes()
    flipped = data[:999] + bytes([data[999] ^ 1]) + data[1000:]
    bad = {"nonsense": b"x" * 99, "cut": data[:-9], "flipped": flipped}
    (robot.parent / "3.bundle").write_bytes(bad.get(kind, data))
    now = NOW + timedelta(days=800) if kind == "expired" else LATER
    before = snapshot(robot)
    with pytest.raises(PqsecError) as caught:
        put(robot, "3", now=now)
    assert isinstance(caught.value, MalformedError | VerificationError)
    assert "3.bundle" in str(caught.value)
    assert kind != "expired" or "`pqsec renew` first" in caught.value.hint
    assert snapshot(robot) == before


@pytest.fixture
def pair(keystore, place):
    """A robot that asked for /head and then for /hand; and the bundles, one for each."""
    for number, name in enumerate(("/head", "/hand"), start=1):
        request = asked_of(keystore, place / "pair", name)
        bundle = answered(keystore, request, now=NOW + number * DAY)
        (place / f"{number}.bundle").write_bytes(bundle.to_bytes())
    return place / "pair"


def enclaves(robot):
    return {name: set(files) for name, files in CredentialStore(robot).current.enclaves.items()}


def test_another_bundle_for_the_same_robot_lets_what_is_installed_be(pair):
    put(pair, "1")
    [head] = enclaves(pair).items()
    assert put(pair, "2").names == ("/hand",)
    assert enclaves(pair) == {"/hand": head[1], head[0]: head[1]}
    assert put(pair, "2").already
    assert put(pair, "1").already
    for name, files in CredentialStore(pair).current.enclaves.items():
        [found] = verify_bundle(
            Bundle(LATER, {name: files}), pins_in_files(files), now=LATER
        ).verified
        keys_of(found, [files])


def pins_in_files(files):
    return Bundle(LATER, {"/x": files}).roles


def test_what_else_is_installed_goes_if_that_is_said(pair):
    put(pair, "1")
    put(pair, "2", alone=True)
    assert list(enclaves(pair)) == ["/hand"]


def test_only_what_was_asked_about_goes(pair, place):
    asked = removed_alone(place / "2.bundle", pair)
    assert asked == ()
    put(pair, "1")  # by another process, between the question and the installation
    before = snapshot(pair)
    with pytest.raises(KeystoreError, match="in the meantime: /head, which would be removed"):
        put(pair, "2", alone=True, agreed=asked)
    assert snapshot(pair) == before
    put(pair, "2", alone=True, agreed=removed_alone(place / "2.bundle", pair))
    assert list(enclaves(pair)) == ["/hand"]


def test_a_newer_revocation_list_is_for_all_that_is_installed(keystore, pair, place):
    put(pair, "1")
    before = enclaves(pair)["/head"]
    shutil.copytree(keystore.root, place / "copy", symlinks=True)
    keystore = Keystore.open(place / "copy")
    revoke(keystore, keystore.unlock(None), ["/leg"], now=NOW + DAY)
    path = pair.parent / "2.bundle"
    path.write_bytes(Bundle.of(keystore, ["/hand"], now=LATER).to_bytes())
    put(pair, "2")
    assert enclaves(pair)["/head"] == before | {"crl.pem"}
    lists = {files["crl.pem"] for files in CredentialStore(pair).current.enclaves.values()}
    assert lists == {keystore.revocation_list_path.read_bytes()}


@pytest.mark.parametrize("flaw", ["other CAs", "damaged"])
def test_what_is_installed_of_other_cas_neither_goes_nor_stays_unasked(pair, place, flaw):
    put(pair, "1")
    if flaw == "damaged":
        (pair / "current/enclaves/head/identity_ca.cert.pem").write_text("x")
        path, pins = place / "2.bundle", Bundle.from_bytes((place / "2.bundle").read_bytes())
    else:
        other = made(place / "other", "transition", names=())
        pins, path = answered(other, asked_of(other, pair, "/hand")), place / "3.bundle"
        path.write_bytes(pins.to_bytes())
    before = snapshot(pair)
    taking = {"now": LATER, "older": True}
    with pytest.raises(VerificationError, match="also installed: /head, which were not") as caught:
        install(path, pair, pins.roles, **taking)
    assert "--only" in caught.value.hint
    assert snapshot(pair) == before
    assert install(path, pair, pins.roles, alone=True, **taking).names == ("/hand",)


def test_several_enclaves_with_their_keys_are_one_set(keystore, place):
    bundle = Bundle.of(keystore, ["/arm", "/leg"], now=NOW)
    (place / "1.bundle").write_bytes(bundle.to_bytes())
    done = put(place / "robot")
    assert done.names == ("/arm", "/leg")
    for name in ("arm", "leg"):
        key = place / f"robot/current/enclaves/{name}/key.pem"
        assert key.read_bytes() == (keystore.root / f"enclaves/{name}/key.pem").read_bytes()
        assert stat.S_IMODE(key.stat().st_mode) == 0o600
    mixed = with_files(bundle, "/arm", key_pem=bundle.enclaves["/leg"]["key.pem"])
    (place / "2.bundle").write_bytes(mixed.to_bytes())
    with pytest.raises(VerificationError, match="/arm: no private key here"):
        put(place / "robot", "2")


def test_a_second_sealing_key_takes_neither_half_of_the_first_away_unless_told(place):
    make_sealing_key(place / "robot")
    before = snapshot(place / "robot")
    with pytest.raises(ExistsError, match=r"bundle\.key\.pem exists"):
        make_sealing_key(place / "robot")
    assert snapshot(place / "robot") == before
    make_sealing_key(place / "robot", force=True)
    assert all(before[each] != data for each, data in snapshot(place / "robot").items())


def test_a_sealed_bundle_needs_the_robots_key(keystore, place):
    public, _ = make_sealing_key(place / "robot")
    recipient = SealingPublicKey.from_pem(public.read_bytes())
    data = seal(Bundle.of(keystore, ["/arm"], now=NOW).to_bytes(), recipient)
    (place / "1.bundle").write_bytes(data)
    with pytest.raises(KeystoreError, match="no key to open it"):
        put(place / "twin")
    make_sealing_key(place / "twin")
    with pytest.raises(VerificationError, match="sealed for another key"):
        put(place / "twin")
    assert put(place / "robot").names == ("/arm",)
    assert stat.S_IMODE((place / "robot/bundle.key.pem").stat().st_mode) == 0o600


# Whatever happens


def at_calls(original, place, work, look, *, ends=survives, every=5):  # noqa: PLR0913
    """Do `work` in copies of `original`, which end at one of `every` calls; `look` at each.

    How many calls `work` makes, at least.
    """
    for calls in disturbed_calls(every):
        goal = place / f"copy{calls}"
        shutil.copytree(original, goal, symlinks=True)
        done = ends(calls, lambda goal=goal: work(goal))
        look(goal)
        shutil.rmtree(goal)
        if done:
            return calls
    raise AssertionError("it is never done")


def test_killed_at_any_instant_the_first_bundle_is_there_or_nothing_is(robot, bundles, place):
    def look(goal):
        assert installed(goal) in {None, fingerprint(bundles[1])}
        put(goal)
        assert installed(goal) == fingerprint(bundles[1])
        assert {each.name for each in goal.iterdir()} == {
            "current",
            "installed",
            "requests",
            "trust.json",
            "installed.receipt",
        }
        assert not list((goal / "requests").iterdir())

    assert at_calls(robot, place, put, look) > 25


@pytest.mark.slow
def test_killed_at_any_instant_the_old_set_is_there_or_the_new_one(robot, bundles, place):
    put(robot)
    old, new = map(fingerprint, bundles[1:])
    seen = set()

    def look(goal):
        seen.add(installed(goal))
        put(goal, "2")
        assert installed(goal) == new
        rollback(goal, now=LATER, older=True)
        assert installed(goal) == old
        newest = max(int(each.name) for each in (goal / "installed").iterdir())
        assert {each.name for each in (goal / "installed").iterdir()} == {"1", str(newest)}

    at_calls(robot, place, lambda goal: put(goal, "2"), look, every=1)
    assert seen == {old, new}


def ends_well(bundles):
    """A look that finds one of the two sets, whole, and installs the second."""

    def look(goal):
        assert installed(goal) in {fingerprint(each) for each in bundles[1:]}
        put(goal, "2")
        assert installed(goal) == fingerprint(bundles[2])

    return look


def test_killed_at_any_instant_a_rollback_is_done_or_not_begun(robot, bundles, place):
    put(robot)
    put(robot, "2")
    back = partial(rollback, now=LATER, older=True)
    at_calls(robot, place, back, ends_well(bundles))


@pytest.mark.slow
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EROFS])
def test_a_disk_that_refuses_leaves_what_was_there(robot, bundles, place, code):
    put(robot)
    refused = partial(fails_with, code)
    at_calls(*(robot, place, lambda goal: put(goal, "2"), ends_well(bundles)), ends=refused)


@pytest.mark.parametrize("force", [False, True])
def test_killed_at_any_instant_a_request_is_whole_or_absent(place, force):
    profile = profile_named("transition")
    before = place / "before"
    before.mkdir()
    if force:
        request(ROBOT, profile, before)

    def look(goal):
        folder = goal / "requests/fleet+robot1"
        if folder.exists():
            files = {each.name for each in folder.iterdir()}
            assert files == {"key.pem", "alt.key.pem", "request.csr"}
        request(ROBOT, profile, goal, force=True)
        assert {each.name for each in goal.iterdir()} == {"requests"}

    at_calls(before, place, lambda goal: request(ROBOT, profile, goal, force=force), look)


def test_killed_at_any_instant_a_sealing_key_leaves_no_half(place):
    def look(goal):
        make_sealing_key(goal, force=True)
        assert {each.name for each in goal.iterdir()} == {"bundle.key.pem", "bundle.pub.pem"}
        private = SealingPrivateKey.from_pem((goal / "bundle.key.pem").read_bytes())
        assert private.public_key.pem == (goal / "bundle.pub.pem").read_bytes()

    (place / "before").mkdir()
    at_calls(place / "before", place, make_sealing_key, look)


def test_killed_at_any_instant_a_sealing_key_can_be_made_again_without_force(place):
    def look(goal):
        if not (goal / "bundle.key.pem").exists():
            make_sealing_key(goal)
        private = SealingPrivateKey.from_pem((goal / "bundle.key.pem").read_bytes())
        assert private.public_key.pem == (goal / "bundle.pub.pem").read_bytes()
        with pytest.raises(ExistsError):
            make_sealing_key(goal)

    (place / "before").mkdir()
    at_calls(place / "before", place, make_sealing_key, look)


@pytest.mark.slow
def test_killed_at_any_instant_a_request_is_answered_or_the_old_keys_are_there(place):
    """Where the CAs are, for a participant whose keys were made there before."""
    prepared = made(place / "prepared", "transition", names=(ROBOT,))
    asked = asked_of(prepared, place / "robot")
    seen = set()

    def look(goal):
        Keystore.recover(goal)
        keystore = Keystore.open(goal)
        bundle = Bundle.of(keystore, [ROBOT], now=NOW)
        [found] = verify_bundle(bundle, bundle.roles, now=NOW).verified
        answer = found.certificate.spki == asked.spki
        assert answer != bundle.has_keys
        assert answer == (goal / f"enclaves{ROBOT}/request.pem").exists()
        if bundle.has_keys:
            keys_of(found, [bundle.enclaves[ROBOT]])
        audit(keystore)
        seen.add(answer)

    at_calls(prepared.root, place, lambda goal: answered(Keystore.open(goal), asked), look)
    assert seen == {True, False}


def test_two_at_once_do_not_mix(robot):
    with changing(robot), pytest.raises(KeystoreError, match="another pqsec command"):
        put(robot)
    put(robot)


def test_a_command_that_is_refused_does_not_remove_the_folder_that_another_uses(
    tmp_path, monkeypatch
):
    """Both found no folder. Of four enrolments at once, all failed in one run of many."""
    new = tmp_path / "new"
    with ExitStack() as other:

        def made_and_locked_by_another(folder):
            make_private(folder)
            other.enter_context(locked(folder))

        monkeypatch.setattr(credential_store, "make_private", made_and_locked_by_another)
        with pytest.raises(KeystoreError, match="another pqsec command"), changing(new):
            pass
        assert new.is_dir()


def test_a_folder_that_another_removed_meanwhile_is_in_use(tmp_path, monkeypatch):
    folder = tmp_path / "new"
    with pytest.raises(KeystoreError, match="another pqsec command"), locked(folder):
        pass  # before it was opened

    def locked_too_late(handle, kind):
        folder.rmdir()
        lock(handle, kind)

    monkeypatch.setattr(_own_folder, "lock", locked_too_late)
    make_private(folder)
    with pytest.raises(KeystoreError, match="another pqsec command"), locked(folder):
        pass


# A place that is not as it was left


def test_a_folder_in_the_place_of_the_link_is_refused(robot):
    (robot / "current").mkdir()
    with pytest.raises(KeystoreError, match="not a link created by pqsec"):
        put(robot)


@pytest.mark.parametrize(
    "target",
    ["/etc", "../..", "elsewhere", "installed", "installed/..", "installed/1/..", "others/1"],
)
def test_a_link_that_leads_elsewhere_is_refused(robot, target):
    (robot / "current").symlink_to(target)
    with pytest.raises(KeystoreError, match="not a link created by pqsec"):
        put(robot)


@pytest.mark.parametrize(
    ("record", "words"),
    [
        ("", "cannot be read"),
        ("[]", "cannot be read"),
        ("[" * 100_000, "cannot be read"),
        (json.dumps({"format": 1}), "another version"),
        (json.dumps({"format": 2, "at": "x", "previous": None}), "cannot be read"),
    ],
)
def test_a_damaged_record_is_told(robot, record, words):
    put(robot)
    (robot / "current/installed.json").write_text(record)
    with pytest.raises(KeystoreError, match=words):
        put(robot, "2")


def test_a_way_back_that_leads_elsewhere_is_not_taken(robot):
    put(robot)
    record = {"format": 2, "at": NOW.isoformat(), "previous": "../../..", "sets": []}
    (robot / "current/installed.json").write_text(json.dumps(record))
    with pytest.raises(KeystoreError, match="is not the number of an installation"):
        rollback(robot, now=LATER)


def test_nothing_to_go_back_to_is_told(place):
    with pytest.raises(KeystoreError, match="nothing is installed"):
        rollback(place / "robot", now=LATER)
    assert list(place.iterdir()) == []


def test_a_way_back_that_somebody_removed_is_told_as_none(robot):
    put(robot)
    put(robot, "2")
    shutil.rmtree(robot / "installed/1")
    before = snapshot(robot)
    with pytest.raises(KeystoreError, match="has no installation from before"):
        rollback(robot, now=LATER, older=True)
    assert snapshot(robot) == before


def test_a_file_that_went_missing_is_put_back_by_the_same_bundle(robot, bundles):
    put(robot)
    (robot / "current/enclaves/fleet/robot1/governance.p7s").unlink()
    with pytest.raises(KeystoreError):
        installed(robot)
    assert not put(robot, "1", bundles[1].roles, older=True).already
    assert installed(robot) == fingerprint(bundles[1])


@pytest.mark.parametrize(
    ("file", "content", "words"),
    [
        ("governance.p7s", None, r"installed/1: /fleet/robot1 lacks governance\.p7s"),
        ("permissions_ca.cert.pem", b"x", r"permissions_ca\.cert\.pem: no certificate"),
    ],
)
def test_what_is_installed_and_damaged_is_not_blamed_on_the_bundle(
    robot, bundles, file, content, words
):
    put(robot)
    (robot / "trust.json").unlink()  # as where an older pqsec installed
    path = robot / f"current/enclaves/fleet/robot1/{file}"
    path.unlink()
    if content:
        path.write_bytes(content)
    pins = bundles[1].roles
    with pytest.raises(PqsecError, match=words) as caught:
        put(robot, "2", pins)
    assert "2.bundle" not in str(caught.value)
    assert "--older" in caught.value.hint
    put(robot, "2", pins, older=True)
    assert installed(robot) == fingerprint(bundles[2])


def test_a_folder_where_anybody_may_write_is_refused(robot):
    for mode in (0o777, 0o1777, 0o702):
        robot.chmod(mode)
        with pytest.raises(KeystoreError, match="anybody may write there") as caught:
            put(robot)
        assert caught.value.hint == f"chmod go-w {robot}; or choose another --dir"
        with pytest.raises(KeystoreError, match="anybody may write there"):
            make_sealing_key(robot)
    robot.chmod(0o775)
    put(robot)


def everything_in(robot, bundle):
    """What writes into the folder of a robot."""
    return {
        "install": lambda: install(bundle, robot, (), now=LATER, trust_first=True),
        "rollback": lambda: rollback(robot, now=LATER),
        "bundle-key": lambda: make_sealing_key(robot),
        "request": lambda: request("/new", profile_named("classical"), robot),
    }


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give files to others")
def test_a_folder_that_somebody_else_could_change_or_put_another_for_is_refused(robot):
    """As sshd refuses keys: a user who may rename a folder above can replace it."""
    home, wrong, bundle = robot.parent / "home", [], robot.parent / "1.bundle"
    deep = home / "robot/credentials"
    deep.mkdir(parents=True, mode=0o755)
    (robot.parent / "link").symlink_to(home)
    os.chown(robot.parent / "link", NOBODY, NOBODY, follow_symlinks=False)
    altered = {
        "another's": (deep, NOBODY, 0, 0o755),
        "another's, above": (home, NOBODY, 0, 0o755),
        "a group's": (deep, 0, NOBODY, 0o775),
        "a group's, above": (home / "robot", 0, NOBODY, 0o775),
        "anybody's, above": (home, 0, 0, 0o777),
        "sticky, but another's, above": (home, NOBODY, NOBODY, 0o1777),
    }
    for words, (folder, user, group, mode) in altered.items():
        os.chown(folder, user, group)
        folder.chmod(mode)
        for place in (deep, deep / "new"):
            for command, work in everything_in(place, bundle).items():
                wrong += taken(f"{words}, {place.name}, {command}", work, folder)
        assert list(deep.iterdir()) == []
        os.chown(folder, 0, 0)
        folder.chmod(0o755)
    linked = robot.parent / "link/robot/credentials"
    for command, work in everything_in(linked, bundle).items():
        wrong += taken(f"a link of another's, {command}", work, robot.parent / "link")
    assert wrong == []
    home.chmod(0o1777)  # as /tmp is
    make_sealing_key(deep)


def taken(words, work, folder):
    """Nothing if it was refused for that folder."""
    try:
        work()
    except KeystoreError as error:
        named = str(error).startswith(f"{folder}: ") and "this robot's credentials" in str(error)
        return [] if named else [f"{words}: {error}"]
    except PqsecError as error:
        return [f"{words}: {error}"]
    return [f"{words}: done"]


def test_files_of_others_in_the_folder_stay(robot):
    mine = {".bundle.conf", ".draft-letter", ".bundle.key.pem.old"}
    for name in mine:
        (robot / name).mkdir()
    (robot / f".draft-{'0' * 16}").mkdir()
    put(robot)
    assert {each.name for each in robot.iterdir()} == {
        "current",
        "installed",
        "requests",
        "trust.json",
        "installed.receipt",
        *mine,
    }


def test_a_folder_that_cannot_be_written_is_told(place, robot):
    (place / "file").touch()
    with pytest.raises(FileError):
        put(robot.parent / "file")
    assert os.path.lexists(place / "file")
    assert replace(put(robot), already=True).already


def test_each_enclave_of_a_bundle_has_all_the_cas_that_are_trusted(keystore, place):
    """Not one the first set of them and another the second."""
    other = made(place / "other", "transition", names=("/leg",))
    one, two = (
        Bundle.of(each, [name], now=NOW) for each, name in ((keystore, "/arm"), (other, "/leg"))
    )
    pins = {file: one.roles[file] | two.roles[file] for file in one.roles}
    mixed = replace(one, enclaves={**one.enclaves, **two.enclaves}, proof=None)
    (place / "1.bundle").write_bytes(mixed.to_bytes())
    with pytest.raises(VerificationError) as caught:
        put(place / "robot", "1", pins, now=NOW)
    assert caught.value.codes == {Code.CA_MISSING}


def test_what_is_believed_does_not_change_where_the_disk_refuses_the_set(
    robot, bundles, monkeypatch
):
    put(robot)
    before = snapshot(robot)

    def refuse(*_):
        raise OSError(errno.ENOSPC, "no space left on device")

    monkeypatch.setattr(CredentialStore, "_draft", refuse)
    with pytest.raises(FileError):
        put(robot, "2")
    assert snapshot(robot) == before


def test_a_damaged_trust_state_can_be_done_without_if_that_is_said(robot, bundles):
    put(robot)
    put(robot, "2")
    (robot / "trust.json").write_text("{")
    rollback(robot, now=LATER, older=True)
    assert installed(robot) == fingerprint(bundles[1])
    with pytest.raises(VerificationError, match="older than one installed before"):
        put(robot, "1")  # the newest was seen all the same
    (robot / "trust.json").write_text('{"format": 1, "pins": {}, "marks": {"lists": {"x": 1e999}}}')
    put(robot, "1", bundles[1].roles, older=True)
    assert installed(robot) == fingerprint(bundles[1])
