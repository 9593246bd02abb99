"""A key that was revoked as compromised is certified for nobody again, unless somebody says so."""

from dataclasses import replace
from datetime import timedelta

import pytest
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from pqsec_pki.algorithms import load_public_key, profile_named
from pqsec_pki.certificates import Reason, certificate_request
from pqsec_pki.documents import DomainSet
from pqsec_pki.enrolment import SignRequest, sign, validate_csrs
from pqsec_pki.errors import VerificationError
from pqsec_pki.keystore import audit, key_hashes
from pqsec_pki.lifecycle import ParticipantSpec, PublicKeys, Renewal, issue, renew, revoke
from tests.interop.der import Der
from tests.unit.keystores import made
from tests.unit.killing import NOW, YEAR

ROBOT = "/fleet/robot1"
LENIENT = {"force": True, "after_revocation": True}


@pytest.fixture(params=["classical", "transition", "hybrid", "pq"])
def keystore(request, tmp_path):
    return made(tmp_path / "k", request.param)


class Robot:
    """Keys, and requests for them under any name."""

    def __init__(self, profile):
        second = profile.alternative_key
        self.key = profile.participant_key.generate()
        self.second = second.generate() if second else None

    def request(self, name=ROBOT):
        return certificate_request(name, self.key, self.second)

    def spec(self, keystore, name=ROBOT):
        keys = validate_csrs([self.request(name)], keystore.profiles, names=[name])[name]
        return ParticipantSpec(name=name, domains=DomainSet.of(0), validity=YEAR, keys=keys)


def issued(keystore, *specs, **options):
    return issue(keystore, keystore.unlock(None), specs, now=NOW, **options)


def revoked(keystore, subject=ROBOT, reason=Reason.KEY_COMPROMISE):
    revoke(keystore, keystore.unlock(None), [subject], reason=reason, now=NOW)


@pytest.fixture
def robot(keystore):
    """One whose key was stolen, and its certificate revoked for it."""
    found = Robot(keystore.profile)
    issued(keystore, found.spec(keystore))
    revoked(keystore)
    return found


@pytest.mark.parametrize("name", [ROBOT, "/fleet/robot2"])
def test_its_key_is_refused_under_any_name_unless_told(keystore, robot, name):
    lines = len(keystore.ledger())
    with pytest.raises(VerificationError, match=r"key was revoked as compromised, .* of /fleet/ro"):
        issued(keystore, robot.spec(keystore, name), **LENIENT)
    assert len(keystore.ledger()) == lines
    issued(keystore, robot.spec(keystore, name), **LENIENT, compromised_keys=True)
    audit(keystore)


def test_another_key_of_the_same_robot_is_taken(keystore, robot):
    issued(keystore, Robot(keystore.profile).spec(keystore), **LENIENT)


def test_what_becomes_known_later_counts(tmp_path):
    keystore = made(tmp_path / "k", "classical")
    robot = Robot(keystore.profile)
    issued(keystore, robot.spec(keystore))
    for reason in (Reason.UNSPECIFIED, Reason.KEY_COMPROMISE):
        revoked(keystore, reason=reason)
    with pytest.raises(VerificationError, match="compromised"):
        issued(keystore, robot.spec(keystore), **LENIENT)


@pytest.mark.parametrize("keystore", ["transition"], indirect=True)
def test_each_of_two_keys_counts(keystore, robot):
    other = Robot(keystore.profile)
    for key, second in ((robot.key, other.second), (other.key, robot.second)):
        mixed = Robot(keystore.profile)
        mixed.key, mixed.second = key, second
        with pytest.raises(VerificationError, match="compromised"):
            issued(keystore, mixed.spec(keystore), **LENIENT)


def test_the_same_point_in_another_form_is_the_same_key(tmp_path):
    keystore = made(tmp_path / "k", "classical")
    robot = Robot(keystore.profile)
    issued(keystore, robot.spec(keystore))
    revoked(keystore)
    handle = robot.key.public_key.handle
    point = handle.public_bytes(Encoding.X962, PublicFormat.CompressedPoint)
    whole = robot.key.public_key.spki
    algorithm = whole[2 : 4 + whole[3]]
    short = load_public_key(Der.of(0x30, algorithm + Der.of(3, b"\0" + point)))
    assert short.spki != whole
    assert key_hashes(short) == key_hashes(robot.key.public_key)
    spec = replace(robot.spec(keystore), keys=PublicKeys(short, None, "0" * 64, b"x"))
    with pytest.raises(VerificationError, match="compromised"):
        issued(keystore, spec, **LENIENT)


