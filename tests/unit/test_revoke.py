"""Taking certificates back: what is meant, what the list says, and who is let in then."""

import json
import shutil

import pytest

from pqsec_pki.algorithms import PROFILES
from pqsec_pki.certificates import Reason
from pqsec_pki.errors import FileError, KeystoreError
from pqsec_pki.keystore import Keystore, audit
from pqsec_pki.lifecycle import LIST_VALIDITY, ParticipantSpec, issue, renew, renew_list, revoke
from pqsec_pki.selfcheck import HandshakeParty, HandshakeSetup, run_handshake
from tests.unit.keystores import DAY, NOW, add, made

NAMES = [profile.name for profile in PROFILES]


@pytest.fixture
def keystore(tmp_path):
    return made(tmp_path / "k", "classical", names=("/listener", "/talker", "/fleet/robot1"))


def take_back(keystore, *subjects, now=NOW, **options):
    return revoke(keystore, keystore.unlock(None), subjects, now=now, **options)


def serial_of(keystore, name):
    return f"{keystore.participant(name).certificate.serial_number:x}"


def listed(keystore):
    return [f"{each.serial_number:x}" for each in keystore.revocation_list.revoked]


def meeting(keystore, first="/talker", second="/listener", now=NOW):
    setup = HandshakeSetup(keystore=keystore, domain=0, now=now)
    return run_handshake(setup, HandshakeParty(name=first), HandshakeParty(name=second))


def again(keystore, name, **options):
    spec = ParticipantSpec(name=name, domains=keystore.domains, publish=("x",), validity=90 * DAY)
    return issue(keystore, keystore.unlock(None), [spec], now=NOW, **options)


# What is meant


def test_a_name_takes_back_all_its_certificates_that_have_not_expired(keystore):
    first = serial_of(keystore, "/talker")
    renew(keystore, keystore.unlock(None), ["/talker"], now=NOW + 80 * DAY)
    second = serial_of(keystore, "/talker")
    found, crl = take_back(keystore, "talker", now=NOW + 85 * DAY)
    assert [each.serial for each in found] == [first, second]
    assert sorted(listed(keystore)) == sorted([first, second])
    assert crl.number == 1


def test_a_name_does_not_take_back_what_has_expired(keystore):
    renew(keystore, keystore.unlock(None), ["/talker"], now=NOW + 80 * DAY)
    [found], _ = take_back(keystore, "/talker", now=NOW + 95 * DAY)
    assert found.serial == serial_of(keystore, "/talker")


@pytest.mark.parametrize("spelled", ["{}", "{upper}", "0{}", "{colons}"])
def test_a_serial_number_takes_back_one_certificate(keystore, spelled):
    old = serial_of(keystore, "/talker")
    renew(keystore, keystore.unlock(None), ["/talker"], now=NOW)
    even = old.zfill(40)
    colons = ":".join(even[place : place + 2] for place in range(0, 40, 2))
    given = spelled.format(old, upper=old.upper(), colons=colons)
    [found], _ = take_back(keystore, given)
    assert (found.name, found.serial) == ("/talker", old)
    assert listed(keystore) == [old]
    assert meeting(keystore).ok


@pytest.mark.parametrize(
    "subject", ["/nobody", "", "/", "../x", "a b", "12ab", "x" * 400, "\0", "é", "/talker/cert.pem"]
)
def test_who_is_not_known_is_refused_and_nothing_is_changed(keystore, subject):
    with pytest.raises(KeystoreError, match="the ledger has no participant"):
        take_back(keystore, "/talker", subject)
    assert keystore.revocation_list is None
    assert not (keystore.root / "enclaves/talker/crl.pem").is_symlink()
    assert [each for each in keystore.ledger() if each.kind in {"revocation", "crl"}] == []


def test_who_has_expired_is_refused(keystore):
    with pytest.raises(KeystoreError, match="/talker expired on 2027-02-19"):
        take_back(keystore, "/talker", now=NOW + 100 * DAY)


def test_to_revoke_twice_is_done_once(keystore):
    take_back(keystore, "/talker", reason=Reason.SUPERSEDED)
    (kept, new), crl = take_back(
        keystore, "/talker", "/listener", reason=Reason.PRIVILEGE_WITHDRAWN, now=NOW + DAY
    )
    assert (kept.before, kept.reason, kept.since) == (True, "superseded", NOW)
    assert (new.before, new.reason) == (False, "privilegeWithdrawn")
    assert (crl.number, len(crl.revoked)) == (2, 2)
    lines = [each for each in keystore.ledger() if each.kind == "revocation"]
    assert [each.name for each in lines] == ["/talker", "/listener"]
    audit(keystore)


