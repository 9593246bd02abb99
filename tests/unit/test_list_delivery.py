"""Which robots lack the newest revocation list, by their receipts, and what they still accept."""

import shutil
from dataclasses import replace

import pytest

from pqsec_pki.certificates import Reason
from pqsec_pki.enrolment import Bundle, import_receipts
from pqsec_pki.enrolment.credential_store import CredentialStore
from pqsec_pki.keystore import ADMISSION, Entry, Keystore, Way, change, list_delivery
from pqsec_pki.lifecycle import Rollover, Scope, renew, renew_list, revoke, store_groups
from tests.unit.enrolling import DAY, LATER, ROBOT, answered, asked_of, put
from tests.unit.keystores import begin_overlap, enter, made, rotate
from tests.unit.killing import NOW, YEAR

THIEF = "/thief"


@pytest.fixture(scope="module")
def model(memory):
    """A keystore, and a robot that has installed; both to be copied."""
    keystore = made(memory / "delivery", "classical", names=("/arm", THIEF))
    robot = memory / "robot"
    put(robot, answered(keystore, asked_of(keystore, robot)))
    return keystore, robot


class Fleet:
    """One robot with receipts, one without, and who was stolen."""

    def __init__(self, model, place):
        shutil.copytree(model[0].root, place / "k", symlinks=True)
        self.robot = shutil.copytree(model[1], place / "robot", symlinks=True)
        self.keystore = Keystore.open(place / "k", to_change=True)
        self.cas = self.keystore.unlock(None)

    def revoke(self, *names, now=LATER, **how):
        return revoke(self.keystore, self.cas, names or [THIEF], now=now, **how)

    def install(self, now=LATER):
        put(self.robot, Bundle.of(self.keystore, [ROBOT], now=now), now=now)

    def receive(self, now=LATER):
        path = CredentialStore(self.robot).receipt
        import_receipts(self.keystore, [path], now=now)

    def late(self, now=LATER):
        found = list_delivery(self.keystore, now=now)
        return {each.name: each for each in found.late}

    def said(self, now=LATER):
        return "\n".join(list_delivery(self.keystore, now=now).lines)


@pytest.fixture
def fleet(model, place):
    return Fleet(model, place)


def test_without_a_list_there_is_nothing_to_deliver(fleet):
    assert list_delivery(fleet.keystore, now=LATER) is None


def test_a_robot_without_a_receipt_counts_as_one_that_accepts_the_thief(fleet):
    """`revoke` said that a ROS 2 user has nothing to do, and the robots went on accepting."""
    fleet.revoke()
    found = list_delivery(fleet.keystore, now=LATER)
    assert (found.number, found.robots, found.without_receipt) == (1, 2, 2)
    assert [each.name for each in found.late] == ["/arm", ROBOT]
    [accepted] = found.accepted
    assert (accepted.name, accepted.list_number, accepted.rights) == (THIEF, 1, ("publish x",))
    assert found.until == accepted.not_after == NOW + 90 * DAY
    said = fleet.said()
    assert "2 of 2 robots do not have list 1 yet (2 without a receipt: not known)" in said
    assert "they accept /thief (publish x); at the latest until 2027-02-19 12:00 UTC" in said


def test_who_was_revoked_needs_no_list(fleet):
    fleet.revoke(THIEF, "/arm")
    assert set(fleet.late()) == {ROBOT}


def test_a_receipt_with_the_newest_list_is_believed_and_an_older_one_is_not(fleet):
    fleet.receive()
    fleet.revoke()
    assert fleet.late()[ROBOT].has_receipt
    assert fleet.late()[ROBOT].list_number is None
    fleet.install(LATER + DAY)
    assert ROBOT in fleet.late()  # nobody told the keystore
    fleet.receive(LATER + DAY)
    assert ROBOT not in fleet.late()
    assert list_delivery(fleet.keystore, now=LATER).without_receipt == 1
    fleet.revoke("/arm", now=LATER + DAY)
    [robot] = fleet.late().values()
    assert (robot.name, robot.list_number) == (ROBOT, 1)


