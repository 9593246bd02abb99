"""Clocks that were wrong: robots order by numbers, CAs ask whether their clock can be right."""

import json
from dataclasses import replace

import pytest

from pqsec_pki.credentials import PROOF, Credentials
from pqsec_pki.documents import Governance
from pqsec_pki.enrolment import Bundle, install, problems_where_installed, rollback
from pqsec_pki.enrolment.credential_store import CredentialStore
from pqsec_pki.enrolment.robot_clock import verification_time
from pqsec_pki.enrolment.trust import Marks, TrustState
from pqsec_pki.errors import KeystoreError, VerificationError
from pqsec_pki.keystore import CLOCK_SKEW, Keystore, State, list_status, status, was_ahead
from pqsec_pki.keystore.signing_clock import refuse_wrong_clock
from pqsec_pki.lifecycle import (
    ParticipantSpec,
    Renewal,
    Rollover,
    Scope,
    adopt,
    issue,
    renew,
    renew_list,
    revoke,
    sign_governance,
)
from pqsec_pki.lint import check
from pqsec_pki.problems import Code
from pqsec_pki.server.list_keeping import keep_list
from pqsec_pki.transparency import LedgerProof
from tests.unit.enrolling import with_files
from tests.unit.keystores import DAY, NOW, begin_overlap, made, rotate

MONTH, ROBOT = 30 * DAY, "/talker"
KEEP = Renewal(rekey=False)
SECOND = CLOCK_SKEW / 86400


@pytest.fixture
def keystore(tmp_path):
    return made(tmp_path / "k", "classical")


def cas(keystore, *, any_clock=False):
    """The CAs as commands open them; `any_clock` is with --accept-clock."""
    return replace(keystore.unlock(None), compares_clock=not any_clock)


def bundle(keystore, *names, now=NOW):
    return Bundle.of(keystore, names or [ROBOT], now=now)


def put(robot, made_bundle, now=NOW, **options):
    """Install it, and trust its CAs if none are trusted yet."""
    given = {"trust_first": not (robot / "trust.json").exists(), **options}
    return install(made_bundle.to_bytes(), robot, now=now, **given)


def sign(keystore, now, *, any_clock=False):
    """The governance, signed again."""
    governance = Governance.protected(keystore.domains)
    sign_governance(keystore, cas(keystore, any_clock=any_clock), governance, now=now)


# Robots


def test_a_governance_from_the_future_does_not_hold_up_the_first_revocation(keystore, tmp_path):
    robot = tmp_path / "robot"
    sign(keystore, NOW + MONTH)  # the mistake
    done = put(robot, bundle(keystore))
    assert [each.code for each in done.future] == [Code.NOT_YET_VALID]
    assert "signed 2026-12-21" in str(done.future[0])
    sign(keystore, NOW + DAY, any_clock=True)
    revoke(keystore, cas(keystore), ["/listener"], now=NOW + DAY)
    done = put(robot, bundle(keystore, now=NOW + DAY), now=NOW + DAY)
    assert not done.already
    assert done.future == ()
    [(_, files)] = CredentialStore(robot).current.enclaves.items()
    assert "crl.pem" in files


@pytest.mark.parametrize("clock", [NOW, NOW - 20_000 * DAY])
def test_permissions_and_certificates_from_the_future_give_way_to_those_of_now(
    keystore, tmp_path, clock
):
    """With a robot's clock that was ahead too, or is in 1970 at the end."""
    robot, late = tmp_path / "robot", NOW + MONTH
    renew(keystore, cas(keystore), [ROBOT], KEEP, now=late)
    put(robot, bundle(keystore, now=late), now=late)
    renew(keystore, cas(keystore, any_clock=True), [ROBOT], KEEP, now=NOW)
    put(robot, bundle(keystore), now=clock)
    assert CredentialStore(robot).current.path.name == "2"


def test_no_clock_of_a_robot_brings_back_an_older_bundle(keystore, tmp_path):
    robot, old = tmp_path / "robot", bundle(keystore)
    renew(keystore, cas(keystore), [ROBOT], KEEP, now=NOW + DAY)
    put(robot, bundle(keystore, now=NOW + DAY), now=NOW + DAY)
    kept = CredentialStore(robot).trust_state
    for clock in (NOW - 20_000 * DAY, NOW, NOW + 30 * DAY):
        with pytest.raises(VerificationError, match="older than one installed before"):
            put(robot, old, now=clock)
    assert CredentialStore(robot).trust_state == kept
    put(robot, old, older=True)  # the marks stay
    assert CredentialStore(robot).trust_state == kept.with_next_receipt()
    with pytest.raises(VerificationError, match="older"):
        put(robot, old)