def test_that_a_key_is_compromised_may_become_known_later(keystore):
    take_back(keystore, "/talker", reason=Reason.SUPERSEDED)
    for reason in (Reason.KEY_COMPROMISE, Reason.KEY_COMPROMISE, Reason.SUPERSEDED):
        [told], crl = take_back(keystore, "/talker", reason=reason, now=NOW + DAY)
        assert (told.before, told.reason, told.since) == (True, "keyCompromise", NOW)
        [entry] = crl.revoked
        assert (entry.reason, entry.revoked_at) == ("keyCompromise", NOW)
    for _ in range(2):
        take_back(keystore, "/listener", reason=Reason.KEY_COMPROMISE)
    kinds = [each.kind for each in keystore.ledger()]
    assert (kinds.count("revocation"), kinds.count("compromise")) == (2, 1)
    found = renew_list(keystore, keystore.unlock(None), now=NOW + 2 * DAY).revoked
    assert [entry.reason for entry in found] == ["keyCompromise"] * 2
    audit(keystore)


# What the list says, and where it lies


@pytest.mark.parametrize("profile", NAMES)
def test_the_list_is_in_every_enclave_and_signed_as_the_profile_wants(tmp_path, profile):
    keystore = made(tmp_path / "k", profile, names=("/talker", "/fleet/eu/robot1"))
    [found], crl = take_back(keystore, "/talker", reason=Reason.PRIVILEGE_WITHDRAWN)
    twice = keystore.profile.alternative_key is not None
    crl.verify(keystore.identity_ca, require_alternative=twice)
    [entry] = crl.revoked
    assert (f"{entry.serial_number:x}", entry.reason) == (found.serial, "privilegeWithdrawn")
    assert entry.revoked_at == NOW
    assert crl.next_update == NOW + LIST_VALIDITY
    for name in ("talker", "fleet/eu/robot1"):
        link = keystore.root / "enclaves" / name / "crl.pem"
        assert link.is_symlink()
        assert not link.readlink().is_absolute()
        assert link.read_bytes() == crl.pem
    assert keystore.revocation_list_path.stat().st_mode & 0o777 == 0o644


def test_a_participant_issued_later_has_the_list_too(keystore):
    take_back(keystore, "/talker")
    add(keystore, later="0")
    assert keystore.participant("/later").revocation_list.number == 1
    take_back(keystore, "/listener")
    assert keystore.participant("/later").revocation_list.number == 2


def test_another_link_in_the_place_of_the_link_is_replaced(keystore):
    (keystore.root / "enclaves/talker/crl.pem").symlink_to("nowhere")
    take_back(keystore, "/listener")
    assert keystore.participant("/talker").revocation_list.number == 1


def test_a_link_to_a_folder_in_the_place_of_the_link_is_refused_and_named(keystore, tmp_path):
    """Below it could be participants that no command sees."""
    place = keystore.root / "enclaves/talker/crl.pem"
    place.symlink_to(tmp_path)
    with pytest.raises(FileError, match=r"talker/crl\.pem: a link to a folder"):
        take_back(keystore, "/listener")
    assert keystore.revocation_list is None
    assert list(keystore.root.glob(".draft-*")) == []
    place.unlink()
    take_back(keystore, "/listener")
    assert keystore.participant("/talker").revocation_list.number == 1


def test_what_has_expired_leaves_the_list_after_one_more(keystore):
    # RFC 5280 3.3: not before it was on a list that is later than its end
    take_back(keystore, "/talker")
    _, last = take_back(keystore, "/listener", now=NOW + 89 * DAY)
    assert len(last.revoked) == 2
    authorities = keystore.unlock(None)
    counts = [
        len(renew_list(keystore, authorities, now=NOW + days * DAY).revoked) for days in (91, 92)
    ]
    assert counts == [2, 0]


def test_a_clock_that_was_wrong_once_lets_nobody_back_in(keystore):
    take_back(keystore, "/talker")
    authorities = keystore.unlock(None)
    renew_list(keystore, authorities, now=NOW + 200 * DAY)
    assert len(renew_list(keystore, authorities, now=NOW).revoked) == 1