@pytest.mark.parametrize("reason", [each for each in Reason if each != Reason.KEY_COMPROMISE])
def test_other_reasons_say_nothing_of_the_key(tmp_path, reason):
    keystore = made(tmp_path / "k", "classical")
    robot = Robot(keystore.profile)
    issued(keystore, robot.spec(keystore))
    revoked(keystore, reason=reason)
    issued(keystore, robot.spec(keystore), **LENIENT)


def test_a_renewal_does_not_keep_it(keystore):
    [first] = issued(keystore, Robot(keystore.profile).spec(keystore))
    authorities = keystore.unlock(None)
    renew(keystore, authorities, [ROBOT], now=NOW)
    revoked(keystore, first.serial)  # the newest is another certificate of the same key
    with pytest.raises(VerificationError, match="compromised") as refusal:
        renew(keystore, authorities, [ROBOT], now=NOW)
    assert "pqsec request" in refusal.value.hint
    renew(keystore, authorities, [ROBOT], Renewal(compromised_keys=True), now=NOW)


def test_a_key_that_was_made_here_is_renewed_to_another(tmp_path):
    keystore = made(tmp_path / "k", "classical", names=(ROBOT,))
    authorities = keystore.unlock(None)
    [first] = renew(keystore, authorities, [ROBOT], Renewal(rekey=False), now=NOW)
    renew(keystore, authorities, [ROBOT], Renewal(rekey=False), now=NOW)
    revoked(keystore, first.serial)
    with pytest.raises(VerificationError, match="compromised"):
        renew(keystore, authorities, [ROBOT], Renewal(rekey=False), now=NOW)
    renew(keystore, authorities, [ROBOT], now=NOW)


def test_cas_without_a_network_refuse_it_too(keystore, robot):
    request = robot.request("/fleet/robot2")
    spec = ParticipantSpec(name="/fleet/robot2", domains=DomainSet.of(0), validity=YEAR)
    asked = SignRequest.from_bytes(SignRequest((request,), (spec,)).to_bytes(now=NOW))
    authorities = keystore.unlock(None)
    with pytest.raises(VerificationError, match="compromised"):
        sign(asked, keystore, authorities, now=NOW)
    assert sign(asked, keystore, authorities, now=NOW, compromised_keys=True)


# A key of another's


def test_two_robots_of_one_disk_do_not_share_a_key(keystore):
    robot = Robot(keystore.profile)
    issued(keystore, robot.spec(keystore))
    with pytest.raises(
        VerificationError, match="/copy: its key is that of /fleet/robot1"
    ) as caught:
        issued(keystore, robot.spec(keystore, "/copy"))
    assert "revoke the old name first" in caught.value.hint
    issued(keystore, robot.spec(keystore), force=True)  # itself, again
    revoked(keystore, reason=Reason.SUPERSEDED)
    issued(keystore, robot.spec(keystore, "/copy"))


def test_an_earlier_certificate_keeps_its_key_from_others_until_it_is_revoked(tmp_path):
    keystore = made(tmp_path / "k", "classical")
    first = Robot(keystore.profile)
    [old] = issued(keystore, first.spec(keystore))
    issued(keystore, Robot(keystore.profile).spec(keystore), force=True)
    with pytest.raises(VerificationError, match="/copy: its key is that of /fleet/robot1"):
        issued(keystore, first.spec(keystore, "/copy"))
    revoked(keystore, old.serial, Reason.SUPERSEDED)
    issued(keystore, first.spec(keystore, "/copy"))


def test_two_requests_of_one_key_are_not_answered_together(keystore):
    robot = Robot(keystore.profile)
    with pytest.raises(VerificationError, match="/b: its key is that of /a"):
        issued(keystore, robot.spec(keystore, "/a"), robot.spec(keystore, "/b"))
    assert not keystore.has("/a")


def test_who_has_expired_keeps_no_key_from_another(tmp_path):
    keystore = made(tmp_path / "k", "classical")
    robot = Robot(keystore.profile)
    issued(keystore, robot.spec(keystore))
    specs = [robot.spec(keystore, "/copy")]
    authorities = keystore.unlock(None)
    with pytest.raises(VerificationError, match="that of /fleet/robot1"):
        issue(keystore, authorities, specs, now=NOW + YEAR - timedelta(seconds=1))
    assert issue(keystore, authorities, specs, now=NOW + YEAR + timedelta(seconds=1))


def test_a_ledger_of_before_is_helped_by_the_certificate_that_is_there(tmp_path, monkeypatch):
    keystore = made(tmp_path / "k", "classical")
    robot = Robot(profile_named("classical"))
    with monkeypatch.context() as before:
        before.setattr("pqsec_pki.keystore._entries.keys_detail", lambda _: {})
        issued(keystore, robot.spec(keystore))
    assert "keys" not in keystore.ledger()[-2].details
    revoked(keystore)
    with pytest.raises(VerificationError, match="compromised"):
        issued(keystore, robot.spec(keystore), **LENIENT)
