"""Renewing: the same participant, allowed the same, for another while."""

import hashlib
import shutil
from dataclasses import replace
from datetime import timedelta

import pytest

from pqsec_pki.algorithms import PROFILES
from pqsec_pki.certificates import verify_chain
from pqsec_pki.documents import Criteria, DomainSet, Grant, Kind, PermissionRule, Permissions
from pqsec_pki.errors import (
    FileError,
    KeystoreError,
    PqsecError,
    UsageError,
    VerificationError,
)
from pqsec_pki.keystore import audit, load_certificate, status
from pqsec_pki.lifecycle import ParticipantSpec, Renewal, issue, renew, renew_list, sign_document
from pqsec_pki.selfcheck import verify_handshake
from pqsec_pki.smime import verify
from tests.unit.keystores import DAY, NOW, enter, made

LATER = NOW + 60 * DAY


@pytest.fixture
def keystore(tmp_path):
    return made(tmp_path / "k", "classical")


def renewed(keystore, *names, now=LATER, **terms):
    return renew(keystore, keystore.unlock(None), names, Renewal(**terms), now=now)


def granted(keystore, name):
    participant = keystore.participant(name)
    return Permissions.from_xml(
        verify(participant.permissions, participant.permissions_ca).document
    ).grants


def folder(keystore, name="/talker"):
    return keystore.root / "enclaves" / name[1:]


def put_permissions(keystore, *grants, now=NOW):
    """Signed by `pqsec sign-permissions` into the enclave of /talker."""
    document = Permissions(grants=grants).to_xml()
    goal = folder(keystore) / "permissions.p7s"
    (folder(keystore) / "permissions.xml").write_bytes(document)
    authorities = keystore.unlock(None)
    sign_document(keystore, Kind.PERMISSIONS, document, goal, authorities, now=now, force=True)


# What is made


@pytest.mark.parametrize("rekey", [True, False], ids=["rekey", "keep-key"])
@pytest.mark.parametrize("profile", [profile.name for profile in PROFILES])
def test_a_renewed_participant_is_whole_and_allowed_the_same(tmp_path, profile, rekey):
    keystore = made(tmp_path / "k", profile, domains="0-3")
    old, allowed = keystore.participant("/talker"), granted(keystore, "/talker")
    [issued] = renewed(keystore, "/talker", rekey=rekey)
    new, [grant] = keystore.participant("/talker"), granted(keystore, "/talker")

    assert (new.certificate.spki == old.certificate.spki) == (not rekey)
    assert (new.key.public_key.spki == old.key.public_key.spki) == (not rekey)
    assert new.certificate.serial_number != old.certificate.serial_number
    assert new.certificate.not_after == issued.not_after == LATER + 90 * DAY
    twice = keystore.profile.alternative_key is not None
    verify_chain(new.certificate, keystore.identity_ca, now=LATER, require_alternative=twice)
    window = {"not_before": new.certificate.not_before, "not_after": new.certificate.not_after}
    assert grant == replace(allowed[0], **window)
    # Past the end of the old ones, it meets the one renewed with it.
    renewed(keystore, "/listener", rekey=rekey)
    assert verify_handshake(keystore, "/talker", "/listener", domain=3, now=NOW + 120 * DAY).ok
    audit(keystore)


def test_a_participant_that_starts_amid_a_renewal_with_old_keys_has_files_that_fit(keystore):
    """The certificate comes last: until then, the old one stands beside the new permissions."""
    certificate = (folder(keystore) / "cert.pem").read_bytes()
    renewed(keystore, "/talker", rekey=False)
    (folder(keystore) / "cert.pem").write_bytes(certificate)
    for now in (NOW + 59 * DAY, LATER):
        assert verify_handshake(keystore, "/talker", "/listener", domain=0, now=now + DAY / 2).ok


def test_a_validity_may_be_named_and_is_cut_at_the_end_of_the_ca(keystore):
    [issued] = renewed(keystore, "/talker", validity=5 * DAY)
    assert issued.not_after == LATER + 5 * DAY
    [issued] = renewed(keystore, "/talker", validity=5000 * DAY)
    assert issued.shortened
    assert issued.not_after == keystore.identity_ca.not_after