@pytest.mark.parametrize("file", ["cert.pem", "permissions.p7s", "governance.p7s"])
def test_one_older_file_in_a_newer_bundle_is_refused(keystore, tmp_path, file):
    """Also one that was signed later, by a clock that was ahead."""
    robot, late = tmp_path / "robot", NOW + MONTH
    renew(keystore, cas(keystore), [ROBOT], KEEP, now=late)
    sign(keystore, late)
    early = bundle(keystore, now=late).enclaves[ROBOT][file]
    renew(keystore, cas(keystore, any_clock=True), [ROBOT], KEEP, now=NOW + DAY)
    sign(keystore, NOW + DAY)
    newest = bundle(keystore, now=NOW + DAY)
    put(robot, newest, now=late)
    mixed = with_files(newest, ROBOT, **{file.replace(".", "_"): early})
    with pytest.raises(VerificationError, match=r"older than one installed before") as refused:
        put(robot, mixed, now=late)
    assert [each.subject for each in refused.value.problems] == [f"{ROBOT}: {file}"]


def test_an_older_governance_in_one_enclave_of_two_is_refused(keystore, tmp_path):
    before = bundle(keystore).enclaves[ROBOT]["governance.p7s"]
    sign(keystore, NOW)
    both = bundle(keystore, "/listener", ROBOT)
    with pytest.raises(VerificationError, match="governance is older"):
        put(tmp_path / "robot", with_files(both, ROBOT, governance_p7s=before))
    put(tmp_path / "robot", both)


def test_a_rollover_with_the_right_clock_follows_a_future_one(keystore, tmp_path):
    robot = tmp_path / "robot"
    renew(keystore, cas(keystore), [ROBOT], KEEP, now=NOW + MONTH)
    put(robot, bundle(keystore, now=NOW + MONTH), now=NOW + MONTH)
    terms = Rollover(profile=keystore.profile, validity=900 * DAY)
    with pytest.raises(KeystoreError, match="newest line"):
        rotate(keystore, terms, now=NOW + DAY, compares_clock=True)
    keystore = rotate(keystore, terms, now=NOW + DAY).keystore
    new = bundle(keystore, now=NOW + DAY)
    put(robot, new, now=NOW + DAY, pins=new.roles)
    sign(keystore, NOW + DAY)
    put(robot, bundle(keystore, now=NOW + DAY), now=NOW + DAY)


def test_a_rollback_with_a_right_or_wrong_clock_needs_the_option(keystore, tmp_path):
    robot = tmp_path / "robot"
    put(robot, bundle(keystore))
    renew(keystore, cas(keystore), [ROBOT], KEEP, now=NOW + DAY)
    put(robot, bundle(keystore, now=NOW + DAY), now=NOW + DAY)
    for clock in (NOW - 20_000 * DAY, NOW + DAY):
        with pytest.raises(VerificationError, match="older"):
            rollback(robot, now=clock)


def test_what_has_no_number_is_older_than_what_has_one(keystore, tmp_path):
    robot = tmp_path / "robot"
    put(robot, bundle(keystore))
    xml = (keystore.root / "enclaves/governance.xml").read_bytes()
    plain = cas(keystore).sign(xml, now=NOW + DAY)
    with pytest.raises(VerificationError, match="governance is older"):
        put(robot, with_files(bundle(keystore), ROBOT, governance_p7s=plain))


def test_certificates_and_lists_that_begin_after_the_robots_clock_are_told(keystore, tmp_path):
    revoke(keystore, cas(keystore), ["/listener"], now=NOW + DAY)
    done = put(tmp_path / "robot", bundle(keystore, now=NOW + DAY), now=NOW - 20_000 * DAY)
    told = {each.subject for each in done.future if "a clock is wrong" in str(each)}
    assert told == {f"{ROBOT}: cert.pem", f"{ROBOT}: crl.pem"}


def test_a_clock_before_a_new_ca_and_after_the_others_is_believed(keystore):
    """In an overlap; a clock from before all CAs is not."""
    terms = Rollover(profile=keystore.profile, scope=Scope.IDENTITY)
    begin_overlap(keystore, terms, kept=cas(keystore), passphrase=None, now=NOW + MONTH)
    found = bundle(keystore, now=NOW + MONTH).credentials
    assert verification_time(found, None, NOW) == NOW
    assert verification_time(found, None, NOW - MONTH) > NOW


