"""Importing receipts: what the ledger lets count, and what follows about each robot."""

import shutil
from dataclasses import replace

import pytest

from pqsec_pki.certificates import Reason
from pqsec_pki.documents import Governance
from pqsec_pki.enrolment import Bundle, import_receipts, rollback
from pqsec_pki.enrolment.archive import Archive
from pqsec_pki.enrolment.credential_store import CredentialStore, changing
from pqsec_pki.enrolment.receipt import receipt_of
from pqsec_pki.errors import KeystoreError, MalformedError, VerificationError
from pqsec_pki.keystore import InstallState, Keystore, audit, robot_states, status
from pqsec_pki.lifecycle import (
    Renewal,
    Rollover,
    renew,
    renew_list,
    revoke,
    sign_governance,
)
from pqsec_pki.problems import Code
from tests.unit.enrolling import DAY, LATER, ROBOT, answered, asked_of, put
from tests.unit.keystores import enter, made, rotate
from tests.unit.killing import NOW


@pytest.fixture(scope="module")
def original(memory):
    """A keystore, and a robot that has installed its bundle; both to be copied."""
    keystore = made(memory / "k", "transition", names=("/arm", "/leg"))
    robot = memory / "robot"
    put(robot, answered(keystore, asked_of(keystore, robot)))
    return keystore.root, robot


@pytest.fixture
def keystore(original, place):
    shutil.copytree(original[0], place / "k", symlinks=True)
    return Keystore.open(place / "k", to_change=True)


@pytest.fixture
def robot(original, place):
    return shutil.copytree(original[1], place / "robot", symlinks=True)


def receive(keystore, robot, now=LATER, **options):
    return import_receipts(keystore, [robot / "installed.receipt"], now=now, **options)


def state(keystore, name=ROBOT, now=LATER):
    return robot_states(keystore, status(keystore, now=now).participants)[name]


def refused(keystore, robot, code, now=LATER, **options):
    head = keystore.head
    with pytest.raises(VerificationError) as caught:
        receive(keystore, robot, now, **options)
    assert caught.value.codes == {code}
    assert keystore.head == head
    return caught.value


def test_a_receipt_is_recorded_once_and_the_ledger_stays_whole(keystore, robot):
    assert {state(keystore, name).state for name in (ROBOT, "/arm")} == {InstallState.UNKNOWN}
    [done] = receive(keystore, robot)
    assert not done.already
    head = keystore.head
    assert receive(keystore, robot)[0].already
    assert keystore.head == head
    audit(keystore, head)
    [line] = [each for each in keystore.ledger() if each.kind == "receipt"]
    assert line.name == ROBOT
    assert line.sha256 == done.receipt.sha256
    found = state(keystore)
    assert found.receipt == done.receipt
    assert (found.state, found.runs, found.changed) == ("current", found.should_run, ())
    assert state(keystore, "/arm").state is InstallState.UNKNOWN
    assert state(keystore, "/arm").should_run == Bundle.of(keystore, ["/arm"], now=LATER).number


def test_each_change_shows_in_the_files_that_a_robot_lacks(keystore, robot):
    receive(keystore, robot)
    authorities, first = keystore.unlock(None), state(keystore).should_run
    governance = Governance.from_xml((keystore.root / "enclaves/governance.xml").read_bytes())
    sign_governance(keystore, authorities, governance, now=LATER)
    found = state(keystore)
    assert (found.state, found.runs, found.changed) == ("outdated", first, ("governance.p7s",))
    assert found.should_run > first
    renew_list(keystore, authorities, now=LATER)
    assert state(keystore).changed == ("crl.pem", "governance.p7s")
    renew(keystore, authorities, [ROBOT], Renewal(), now=LATER)
    found = state(keystore)
    assert found.changed == ("cert.pem", "crl.pem", "governance.p7s", "permissions.p7s")
    put(robot, Bundle.of(keystore, [ROBOT], now=LATER), now=LATER + DAY)
    receive(keystore, robot, now=LATER + DAY)
    assert state(keystore).state is InstallState.CURRENT
    assert state(keystore).runs == found.should_run
    rollback(robot, now=LATER + 2 * DAY, older=True)
    receive(keystore, robot, now=LATER + 2 * DAY)
    assert (state(keystore).state, state(keystore).runs) == ("outdated", first)


def test_a_robot_that_uses_a_renewed_certificate_is_believed_and_outdated(keystore, robot):
    renew(keystore, keystore.unlock(None), [ROBOT], Renewal(), now=LATER)
    receive(keystore, robot)
    assert state(keystore).changed == ("cert.pem", "permissions.p7s")