def test_renewals_in_a_row_do_not_grow_or_shrink(keystore):
    ends = [renewed(keystore, "/talker", now=NOW + n * DAY)[0].not_after for n in range(4)]
    assert ends == [NOW + (90 + n) * DAY for n in range(4)]


def test_what_has_expired_can_be_renewed(keystore):
    [issued] = renewed(keystore, "/talker", now=NOW + 200 * DAY)
    assert issued.not_after == NOW + 290 * DAY


def test_names_are_made_regular_and_named_twice_is_once(keystore):
    assert [each.name for each in renewed(keystore, "talker", "//talker/")] == ["/talker"]


def test_what_the_user_put_beside_a_participant_stays(keystore):
    (folder(keystore) / "notes.txt").write_bytes(b"mine")
    renewed(keystore, "/talker")
    assert (folder(keystore) / "notes.txt").read_bytes() == b"mine"


def test_an_enclave_without_its_keys_is_renewed_with_the_keys_of_its_certificate(keystore):
    """They were made on the robot, or moved there."""
    old = keystore.participant("/talker").certificate
    (folder(keystore) / "key.pem").unlink()
    for rekey in (None, False):
        renewed(keystore, "/talker", rekey=rekey)
        new = load_certificate(folder(keystore) / "cert.pem")
        assert (new.spki, new.not_after) == (old.spki, LATER + 90 * DAY)
        assert not (folder(keystore) / "key.pem").exists()
    with pytest.raises(KeystoreError, match="the key of /talker is not here"):
        renewed(keystore, "/listener", "/talker", rekey=True)


# The policy


def rule(topic, *, allow=True, **more):
    topics = (Criteria(topics=(topic,), partitions=("p",), data_tags=(("a", "b"),)),)
    return PermissionRule(
        allow=allow, domains=DomainSet.of(0, 7), publish=topics, relay=topics, **more
    )


def grant_of(name, *rules, begin=NOW - DAY, end=NOW + 90 * DAY):
    subject = f"CN={name}"
    return Grant(
        name=f"g{name}", subject_name=subject, not_before=begin, not_after=end, rules=rules
    )


def test_a_whole_policy_is_kept_rule_by_rule(keystore):
    rules = (rule("a", allow=False), rule("b", subscribe=(Criteria(topics=("c*",)),)))
    put_permissions(keystore, grant_of("/talker", *rules), grant_of("/somebody", rule("z")))
    renewed(keystore, "/talker")
    mine, other = granted(keystore, "/talker")
    assert mine.rules == rules
    assert (mine.name, mine.not_after) == ("g/talker", LATER + 90 * DAY)
    assert other == grant_of("/somebody", rule("z"))
    [standing] = status(keystore, ["/talker"], now=LATER).participants
    assert standing.domains == "0,7"


def test_an_end_that_the_policy_set_stays(keystore):
    put_permissions(keystore, grant_of("/talker", rule("a"), end=NOW + 70 * DAY))
    renewed(keystore, "/talker")
    [grant] = granted(keystore, "/talker")
    assert grant.not_after == NOW + 70 * DAY
    assert grant.not_before == LATER - DAY


def test_a_begin_that_the_policy_set_stays(keystore):
    put_permissions(keystore, grant_of("/talker", rule("a"), begin=NOW + 80 * DAY))
    renewed(keystore, "/talker")
    [grant] = granted(keystore, "/talker")
    assert grant.not_before == NOW + 80 * DAY


def test_what_the_policy_let_end_is_not_given_again(keystore):
    put_permissions(keystore, grant_of("/talker", rule("a"), end=NOW + 10 * DAY))
    with pytest.raises(KeystoreError, match="the permissions of g/talker ended on 2026-12-01"):
        renewed(keystore, "/talker")


# What is not renewed, and then nobody is


def test_permissions_that_were_altered_are_not_signed_again(keystore):
    path = folder(keystore) / "permissions.p7s"
    signed = path.read_bytes()
    path.write_bytes(signed.replace(b"<topic>x<", b"<topic>*<"))
    with pytest.raises(KeystoreError, match="is not the newest permissions"):
        renewed(keystore, "/listener", "/talker")
    newest = keystore.ledger()[-1]
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    enter(keystore, [replace(newest, sha256=digest, name="/talker")])  # by who can write that too
    with pytest.raises(VerificationError, match="the content was changed after signing"):
        renewed(keystore, "/listener", "/talker")
    assert keystore.participant("/listener").certificate.not_after == NOW + 90 * DAY


