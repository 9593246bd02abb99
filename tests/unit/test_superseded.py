"""Certificates that were replaced and are still valid are shown, and ended without the current."""

import shutil

import pytest

from pqsec_pki.certificates import Reason
from pqsec_pki.documents import DomainSet
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import Keystore, load_certificate, superseded_certificates
from pqsec_pki.lifecycle import (
    ParticipantSpec,
    Rollover,
    Scope,
    issue,
    renew,
    revocable,
    revoke,
)
from tests.unit.domains import Scene
from tests.unit.keystores import DAY, NOW, made, rotate
from tests.unit.test_revoke import listed, meeting, serial_of
from tests.unit.test_serve_admission import ADMITTED, Desk, asked


@pytest.fixture
def keystore(tmp_path):
    return made(tmp_path / "k", "classical", names=("/listener", "/talker"))


def superseded(keystore, now=NOW):
    found = superseded_certificates(keystore, now=now)
    return {name: [each.serial for each in those] for name, those in found.items()}


def end(keystore, *names, now=NOW):
    return revoke(
        keystore,
        keystore.unlock(None),
        names,
        superseded=True,
        reason=Reason.SUPERSEDED,
        now=now,
    )


def serial_in(desk):
    return f"{load_certificate(desk.file_of('/r1', 'cert.pem')).serial_number:x}"


def by_renewal(keystore):
    renew(keystore, keystore.unlock(None), ["/talker"], now=NOW)


def by_force(keystore):
    spec = ParticipantSpec(
        name="/talker", domains=DomainSet.of(0), publish=("x",), validity=90 * DAY
    )
    issue(keystore, keystore.unlock(None), [spec], now=NOW, force=True)


def by_loss(keystore):
    shutil.rmtree(keystore.root / "enclaves/talker")
    spec = ParticipantSpec(
        name="/talker", domains=DomainSet.of(0), publish=("x",), validity=90 * DAY
    )
    issue(keystore, keystore.unlock(None), [spec], now=NOW)


@pytest.mark.parametrize("replace", [by_renewal, by_force, by_loss])
def test_each_way_to_replace_a_certificate_leaves_one_that_is_shown_and_ended(keystore, replace):
    """Three were valid, `status` showed one, and `revoke NAME` ended the new one too."""
    first = serial_of(keystore, "/talker")
    assert superseded(keystore) == {}
    replace(keystore)
    second = serial_of(keystore, "/talker")
    assert superseded(keystore) == {"/talker": [first]}
    found, _ = end(keystore, "/talker")
    assert [(each.serial, each.reason) for each in found] == [(first, "superseded")]
    assert listed(keystore) == [first]
    assert second not in listed(keystore)
    assert superseded(keystore) == {}
    assert meeting(keystore).ok


def test_a_domain_file_that_replaces_leaves_one_that_is_shown(tmp_path):
    scene = Scene(tmp_path)
    scene.apply()
    shutil.rmtree(scene.root / "enclaves/r1")
    scene.apply()
    assert list(superseded(scene.keystore)) == ["/r1"]


def test_a_token_that_replaces_and_a_renewal_at_the_server_leave_one_that_is_shown(tmp_path):
    desk = Desk(tmp_path)
    assert desk.ask(asked("/r1"), desk.token("/r1")) == ADMITTED
    first = serial_in(desk)
    assert desk.ask(asked("/r1", "second"), desk.token("/r1", replaces=True)) == ADMITTED
    second = serial_in(desk)
    assert superseded(desk.keystore) == {"/r1": [first]}
    shown = desk.certificate()
    assert desk.ask(asked("/r1", "third"), shown, renew_any_time=True) == ADMITTED
    assert superseded(desk.keystore) == {"/r1": [first, second]}


def test_several_are_ended_at_once_and_those_that_expired_are_not_shown(keystore):
    for day in (1, 2):
        renew(keystore, keystore.unlock(None), ["/talker"], now=NOW + day * DAY)
    assert len(superseded(keystore, NOW + 3 * DAY)["/talker"]) == 2
    assert len(superseded(keystore, NOW + 90.5 * DAY)["/talker"]) == 1
    assert superseded(keystore, NOW + 95 * DAY) == {}
    end(keystore, "/talker", "/listener", now=NOW + 3 * DAY)
    assert len(listed(keystore)) == 2


def test_what_was_revoked_is_not_shown_again_and_the_newest_may_be_revoked_alone(keystore):
    """The current certificate was revoked by its number: the one before is still valid."""
    first = serial_of(keystore, "/talker")
    by_renewal(keystore)
    revoke(keystore, keystore.unlock(None), [serial_of(keystore, "/talker")], now=NOW)
    assert superseded(keystore) == {"/talker": [first]}
    revoke(keystore, keystore.unlock(None), ["/talker"], now=NOW)
    assert superseded(keystore) == {}


def test_a_name_still_revokes_all_of_its_certificates(keystore):
    by_renewal(keystore)
    found, _ = revoke(keystore, keystore.unlock(None), ["/talker"], now=NOW)
    assert len(found) == 2


def test_certificates_of_a_ca_that_was_replaced_are_not_superseded(keystore):
    """No list has them; robots with the new CA's files refuse them."""
    terms = Rollover(profile=keystore.profile, scope=Scope.BOTH)
    rotate(keystore, terms, now=NOW)
    assert superseded(Keystore.open(keystore.root)) == {}


def test_who_has_one_certificate_keeps_it(keystore):
    assert revocable(keystore, ["/talker"], superseded=True, now=NOW) == []
    with pytest.raises(KeystoreError, match="no participant /talkr"):
        revocable(keystore, ["/talkr"], superseded=True, now=NOW)