def test_a_robot_that_still_has_the_previous_cas_is_believed_and_outdated(keystore, robot):
    rotate(keystore, Rollover(profile=keystore.profile), kept=None, passphrase=None, now=LATER)
    keystore = Keystore.open(keystore.root, to_change=True)
    receive(keystore, robot)
    found = state(keystore)
    assert found.state is InstallState.OUTDATED
    assert {"identity_ca.cert.pem", "permissions_ca.cert.pem"} <= set(found.changed)


def test_a_revoked_robot_is_not_believed_and_should_run_nothing(keystore, robot):
    receive(keystore, robot)
    revoke(keystore, keystore.unlock(None), [ROBOT], now=LATER)
    found = state(keystore)
    assert (found.state, found.should_run, found.changed) == ("none", None, ())
    put_again(robot, NOW + 3 * DAY)
    refused(keystore, robot, Code.REVOKED, now=NOW + 3 * DAY)


def test_a_robot_with_one_revoked_participant_still_tells_what_the_others_run(keystore, place):
    both = place / "both"
    asked = [asked_of(keystore, both, name) for name in (ROBOT, "/fleet/other")]
    put(both, answered(keystore, *asked))
    revoke(keystore, keystore.unlock(None), [ROBOT], now=LATER)
    other, left_out = receive(keystore, both)
    assert (other.receipt.participant, other.revoked) == ("/fleet/other", False)
    assert (left_out.receipt.participant, left_out.revoked) == (ROBOT, True)
    assert state(keystore, "/fleet/other").runs
    assert [each.name for each in keystore.ledger() if each.kind == "receipt"] == ["/fleet/other"]


def put_again(robot, now):
    """The receipt that the robot makes of the same files at another time."""
    with changing(robot) as store:
        current, trust = store.current, store.trust_state.with_next_receipt()
        store.trust(trust)
        data = receipt_of(current.sets, current.numbers, trust, installed_at=current.at, now=now)
        store.save_receipt(data)


def test_a_key_that_was_compromised_is_not_believed_with_another_certificate(keystore, robot):
    authorities = keystore.unlock(None)
    renew(keystore, authorities, [ROBOT], Renewal(), now=LATER)
    [newest] = [each.serial for each in status(keystore, [ROBOT], now=LATER).participants]
    revoke(keystore, authorities, [newest], now=LATER, reason=Reason.KEY_COMPROMISE)
    error = refused(keystore, robot, Code.REVOKED)
    assert "its key was revoked as compromised" in str(error)


def test_a_robot_with_one_compromised_key_still_tells_what_the_others_run(keystore, place):
    both, authorities = place / "both", keystore.unlock(None)
    asked = [asked_of(keystore, both, name) for name in (ROBOT, "/fleet/other")]
    put(both, answered(keystore, *asked))
    renew(keystore, authorities, [ROBOT], Renewal(rekey=False), now=LATER)
    [newest] = [each.serial for each in status(keystore, [ROBOT], now=LATER).participants]
    revoke(keystore, authorities, [newest], now=LATER, reason=Reason.KEY_COMPROMISE)
    found = {each.receipt.participant: each.revoked for each in receive(keystore, both)}
    assert found == {"/fleet/other": False, ROBOT: True}


def test_a_receipt_of_another_keystore_is_refused(keystore, robot, place):
    other = made(place / "other", "transition", names=("/arm",))
    put(place / "stranger", answered(other, asked_of(other, place / "stranger")))
    refused(keystore, place / "stranger", Code.NOT_ISSUED)
    # Also beside a good one: all or none
    files = [each / "installed.receipt" for each in (robot, place / "stranger")]
    head = keystore.head
    with pytest.raises(VerificationError):
        import_receipts(keystore, files, now=LATER)
    assert keystore.head == head


def test_an_older_receipt_is_refused_and_does_not_come_back(keystore, robot):
    early = (robot / "installed.receipt").read_bytes()
    put_again(robot, LATER + DAY)
    receive(keystore, robot, now=LATER + DAY)
    newest = state(keystore).receipt
    (robot / "installed.receipt").write_bytes(early)
    error = refused(keystore, robot, Code.OLDER, now=LATER + DAY)
    assert "--older" in error.hint
    assert state(keystore).receipt == newest
    assert not receive(keystore, robot, now=LATER + DAY, older=True)[0].already
    assert state(keystore).receipt.made_at == LATER