def test_permissions_of_an_earlier_time_are_not_brought_back(keystore):
    wide = (folder(keystore) / "permissions.p7s").read_bytes()
    narrow = ParticipantSpec(name="/talker", domains=DomainSet.of(0), validity=90 * DAY)
    issue(keystore, keystore.unlock(None), [narrow], now=NOW, force=True)
    (folder(keystore) / "permissions.p7s").write_bytes(wide)
    with pytest.raises(KeystoreError, match="is not the newest permissions"):
        renewed(keystore, "/talker")


def test_permissions_that_were_edited_and_not_signed_are_not_overwritten(keystore):
    path = folder(keystore) / "permissions.xml"
    edited = path.read_bytes().replace(b"<topic>x<", b"<topic>y<")
    path.write_bytes(edited)
    with pytest.raises(KeystoreError, match=r"permissions\.xml is not what permissions\.p7s says"):
        renewed(keystore, "/listener", "/talker")
    assert path.read_bytes() == edited
    path.unlink()
    renewed(keystore, "/talker")
    assert b"<topic>x<" in path.read_bytes()


def test_a_certificate_of_an_earlier_time_is_not_renewed(keystore):
    old = (folder(keystore) / "cert.pem").read_bytes()
    renewed(keystore, "/talker")
    (folder(keystore) / "cert.pem").write_bytes(old)
    with pytest.raises(KeystoreError, match="is not the newest certificate"):
        renewed(keystore, "/talker", rekey=False)


def test_the_certificate_of_another_is_not_renewed(keystore):
    shutil.copy(folder(keystore, "/listener") / "cert.pem", folder(keystore))
    with pytest.raises(KeystoreError, match="is not the newest certificate"):
        renewed(keystore, "/talker")


@pytest.mark.parametrize("file", ["cert.pem", "permissions.p7s"])
def test_a_file_that_is_lost_is_named(keystore, file):
    (folder(keystore) / file).unlink()
    with pytest.raises((KeystoreError, FileError), match=file):
        renewed(keystore, "/talker")


@pytest.mark.parametrize(
    ("name", "refusal"),
    [("/nobody", KeystoreError), ("../x", UsageError), ("", UsageError), ("\0", UsageError)],
)
def test_who_is_not_there_is_not_renewed_and_nobody_with_them(keystore, name, refusal):
    before = keystore.ledger()
    with pytest.raises(refusal):
        renewed(keystore, "/talker", name)
    assert keystore.ledger() == before


@pytest.mark.parametrize(
    ("days", "words"), [(1000, "expired on"), (-20_000, "begins on 2026-11-20")]
)
def test_a_clock_that_is_wrong_renews_nobody(keystore, days, words):
    before = (folder(keystore) / "cert.pem").read_bytes()
    with pytest.raises(PqsecError, match=words):
        renewed(keystore, "/talker", now=NOW + days * DAY)
    assert (folder(keystore) / "cert.pem").read_bytes() == before


def test_an_older_folder_linked_elsewhere_is_not_renewed(keystore, tmp_path):
    folder(keystore).rename(tmp_path / "elsewhere")
    folder(keystore).symlink_to(tmp_path / "elsewhere")
    before = (tmp_path / "elsewhere/cert.pem").read_bytes()
    with pytest.raises(KeystoreError, match="should be a folder, and is not"):
        renewed(keystore, "/talker")
    assert (tmp_path / "elsewhere/cert.pem").read_bytes() == before


# The list beside it


@pytest.mark.parametrize(("days", "number"), [(100, 1), (300, 2)])
def test_a_list_that_is_due_is_made_anew_with_a_renewal(keystore, days, number):
    renew_list(keystore, keystore.unlock(None), now=NOW)
    renewed(keystore, "/talker", now=NOW + days * DAY)
    assert keystore.revocation_list.number == number


def test_a_list_alone_can_be_renewed(keystore):
    renew_list(keystore, keystore.unlock(None), now=NOW, validity=timedelta(days=10))
    assert renewed(keystore) == []
    assert keystore.revocation_list.number == 2
    audit(keystore)