def test_a_robot_accepts_only_what_its_own_list_lacks(fleet):
    fleet.revoke()
    fleet.install()
    fleet.receive()
    fleet.keystore = Keystore.open(fleet.keystore.root, to_change=True)
    fleet.revoke("/arm", now=LATER + DAY)
    found = list_delivery(fleet.keystore, now=LATER + DAY)
    assert [(each.name, each.list_number) for each in found.accepted] == [("/arm", 2)]
    renew_list(fleet.keystore, fleet.cas, now=LATER + DAY)
    [robot] = fleet.late(LATER + DAY).values()
    assert (robot.list_number, robot.until) == (1, NOW + 90 * DAY)


def test_a_newer_list_with_the_same_content_lets_nobody_in_who_lacks_it(fleet):
    fleet.revoke()
    fleet.install()
    fleet.receive()
    renew_list(fleet.keystore, fleet.cas, now=LATER + DAY)
    fleet.revoke("/arm", now=LATER + 2 * DAY, validity=YEAR)
    fleet.install(LATER + 2 * DAY)
    fleet.receive(LATER + 2 * DAY)
    renew_list(fleet.keystore, fleet.cas, now=LATER + 3 * DAY)
    found = list_delivery(fleet.keystore, now=LATER + 3 * DAY)
    assert [each.until for each in found.late] == [None]
    assert (found.accepted, found.until) == ((), None)
    assert "none of them accepts a revoked certificate" in fleet.said(LATER + 3 * DAY)


def test_a_robot_accepts_until_its_own_list_ends_if_that_is_first(fleet):
    """Its stack refuses every peer from then on."""
    fleet.revoke(validity=20 * DAY)
    fleet.install()
    fleet.receive()
    fleet.revoke("/arm", now=LATER + DAY)
    [robot] = fleet.late(LATER + DAY).values()
    assert robot.until == robot.list_ends == LATER + 20 * DAY
    [robot] = fleet.late(LATER + 21 * DAY).values()
    assert robot.until is None
    assert list_delivery(fleet.keystore, now=LATER + 21 * DAY).accepted == ()


def test_what_has_expired_is_accepted_by_nobody(fleet):
    fleet.revoke()
    later = NOW + 91 * DAY
    found = list_delivery(fleet.keystore, now=later)
    assert found.accepted == ()
    assert [each.name for each in found.late] == [ROBOT]  # /arm has expired too


def test_after_a_change_of_the_ca_robots_with_the_files_of_the_one_before_are_counted(fleet):
    """No list of the new CA has the thief, and /arm may never have got a list of the old one."""
    fleet.revoke()
    fleet.install()
    fleet.receive()
    terms = Rollover(profile=fleet.keystore.profile, scope=Scope.IDENTITY)
    rotate(fleet.keystore, terms, now=LATER, kept=fleet.cas)
    fleet.keystore = Keystore.open(fleet.keystore.root, to_change=True)
    found = list_delivery(fleet.keystore, now=LATER)
    assert found.number == 1
    assert [(each.name, each.list_number) for each in found.accepted] == [(THIEF, None)]
    late = fleet.late()
    assert late[ROBOT].list_number is None
    assert late[ROBOT].until is None  # its list has the thief
    assert late["/arm"].until == NOW + 90 * DAY


def test_the_commands_fit_how_files_get_to_the_robot(fleet):
    """A hint that is pasted must work: a robot with its own keys installs, a copy is copied."""
    fleet.revoke()
    found = list_delivery(fleet.keystore, now=LATER)
    assert {each.name: each.way for each in found.late} == {"/arm": Way.COPY, ROBOT: Way.BUNDLE}
    bundle, copy = found.commands
    assert bundle.startswith(f"pqsec -k {fleet.keystore.root} bundle {ROBOT} --outdated --no-keys")
    assert copy == f"pqsec -k {fleet.keystore.root} ca crl --show --force -o crl.pem"
    admitted = Entry.of(ADMISSION, "token 1", "0" * 64, LATER, details={"participant": ROBOT})
    enter(fleet.keystore, [admitted])
    assert fleet.late()[ROBOT].way is Way.FETCH
    assert "`pqsec renew --from` fetches it" in fleet.said()