def test_older_credentials_of_other_cas_are_not_proposed_with_older(keystore, tmp_path):
    older, other = bundle(keystore), bundle(made(tmp_path / "other", "classical"))
    renew(keystore, cas(keystore), [ROBOT], KEEP, now=NOW)
    for each in (bundle(keystore), other):
        put(tmp_path / "robot", each, pins=each.roles)
    with pytest.raises(VerificationError, match="is older") as refused:
        put(tmp_path / "robot", older, pins=older.roles)
    assert "credentials of other CAs" in refused.value.hint


# The head of the ledger


@pytest.fixture
def fork(keystore, tmp_path):
    """A robot with the head of the newest ledger; and a copy of the keystore from before."""
    made(tmp_path / "thief" / "k", "classical")
    for _ in range(3):
        renew(keystore, cas(keystore), [ROBOT], KEEP, now=NOW)
    put(tmp_path / "robot", bundle(keystore), proofs=True)
    return Keystore.open(tmp_path / "thief" / "k", to_change=True)


def test_a_smaller_head_is_refused(fork, tmp_path):
    sign(fork, NOW)
    with pytest.raises(VerificationError, match="of an older ledger") as refused:
        put(tmp_path / "robot", bundle(fork))
    assert Code.OLDER in refused.value.codes


def test_a_smaller_head_than_that_of_an_older_pqsecs_set_is_refused(fork, tmp_path):
    (tmp_path / "robot/trust.json").unlink()  # which it did not write
    sign(fork, NOW)
    with pytest.raises(VerificationError, match="of an older ledger") as refused:
        put(tmp_path / "robot", bundle(fork), trust_first=False)
    assert Code.OLDER in refused.value.codes


def test_a_set_of_an_older_pqsec_that_has_no_proof_has_no_head(keystore, tmp_path):
    put(tmp_path / "robot", replace(bundle(keystore), proof=None))
    (tmp_path / "robot/trust.json").unlink()
    assert put(tmp_path / "robot", bundle(keystore), trust_first=False).names == (ROBOT,)


def test_a_fork_of_the_same_size_is_refused(fork, keystore, tmp_path):
    while len(fork.ledger()) < len(keystore.ledger()):
        sign(fork, NOW + DAY)
    while len(fork.ledger()) > len(keystore.ledger()):
        sign(keystore, NOW)
    put(tmp_path / "robot", bundle(keystore))
    with pytest.raises(VerificationError, match="are not those seen here"):
        put(tmp_path / "robot", bundle(fork))


def test_a_restored_older_ledger_at_the_ca_shows_on_robots(keystore, tmp_path):
    ledger = keystore.root / "private/ledger.sqlite3"
    before = {each: each.read_bytes() for each in (ledger, *(keystore.root / "public").iterdir())}
    renew(keystore, cas(keystore), [ROBOT], KEEP, now=NOW)
    put(tmp_path / "robot", bundle(keystore))
    for path, data in before.items():
        path.write_bytes(data)
    issue(keystore, cas(keystore), [spec(keystore)], now=NOW, force=True)
    with pytest.raises(VerificationError, match="of another ledger"):
        put(tmp_path / "robot", bundle(keystore))


def spec(keystore):
    return ParticipantSpec(name=ROBOT, domains=keystore.domains, publish=("x",), validity=90 * DAY)


def test_a_check_finds_a_head_that_is_older_than_one_seen(fork, tmp_path):
    robot = tmp_path / "robot"

    def found():
        report = check([robot], now=NOW, proofs=True, compare=problems_where_installed)
        return [each.message for each in report.findings if each.rule.id == "PQS319"]

    assert found() == []
    put(robot, bundle(fork), older=True)
    assert any("of an older ledger" in each for each in found())


def test_only_the_current_set_of_a_robot_is_compared_with_the_head_seen(fork, tmp_path):
    robot = tmp_path / "robot"
    put(robot, bundle(fork), older=True)
    current, trust = robot / "current", robot / "trust.json"
    found = CredentialStore(robot).current
    files = found.enclaves[ROBOT]
    head = LedgerProof.from_bytes(files[PROOF]).checkpoint.head

    def problems():
        return list(
            problems_where_installed(
                found.path / "enclaves/talker", Credentials.of(ROBOT, files), head
            )
        )

    assert [each.code for each in problems()] == [Code.OLDER]
    trust.rename(robot / "trust.kept")
    assert problems() == []
    (robot / "trust.kept").rename(trust)
    current.unlink()
    assert problems() == []
    current.symlink_to("installed/1")
    assert problems() == []