def test_a_list_remembers_what_the_ledger_lost(keystore, tmp_path):
    """As an old copy of it does, that was put back."""
    shutil.copytree(keystore.root / "private", tmp_path / "before")
    take_back(keystore, "/talker")
    lost = listed(keystore)
    shutil.rmtree(keystore.root / "private")
    shutil.copytree(tmp_path / "before", keystore.root / "private")
    with pytest.raises(KeystoreError, match="the ledger lacks lines"):
        renew_list(keystore, keystore.unlock(None), now=NOW)
    (keystore.root / "public/ledger.checkpoint").unlink()  # the loss is accepted
    crl = renew_list(keystore, keystore.unlock(None), now=NOW)
    assert crl.number == 2
    assert listed(keystore) == lost


def test_a_list_that_somebody_replaced_is_made_from_the_ledger(keystore, tmp_path):
    take_back(keystore, "/talker")
    other = made(tmp_path / "other", "classical")
    take_back(other, "/listener")
    shutil.copy(other.revocation_list_path, keystore.revocation_list_path)
    crl = renew_list(keystore, keystore.unlock(None), now=NOW)
    assert (crl.number, listed(keystore)) == (2, [serial_of(keystore, "/talker")])


def test_a_damaged_list_is_made_anew(keystore):
    take_back(keystore, "/talker")
    keystore.revocation_list_path.write_bytes(b"broken")
    crl = renew_list(keystore, keystore.unlock(None), now=NOW)
    assert (crl.number, len(crl.revoked)) == (2, 1)


def test_a_list_that_was_lost_is_missed_and_not_ignored(keystore):
    take_back(keystore, "/talker")
    keystore.revocation_list_path.unlink()
    with pytest.raises(KeystoreError, match=r"lacks crl\.pem") as caught:
        keystore.participant("/listener")
    assert "identity_ca.crl.pem" in caught.value.hint
    renew_list(keystore, keystore.unlock(None), now=NOW)
    assert keystore.participant("/listener").revocation_list.number == 2


# Who is let in then


@pytest.mark.parametrize("profile", NAMES)
def test_a_revoked_participant_does_not_start(tmp_path, profile):
    keystore = made(tmp_path / "k", profile)
    assert meeting(keystore).ok
    take_back(keystore, "/talker", reason=Reason.KEY_COMPROMISE)
    report = meeting(keystore)
    words = "the certificate of CN=/talker was revoked on 2026-11-21 12:00 UTC (keyCompromise)"
    assert (report.failed.name, report.failed.detail) == ("identity of /talker", words)
    assert "--after-revocation" in report.failed.hint


@pytest.mark.parametrize("profile", NAMES)
def test_a_revoked_participant_that_hides_the_list_is_refused_by_its_peer(tmp_path, profile):
    keystore = made(tmp_path / "k", profile)
    take_back(keystore, "/talker")
    (keystore.root / "enclaves/talker/crl.pem").unlink()
    report = meeting(keystore)
    assert report.failed.name in {"request", "reply", "final"}
    assert "the certificate of CN=/talker was revoked on 2026-11-21" in report.failed.detail


def test_who_is_not_on_the_list_meets_as_before(keystore):
    take_back(keystore, "/fleet/robot1")
    assert meeting(keystore).ok


def test_with_a_list_that_has_ended_nobody_meets(keystore):
    take_back(keystore, "/fleet/robot1", validity=5 * DAY)
    report = meeting(keystore, now=NOW + 6 * DAY)
    assert "the revocation list ended on 2026-11-26" in report.failed.detail
    assert "pqsec ca crl" in report.failed.hint
    renew_list(keystore, keystore.unlock(None), now=NOW + 6 * DAY)
    assert meeting(keystore, now=NOW + 6 * DAY).ok


def test_the_list_of_another_ca_is_refused(keystore, tmp_path):
    other = made(tmp_path / "other", "classical")
    take_back(other, "/listener")
    shutil.copy(other.revocation_list_path, keystore.root / "enclaves/talker/crl.pem")
    assert "not signed by this CA" in meeting(keystore).failed.detail


# Coming back


@pytest.mark.parametrize("force", [True, False])
def test_a_revoked_name_is_not_issued_again_by_accident(keystore, force):
    take_back(keystore, "/talker")
    shutil.rmtree(keystore.root / "enclaves/talker")
    with pytest.raises(KeystoreError, match="revoked: /talker") as caught:
        again(keystore, "/talker", force=force)
    assert "--after-revocation" in caught.value.hint
    assert not (keystore.root / "enclaves/talker").exists()