def test_what_was_installed_from_a_bundle_gets_the_next_one(fleet):
    """Its keys are here, so it counted as a copy, and the file would be overwritten."""
    arm = fleet.robot.parent / "arm"
    put(arm, Bundle.of(fleet.keystore, ["/arm"], now=LATER))
    fleet.robot = arm
    fleet.receive()
    fleet.revoke()
    assert fleet.late()["/arm"].way is Way.BUNDLE


def test_while_two_cas_are_trusted_there_is_no_list_to_deliver(fleet):
    renew_list(fleet.keystore, fleet.cas, now=LATER)
    assert fleet.late()
    terms = Rollover(profile=fleet.keystore.profile, scope=Scope.IDENTITY)
    begin_overlap(fleet.keystore, terms, now=LATER, kept=fleet.cas)
    assert list_delivery(Keystore.open(fleet.keystore.root), now=LATER) is None


def test_groups_of_the_domain_file_are_counted(fleet):
    fleet.revoke()
    groups = {"hall1": ("/arm", THIEF), "all": ("/arm", ROBOT)}
    store_groups(fleet.keystore, groups)
    assert "by group: @all: 2, @hall1: 1" in fleet.said()
    assert list_delivery(fleet.keystore, now=LATER).to_json()["groups"] == {"hall1": 1, "all": 2}
    (fleet.keystore.root / "groups.json").write_text("{")
    assert "2 of 2 robots" in fleet.said()


def test_ten_names_are_shown_and_json_has_all(fleet):
    fleet.revoke()
    found = list_delivery(fleet.keystore, now=LATER)
    many = replace(found, late=tuple(replace(found.late[0], name=f"/r{n:02}") for n in range(12)))
    assert many.names.endswith("/r09 (no receipt) and 2 more")
    assert len(many.to_json()["late"]) == 12


def test_a_participant_whose_folder_is_gone_still_drives(fleet):
    shutil.rmtree(fleet.keystore.root / "enclaves/arm")
    fleet.revoke()
    assert "/arm" in fleet.late()


def test_rights_that_cannot_be_read_are_not_said(fleet):
    fleet.revoke()
    (fleet.keystore.root / "enclaves/thief/permissions.p7s").write_bytes(b"x")
    assert "they accept /thief; at the latest until" in fleet.said()


def test_one_who_was_revoked_by_serial_and_renewed_is_accepted_with_the_old_certificate(fleet):
    """After a theft the owner renews, and revokes the one before."""
    renew(fleet.keystore, fleet.cas, [THIEF], now=LATER)
    fleet.revoke(superseded=True, reason=Reason.KEY_COMPROMISE)
    found = list_delivery(fleet.keystore, now=LATER)
    assert [each.name for each in found.accepted] == [THIEF]
    assert [each.name for each in found.late] == ["/arm", ROBOT, THIEF]


def test_no_participant_needs_no_list(place):
    keystore = made(place / "none", "classical", names=())
    renew_list(keystore, keystore.unlock(None), now=LATER)
    assert list_delivery(keystore, now=LATER).lines == ("no robot needs it",)


def test_a_damaged_receipt_is_an_error_and_not_a_robot_that_has_the_list(fleet):
    fleet.receive()
    fleet.revoke()
    with change(fleet.keystore.root) as draft:
        draft.entries += [Entry.of("receipt", ROBOT, "1" * 64, LATER, details={"statement": "x"})]
    with pytest.raises(Exception, match="damaged"):
        list_delivery(fleet.keystore, now=LATER)