def test_bundles_for_two_participants_are_installed_in_any_order(keystore, tmp_path):
    first = bundle(keystore, "/listener")
    renew(keystore, cas(keystore), [ROBOT], KEEP, now=NOW)
    put(tmp_path / "robot", bundle(keystore))
    assert put(tmp_path / "robot", first).names == ("/listener",)


def test_marks_never_decrease(keystore):
    files = bundle(keystore).enclaves[ROBOT]
    found = Marks.of(Credentials.of(ROBOT, files))
    lower = Marks(numbers={key: number - 1 for key, number in found.numbers.items()})
    assert found.raised_by(lower) == lower.raised_by(found) == found


@pytest.mark.parametrize(
    "change",
    [
        lambda marks: marks.update(numbers={"x": "7"}),
        lambda marks: marks.update(numbers={"x": -1}),
        lambda marks: marks.update(numbers={"x": True}),
        lambda marks: marks.update(lists=[]),
        lambda marks: marks.update(heads={"x": {"origin": "o", "size": 1, "root": "00"}}),
        lambda marks: marks.update(heads={"x": {"origin": 1, "size": 1, "root": "00" * 32}}),
        lambda marks: marks.update(heads={"x": {}}),
        lambda marks: marks.pop("heads"),
    ],
)
def test_a_damaged_mark_is_an_error(keystore, tmp_path, change):
    put(tmp_path / "robot", bundle(keystore))
    value = json.loads((tmp_path / "robot/trust.json").read_bytes())
    TrustState.from_json(json.dumps(value).encode())
    change(value["marks"])
    with pytest.raises(KeystoreError, match="cannot be read"):
        TrustState.from_json(json.dumps(value).encode())


# The clock of the CA


SIGNING = {
    "issue": lambda k, a, now: issue(k, a, [spec(k)], now=now, force=True),
    "renew": lambda k, a, now: renew(k, a, [ROBOT], KEEP, now=now),
    "revoke": lambda k, a, now: revoke(k, a, [ROBOT], now=now),
    "list": lambda k, a, now: renew_list(k, a, now=now),
    "governance": lambda k, a, now: sign_governance(k, a, Governance.protected(k.domains), now=now),
}


@pytest.mark.parametrize("signs", SIGNING.values(), ids=SIGNING)
def test_a_clock_behind_the_ledger_signs_nothing(keystore, signs):
    renew(keystore, cas(keystore), [ROBOT], KEEP, now=NOW + MONTH)
    lines = len(keystore.ledger())
    with pytest.raises(KeystoreError, match="the ledger's newest line is of 2026-12-21") as refused:
        signs(keystore, cas(keystore), NOW + MONTH - CLOCK_SKEW - SECOND)
    assert "--accept-clock" in refused.value.hint
    assert len(keystore.ledger()) == lines
    signs(keystore, cas(keystore), NOW + MONTH - CLOCK_SKEW)


@pytest.mark.parametrize("signs", SIGNING.values(), ids=SIGNING)
def test_the_option_accepts_the_clock_once(keystore, signs):
    renew(keystore, cas(keystore), [ROBOT], KEEP, now=NOW + MONTH)
    signs(keystore, cas(keystore, any_clock=True), NOW + DAY)
    sign(keystore, NOW + DAY)  # the newest line is right again


def test_a_list_of_the_future_asks_for_the_option_until_there_is_another(keystore):
    renew_list(keystore, cas(keystore), now=NOW + MONTH)
    sign(keystore, NOW, any_clock=True)
    with pytest.raises(KeystoreError, match="the newest revocation list was signed on 2026-12-21"):
        sign(keystore, NOW)
    renew_list(keystore, cas(keystore, any_clock=True), now=NOW)
    sign(keystore, NOW)


def test_nothing_is_signed_before_the_cas_begin(keystore):
    with pytest.raises(KeystoreError, match=r"the clock says 1970"):
        sign(keystore, NOW.replace(year=1970))


def test_nothing_is_signed_when_list_and_governance_have_ended(keystore):
    renew_list(keystore, cas(keystore), now=NOW, validity=365 * DAY)
    revoke(keystore, cas(keystore), ["/listener"], now=NOW + DAY, validity=365 * DAY)
    with keystore.open_ledger() as ledger:
        refuse_wrong_clock(ledger, cas(keystore), NOW + 899 * DAY)
        refuse_wrong_clock(ledger, cas(keystore, any_clock=True), NOW + 901 * DAY)
        with pytest.raises(KeystoreError, match="the revocation list ended on 2027-11-22"):
            refuse_wrong_clock(ledger, cas(keystore), NOW + 901 * DAY)