def test_a_revoked_name_may_come_back_if_one_says_so(keystore):
    take_back(keystore, "/talker")
    again(keystore, "/talker", force=True, after_revocation=True)
    assert meeting(keystore).ok
    again(keystore, "/talker", force=True)  # it is not revoked any more
    assert meeting(keystore).ok


def test_a_name_whose_older_certificate_was_revoked_is_not_revoked(keystore):
    old = serial_of(keystore, "/talker")
    renew(keystore, keystore.unlock(None), ["/talker"], now=NOW)
    take_back(keystore, old)
    again(keystore, "/talker", force=True)
    assert meeting(keystore).ok


def test_a_revoked_participant_is_not_renewed(keystore):
    take_back(keystore, "/talker")
    with pytest.raises(KeystoreError, match="revoked: /talker"):
        renew(keystore, keystore.unlock(None), ["/listener", "/talker"], now=NOW)
    assert serial_of(keystore, "/talker") in listed(keystore)


# Attacks on the files


@pytest.mark.parametrize("place", ["public", "enclaves/talker"])
def test_a_list_is_not_written_through_a_link(keystore, tmp_path, place):
    victim = tmp_path / "victim"
    (keystore.root / place).rename(victim)
    (keystore.root / place).symlink_to(victim)
    before = sorted(path.name for path in victim.iterdir())
    with pytest.raises((FileError, KeystoreError)):
        take_back(keystore, "/listener")
    assert sorted(path.name for path in victim.iterdir()) == before
    assert keystore.revocation_list is None
    assert list(keystore.root.glob(".draft-*")) == []


def test_a_link_in_the_place_of_the_list_is_replaced_and_not_followed(keystore, tmp_path):
    victim = tmp_path / "victim"
    victim.write_bytes(b"mine")
    keystore.revocation_list_path.symlink_to(victim)
    take_back(keystore, "/talker")
    assert victim.read_bytes() == b"mine"
    assert not keystore.revocation_list_path.is_symlink()


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_a_list_that_somebody_else_put_there_is_not_overwritten(keystore, kind):
    place = keystore.root / "enclaves/talker/crl.pem"
    place.mkdir() if kind == "folder" else place.write_bytes(b"mine")
    with pytest.raises(KeystoreError, match=r"crl\.pem should be a link, and is not") as caught:
        take_back(keystore, "/listener")
    assert caught.value.hint == "move it away"
    assert keystore.revocation_list is None
    assert kind == "folder" or place.read_bytes() == b"mine"


def unfinished(keystore, *links):
    """A change as a command leaves it that was killed after its commitment."""
    (keystore.root / ".journal").mkdir()
    moves = {"targets": [], "links": links, "entries": []}
    (keystore.root / ".journal/moves.json").write_text(json.dumps(moves))


def test_a_link_is_made_when_a_change_is_finished_unless_its_folder_is_gone(keystore):
    unfinished(keystore, ("enclaves/talker/crl.pem", "x"), ("enclaves/gone/crl.pem", "x"))
    Keystore.open(keystore.root, to_change=True)
    assert str((keystore.root / "enclaves/talker/crl.pem").readlink()) == "x"
    assert not (keystore.root / "enclaves/gone").exists()


@pytest.mark.parametrize("place", ["../crl.pem", "enclaves/../../crl.pem", "/crl.pem", "a\0b"])
def test_a_link_is_not_made_outside_the_keystore(keystore, place):
    unfinished(keystore, (place, "x"))
    with pytest.raises(KeystoreError, match="this unfinished change cannot be read"):
        Keystore.open(keystore.root, to_change=True)


def test_a_link_is_not_made_through_a_link(keystore, tmp_path):
    (tmp_path / "victim").mkdir()
    unfinished(keystore, ("enclaves/linked/crl.pem", "x"))
    (keystore.root / "enclaves/linked").symlink_to(tmp_path / "victim")
    with pytest.raises(KeystoreError, match="should be a folder, and is not"):
        Keystore.open(keystore.root, to_change=True)
    assert list((tmp_path / "victim").iterdir()) == []


def test_settings_stay_as_they_are(keystore):
    before = json.loads((keystore.root / "pqsec.json").read_bytes())
    take_back(keystore, "/talker")
    assert Keystore.open(keystore.root) == keystore
    assert json.loads((keystore.root / "pqsec.json").read_bytes()) == before