def test_a_folder_of_receipts_may_be_imported_again_and_again(keystore, robot, place):
    for day in (3, 1, 2):
        put_again(robot, LATER + day * DAY)
        shutil.copy(robot / "installed.receipt", place / f"{day}.receipt")
    files = sorted(place.glob("*.receipt"), reverse=True)
    done = import_receipts(keystore, [*files, files[0]], now=LATER + 3 * DAY)
    assert [(each.path.name, each.already) for each in done] == [
        *(("3.receipt", False), ("3.receipt", True), ("1.receipt", False), ("2.receipt", False)),
    ]
    newest, head = state(keystore).receipt, keystore.head
    assert newest.made_at == LATER + 2 * DAY  # made last
    again = import_receipts(keystore, [*files, files[0]], now=LATER + 3 * DAY)
    assert all(each.already for each in again)
    assert (state(keystore).receipt, keystore.head) == (newest, head)


def test_the_same_statement_signed_again_is_the_same_receipt(keystore, robot):
    receive(keystore, robot)
    before = (robot / "installed.receipt").read_bytes()
    current, trust = CredentialStore(robot).current, CredentialStore(robot).trust_state
    data = receipt_of(current.sets, current.numbers, trust, installed_at=current.at, now=LATER)
    (robot / "installed.receipt").write_bytes(data)
    assert data != before
    assert receive(keystore, robot)[0].already


def test_two_altered_files_are_both_named(keystore, robot, place):
    data = (robot / "installed.receipt").read_bytes()
    members = dict(Archive.unpack(data, "receipt").files)
    path = f"enclaves{ROBOT}/receipt.p7s"
    members[path] = members[path].replace(b'"bundle": ', b'"bundle": 1')
    for name in ("one", "two"):
        (place / name).write_bytes(Archive("receipt", {}, members).pack())
    with pytest.raises(VerificationError) as caught:
        import_receipts(keystore, [place / "one", place / "two"], now=LATER)
    assert [each.subject for each in caught.value.problems] == [
        f"{place / name}: {ROBOT}" for name in ("one", "two")
    ]
    (place / "one").write_bytes(b"x")
    with pytest.raises(MalformedError, match="one: not an archive"):
        import_receipts(keystore, [place / "one"], now=LATER)


def test_all_participants_of_a_robot_come_with_one_receipt(keystore, robot):
    put(robot, Bundle.of(keystore, ["/arm"], now=LATER))
    assert {each.receipt.participant for each in receive(keystore, robot)} == {ROBOT, "/arm"}
    assert state(keystore, "/arm").state is InstallState.CURRENT
    assert state(keystore, "/leg").state is InstallState.UNKNOWN


def test_files_that_other_tools_signed_are_compared_as_a_bundle_has_them(keystore, robot):
    """As in an adopted keystore: install writes them again in pqsec's own form."""
    receive(keystore, robot)
    for file in ("permissions.p7s", "cert.pem"):
        path = keystore.root / f"enclaves{ROBOT}/{file}"
        path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    assert state(keystore).changed == ()
    path.write_bytes(b"x")
    assert state(keystore).changed == ("cert.pem",)


def test_a_file_that_only_the_robot_has_is_named(keystore, robot):
    renew_list(keystore, keystore.unlock(None), now=LATER)
    put(robot, Bundle.of(keystore, [ROBOT], now=LATER))
    receive(keystore, robot)
    assert state(keystore).changed == ()
    (keystore.root / f"enclaves{ROBOT}/crl.pem").unlink()
    assert state(keystore).changed == ("crl.pem",)


def test_what_is_current_has_the_keystores_number_whatever_the_receipt_says(keystore, place):
    for number in (None, 7000):
        bundle = replace(Bundle.of(keystore, ["/arm"], now=LATER), number=number)
        put(place / str(number), bundle)
        receive(keystore, place / str(number), older=True)
        found = state(keystore, "/arm")
        assert found.receipt.bundle == number
        assert found.runs == found.should_run == Bundle.of(keystore, ["/arm"], now=LATER).number


def test_a_damaged_line_and_a_missing_file_are_told(keystore, robot):
    [done] = receive(keystore, robot)
    (keystore.root / f"enclaves{ROBOT}/permissions.p7s").unlink()
    with pytest.raises(KeystoreError, match=r"lacks permissions\.p7s"):
        state(keystore)
    with keystore.open_ledger() as ledger:
        [line] = ledger.newest("receipt")
    damaged = replace(line, sha256="0" * 64, details={"statement": "{"})
    enter(keystore, [damaged])
    with pytest.raises(KeystoreError, match="line on receipt /fleet/robot1 is damaged"):
        state(keystore)
    assert done