def test_a_line_that_was_not_signed_does_not_vouch_for_the_clock(keystore):
    from pqsec_pki.keystore import Entry, change  # noqa: PLC0415

    with change(keystore.root) as transaction:
        transaction.record(Entry.of("enrolment-token", "t", "00" * 32, NOW - MONTH))
    with pytest.raises(KeystoreError, match="newest line"):
        sign(keystore, NOW - CLOCK_SKEW - SECOND)


# Not yet valid


def test_what_is_not_yet_valid_is_seen(keystore):
    renew(keystore, cas(keystore), [ROBOT], KEEP, now=NOW + 450 * DAY)
    renew_list(keystore, cas(keystore), now=NOW + 450 * DAY)
    found = status(keystore, now=NOW)
    states = {each.name: each.state for each in found.participants}
    assert states == {ROBOT: State.NOT_YET_VALID, "/listener": State.VALID}
    assert found.due == [ROBOT]
    assert found.list_is_due
    assert {what for what, _ in found.future} == {"the ledger's newest line", "the revocation list"}
    renew(keystore, cas(keystore, any_clock=True), found.due, KEEP, now=NOW)
    after = status(keystore, now=NOW)
    assert (after.due, after.list_is_due, after.future) == ([], False, ())


@pytest.mark.parametrize(
    ("begin", "state"),
    [(SECOND, State.NOT_YET_VALID), (0 * DAY, State.VALID), (-61 * DAY, State.DUE)],
)
def test_a_certificate_is_valid_from_its_begin(begin, state):
    made_at, end = NOW, NOW + 90 * DAY
    assert State.at(NOW - begin, made_at, end, None) is state


def test_the_list_is_made_again_when_the_clock_is_right_again(keystore):
    assert keep_list(keystore, cas(keystore), 365 * DAY, now=NOW + MONTH)
    assert keep_list(keystore, cas(keystore), 365 * DAY, now=NOW + DAY)
    found = keystore.revocation_list
    assert (found.number, found.this_update) == (2, NOW)
    assert not keep_list(keystore, cas(keystore), 365 * DAY, now=NOW + DAY)
    sign(keystore, NOW + DAY)  # all else is signed again


def test_the_list_vouches_for_a_clock_after_others_signed_in_the_future(keystore):
    keep_list(keystore, cas(keystore), 365 * DAY, now=NOW)
    renew(keystore, cas(keystore), [ROBOT], KEEP, now=NOW + 40 * DAY)
    assert keep_list(keystore, cas(keystore), 365 * DAY, now=NOW + DAY)
    renew(keystore, cas(keystore), [ROBOT], KEEP, now=NOW + DAY)


def test_a_clock_that_is_behind_a_busy_ledger_heals_nothing(keystore):
    keep_list(keystore, cas(keystore), 365 * DAY, now=NOW)
    for days in range(5, 46, 10):
        renew(keystore, cas(keystore), [ROBOT], KEEP, now=NOW + days * DAY)
    lines = len(keystore.ledger())
    assert not keep_list(keystore, cas(keystore), 365 * DAY, now=NOW + 2 * DAY)
    with pytest.raises(KeystoreError, match="newest line"):
        renew(keystore, cas(keystore), [ROBOT], KEEP, now=NOW + 2 * DAY)
    assert len(keystore.ledger()) == lines


def test_before_the_cas_were_made_no_clock_is_right(keystore):
    authorities = cas(keystore)
    with keystore.open_ledger() as ledger:
        assert not was_ahead(ledger, authorities, NOW - 2 * DAY)
        assert list_status(keystore, ledger, now=NOW, due=None) is None
    with pytest.raises(KeystoreError, match=r"begins on|newest line"):
        keep_list(keystore, authorities, 365 * DAY, now=NOW - 3 * DAY)


def test_a_ledger_that_begins_again_goes_on_with_larger_numbers(keystore, tmp_path):
    """What `docs/reference/keystore.md` says for a lost ledger without a backup."""
    for _ in range(4):
        sign(keystore, NOW)
    put(tmp_path / "robot", bundle(keystore))
    (keystore.root / "pqsec.json").unlink()
    (keystore.root / "private/ledger.sqlite3").unlink()
    keystore = adopt(keystore.root, now=NOW).keystore
    sign(keystore, NOW)
    renew(keystore, cas(keystore), [ROBOT], KEEP, now=NOW)
    with pytest.raises(VerificationError, match="another ledger than the one seen") as refused:
        put(tmp_path / "robot", bundle(keystore))
    assert len(refused.value.problems) == 1  # nothing is older
    put(tmp_path / "robot", bundle(keystore), older=True)  # once
    sign(keystore, NOW)
    put(tmp_path / "robot", bundle(keystore))
