"""A robot that enrols and renews by itself: what it takes, and what it never loses."""

import errno
import shutil
import threading
from dataclasses import replace
from datetime import timedelta
from functools import partial
from types import SimpleNamespace

import pytest

from pqsec_pki.algorithms import profile_named
from pqsec_pki.certificates import Certificate, CertificateRequest, Reason
from pqsec_pki.credentials import CERTIFICATE, KEY, REVOCATION_LIST
from pqsec_pki.enrolment import Bundle, changing, one_command, pins_in_use, read_receipts
from pqsec_pki.enrolment.verification import keys_of, verify_bundle
from pqsec_pki.errors import KeystoreError, PqsecError, UsageError, VerificationError
from pqsec_pki.est import (
    EstClient,
    KeyTerms,
    KnownServer,
    WaitingError,
    deliver_receipt,
    enrol,
    obtaining,
    renew,
)
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import Renewal, renew_list, revoke
from pqsec_pki.lifecycle import renew as renew_there
from pqsec_pki.tokens import reference_to
from tests.unit.enrolling import DAY, ROBOT
from tests.unit.est_server import serving, serving_outside
from tests.unit.keystores import made
from tests.unit.killing import NOW, YEAR, copies, fails_with
from tests.unit.tls_sides import identity

SECRET = ("0123456789abcdef", "geheim")
BASIC = "Basic MDEyMzQ1Njc4OWFiY2RlZjpnZWhlaW0="
DUE = NOW + 300 * DAY


def clock(at=NOW):
    return lambda: at


@pytest.fixture(scope="module")
def original(memory):
    return made(memory / "keystore", "pq", names=("/arm",)).root


@pytest.fixture
def keystore(original, place):
    shutil.copytree(original, place / "keystore", symlinks=True)
    return Keystore.open(place / "keystore", to_change=True)


@pytest.fixture
def server(keystore):
    with serving(keystore) as running:
        running.secrets = {BASIC: 1}
        yield running


@pytest.fixture
def terms(keystore):
    return KeyTerms(profile=keystore.profile, pins=pins_in_use(keystore))


@pytest.fixture
def robot(place):
    return place / "robot"


def client_of(server, **changes):
    return EstClient(**{"server": server.url, "trust": server.trust, "secret": SECRET, **changes})


def known(server):
    return KnownServer(server=server.url, trust=server.trust)


@pytest.fixture
def enrolled(server, terms, robot):
    enrol(client_of(server), ROBOT, robot, terms, clock=clock())
    return robot


def renewed(server, robot, *, at=NOW, names=(), rekey=False):
    """What became of the only participant."""
    there, terms = known(server), KeyTerms()
    [found] = renew(there, names, robot, terms, clock=clock(at), rekey=rekey)
    if isinstance(found, PqsecError):
        raise found
    return found


def files(robot, name=ROBOT):
    """The installed files, once they are found to hold together with the keys here."""
    with changing(robot) as store:
        if store.current is None:
            return None
        enclave = store.current.enclaves[name]
    bundle = Bundle(NOW, {name: enclave})
    when = Certificate.from_pem(enclave[CERTIFICATE]).not_before + DAY
    [verified] = verify_bundle(bundle, bundle.roles, now=when).verified
    keys_of(verified, [enclave])
    return enclave


def waiting_request(robot, name="fleet+robot1"):
    path = robot / "requests" / name / "request.csr"
    return CertificateRequest.from_pem(path.read_bytes()).spki if path.exists() else None


def test_a_robot_enrols_with_keys_that_stay_on_it(server, terms, robot, keystore):
    done = enrol(client_of(server), ROBOT, robot, terms, clock=clock())
    assert (done.name, done.renewed, done.changed) == (ROBOT, True, True)
    assert files(robot)[CERTIFICATE] == done.certificate.pem
    assert not (keystore.root / "enclaves/fleet/robot1/key.pem").exists()
    assert [path for _, path in server.seen] == ["/pqsec/v1/requests"]
    assert KnownServer.at(robot) == known(server)


def test_a_name_may_be_written_as_people_do(server, terms, robot):
    done = enrol(client_of(server), ROBOT.removeprefix("/"), robot, terms, clock=clock())
    assert done.name == ROBOT
    assert renewed(server, robot, names=[ROBOT.removeprefix("/")]).name == ROBOT
    with pytest.raises(PqsecError, match="name"):
        enrol(client_of(server), "../x", robot, terms, clock=clock())


def test_the_receipt_is_delivered_once(server, enrolled):
    deliver_receipt(enrolled)
    deliver_receipt(enrolled)
    [sent] = server.receipts
    [receipt] = read_receipts(sent)
    assert receipt.receipt.participant == ROBOT


def test_a_receipt_that_was_not_delivered_is_sent_later(server, enrolled):
    server.reply = b"HTTP/1.1 503 x\r\n\r\n"
    with pytest.raises(PqsecError):
        deliver_receipt(enrolled)
    server.reply = None
    deliver_receipt(enrolled)
    assert len(server.receipts) == 1


def test_enrolling_again_asks_for_nothing(server, enrolled, terms):
    before = files(enrolled)
    again = enrol(client_of(server), ROBOT, enrolled, terms, clock=clock())
    assert not again.changed
    assert files(enrolled) == before
    assert len(server.answers) == 1


def test_enrolling_again_by_force_or_after_the_end_makes_new_keys(server, enrolled, terms):
    for at, force in ((NOW, True), (NOW + 400 * DAY, False)):
        server.secrets, server.now = {BASIC: 1}, at
        before = files(enrolled)
        done = enrol(
            client_of(server), ROBOT, enrolled, replace(terms, force=force), clock=clock(at)
        )
        assert done.renewed
        assert files(enrolled)[KEY] != before[KEY]


def test_a_used_token_is_refused_and_the_request_stays(server, terms, robot):
    server.secrets = {}
    with pytest.raises(VerificationError, match="unknown or used up"):
        enrol(client_of(server), ROBOT, robot, terms, clock=clock())
    asked = waiting_request(robot)
    server.secrets = {BASIC: 1}
    done = enrol(client_of(server), ROBOT, robot, terms, clock=clock())
    assert done.certificate.spki == asked


def test_an_approval_is_waited_for_or_asked_for_again(server, terms, robot, monkeypatch):
    server.waiting = 4
    with pytest.raises(WaitingError, match="waits for an approval") as waits:
        enrol(client_of(server), ROBOT, robot, terms, clock=clock())
    assert (waits.value.exit_code, waits.value.code) == (3, "approval-waiting")
    sent = CertificateRequest.from_pem(next(robot.rglob("request.csr")).read_bytes())
    assert str(waits.value).endswith(f"SHA-256 {sent.fingerprint}")
    pauses = []
    monkeypatch.setattr(obtaining.time, "sleep", pauses.append)
    asked, minute = waiting_request(robot), timedelta(minutes=1)
    done = enrol(client_of(server), ROBOT, robot, terms, clock=clock(), patience=minute)
    assert pauses == [1.0, 1.0, 1.0]
    assert done.certificate.spki == asked


def test_cas_that_are_not_pinned_are_refused(server, terms, robot):
    wrong = {file: frozenset({"0" * 64}) for file in terms.pins}
    with pytest.raises(VerificationError, match="not trusted in this role"):
        enrol(client_of(server), ROBOT, robot, replace(terms, pins=wrong), clock=clock())
    assert files(robot) is None
    assert KnownServer.at(robot) is None
    trusting = replace(terms, pins=None, trust_first=True)
    assert enrol(client_of(server), ROBOT, robot, trusting, clock=clock()).renewed


def test_a_robot_that_trusts_no_cas_sends_nothing(server, terms, robot):
    """It could not install any answer, and would use up its token."""
    with pytest.raises(UsageError, match="no CAs are trusted"):
        enrol(client_of(server), ROBOT, robot, replace(terms, pins=None), clock=clock())
    assert server.seen == []
    assert not robot.exists()


def test_a_token_of_another_fleet_changes_nothing(enrolled, server, terms, place):
    other = made(place / "other", "pq", names=())
    before = files(enrolled)
    with serving(other, identity("ml-dsa-65", owner="other")) as elsewhere:
        elsewhere.anybody = True
        theirs = replace(terms, pins=pins_in_use(other))
        with pytest.raises(KeystoreError, match="under other CAs"):
            enrol(client_of(elsewhere), ROBOT, enrolled, theirs, clock=clock())
        assert elsewhere.seen == []
        with pytest.raises(VerificationError, match="not a pinned one"):
            renewed(replace_trust(elsewhere, server), enrolled, at=DUE)
        with pytest.raises(VerificationError, match="not trusted in this role"):
            renewed(elsewhere, enrolled, at=DUE)
    assert files(enrolled) == before
    assert KnownServer.at(enrolled) == known(server)


def replace_trust(server, trusted):
    return SimpleNamespace(url=server.url, trust=trusted.trust)


def with_bundle(server, change):
    """The server answers with another bundle."""

    def reply(handler):
        server.reply = None
        bundle = Bundle.of(server.keystore, ["/arm"], now=NOW, keys=False)
        handler.answer(200, change(bundle))
        return True

    server.reply = reply


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda one: one.to_bytes(), "the server's bundle is for /arm"),
        (lambda _: b"", "not an archive"),
        (lambda _: bytes(1000), "not an archive"),
        (lambda one: one.to_bytes()[:-200], "incomplete"),
    ],
)
def test_a_bundle_that_is_no_answer_is_refused(server, terms, robot, change, words):
    with_bundle(server, change)
    with pytest.raises(PqsecError, match=words):
        enrol(client_of(server), ROBOT, robot, terms, clock=clock())
    assert files(robot) is None
    assert enrol(client_of(server), ROBOT, robot, terms, clock=clock()).renewed


def test_a_bundle_with_keys_is_refused(server, terms, robot):
    with_bundle(server, lambda _: Bundle.of(server.keystore, ["/arm"], now=NOW).to_bytes())
    with pytest.raises(VerificationError, match="which must be made on this robot"):
        enrol(client_of(server), "/arm", robot, terms, clock=clock())


# Renewing


def test_nothing_due_and_nothing_new_changes_nothing(server, enrolled):
    before = {path: path.stat().st_mtime_ns for path in enrolled.rglob("*")}
    server.seen.clear()
    done = renewed(server, enrolled)
    assert not done.changed
    assert server.seen == [("GET", "/pqsec/v1/bundle")]
    after = {path: path.stat().st_mtime_ns for path in enrolled.rglob("*")}
    assert {path for path in after if after[path] != before.get(path)} <= {enrolled}


def test_what_is_due_gets_a_new_certificate_for_new_keys(server, enrolled):
    before, server.now = files(enrolled), DUE
    assert not renewed(server, enrolled, at=NOW + 200 * DAY).renewed
    done = renewed(server, enrolled, at=DUE)
    assert done.renewed
    assert done.certificate.not_after > DUE + 300 * DAY
    assert files(enrolled)[KEY] != before[KEY]
    assert waiting_request(enrolled) is None


def test_new_keys_that_the_server_refuses_do_not_disturb_later_runs(server, enrolled):
    server.reply = lambda handler: handler.command == "POST" and not handler.problem(403, "no")
    with pytest.raises(VerificationError, match="no"):
        renewed(server, enrolled, rekey=True)
    asked = waiting_request(enrolled)
    assert not renewed(server, enrolled).changed
    server.reply = None
    assert renewed(server, enrolled, rekey=True).certificate.spki == asked


def test_an_answer_that_was_not_installed_is_found_by_a_run_with_nothing_due(
    server, enrolled, monkeypatch
):
    def stop(*_, **__):
        raise PqsecError("the disk is full")

    with monkeypatch.context() as patch:
        patch.setattr(obtaining, "install", stop)
        with pytest.raises(PqsecError, match="full"):
            renewed(server, enrolled, rekey=True)
    asked = waiting_request(enrolled)
    assert renewed(server, enrolled).certificate.spki == asked


def test_the_share_of_life_can_be_chosen(server, enrolled):
    [done] = renew(known(server), (), enrolled, KeyTerms(), clock=clock(), due=2 * YEAR)
    assert done.renewed


def test_newer_documents_and_lists_come_without_new_keys(server, enrolled, keystore):
    before = files(enrolled)
    authorities = keystore.unlock(None)
    revoke(keystore, authorities, ["/arm"], reason=Reason.KEY_COMPROMISE, now=NOW + DAY)
    server.now = NOW + DAY
    done = renewed(server, enrolled, at=NOW + DAY)
    assert (done.renewed, done.changed) == (False, True)
    after = files(enrolled)
    assert after[REVOCATION_LIST] != before.get(REVOCATION_LIST)
    assert after[KEY] == before[KEY]


def test_a_server_that_went_back_in_time_is_refused_and_the_marks_stay(
    server, enrolled, keystore, place
):
    shutil.copytree(keystore.root, place / "older", symlinks=True)
    renew_there(keystore, keystore.unlock(None), [ROBOT], Renewal(), now=NOW + DAY)
    renewed(server, enrolled, at=NOW + 2 * DAY)
    before, marks = files(enrolled), (enrolled / "trust.json").read_bytes()
    server.keystore = Keystore.open(place / "older")
    with pytest.raises(VerificationError, match="older than one installed before") as refused:
        renewed(server, enrolled, at=NOW + 2 * DAY)
    assert "--older" not in refused.value.hint  # an option of `install` only
    assert "restore the newest" in refused.value.hint
    assert files(enrolled) == before
    assert (enrolled / "trust.json").read_bytes() == marks


def test_a_server_that_is_away_for_months_is_found_again(server, enrolled, keystore):
    before = files(enrolled)
    away = replace(known(server), server="https://127.0.0.1:9")
    for day in (100, 250, 300):
        [failed] = renew(away, (), enrolled, KeyTerms(), clock=clock(NOW + day * DAY))
        assert isinstance(failed, PqsecError)
        assert failed.exit_code == 3
        assert files(enrolled) == before
    asked, server.now = waiting_request(enrolled), DUE
    done = renewed(server, enrolled, at=DUE)
    assert done.certificate.spki == asked


@pytest.mark.parametrize("wrong", [NOW - 3000 * DAY, NOW + 3000 * DAY])
def test_a_wrong_clock_is_told_and_harms_nothing(server, enrolled, wrong, keystore):
    before = files(enrolled)
    renew_list(keystore, keystore.unlock(None), now=NOW + DAY)
    with pytest.raises(VerificationError, match="valid") as refused:
        renewed(server, enrolled, at=wrong)
    assert "set the clock, and run the command again" in refused.value.hint
    assert files(enrolled) == before
    asked = waiting_request(enrolled)
    done = renewed(server, enrolled, at=NOW + 2 * DAY)
    assert done.changed
    assert asked in {None, done.certificate.spki}
    assert waiting_request(enrolled) is None


def test_a_renewal_that_waits_does_not_hold_up_the_newest_list(server, enrolled, keystore):
    before = files(enrolled)
    renew_list(keystore, keystore.unlock(None), now=NOW + DAY)
    server.now, server.waiting = DUE, 1
    with pytest.raises(WaitingError):
        renewed(server, enrolled, at=NOW + 260 * DAY)
    after = files(enrolled)
    assert after[REVOCATION_LIST] != before.get(REVOCATION_LIST)
    assert after[KEY] == before[KEY]
    assert renewed(server, enrolled, at=DUE).renewed


def test_one_participant_that_is_refused_does_not_hold_up_another(server, enrolled, terms):
    server.secrets = {BASIC: 1}
    enrol(client_of(server), "/fleet/second", enrolled, terms, clock=clock())

    def refuse_first(handler):
        if handler.caller() == ROBOT:
            handler.problem(403, "revoked")
            return True
        return False

    server.reply, server.now = refuse_first, DUE
    first, second = renew(known(server), (), enrolled, KeyTerms(), clock=clock(DUE))
    assert isinstance(first, VerificationError)
    assert str(first).startswith(f"{ROBOT}: https://127.0.0.1")
    assert second.renewed
    assert files(enrolled)


def test_only_those_that_are_named_are_renewed(server, enrolled):
    assert renewed(server, enrolled, at=NOW, names=["/fleet/*"]).name == ROBOT
    for name in ("/other", "/other/*"):
        with pytest.raises(KeystoreError, match="/other"):
            renewed(server, enrolled, names=[name])


def test_nothing_is_renewed_where_nothing_is_installed(server, robot):
    with pytest.raises(KeystoreError, match="nothing is installed"):
        renewed(server, robot)


@pytest.mark.parametrize("profile", ["transition", "classical"])
def test_new_keys_are_of_the_kinds_before(place, robot, profile):
    keystore = made(place / profile, profile, names=())
    terms = KeyTerms(profile=profile_named(profile), trust_first=True)
    with serving(keystore) as server:
        server.anybody = True
        enrol(client_of(server), ROBOT, robot, terms, clock=clock())
        before, server.now = files(robot), DUE
        assert renewed(server, robot, at=DUE).renewed
    kinds = [Certificate.from_pem(each[CERTIFICATE]) for each in (before, files(robot))]
    assert len({each.public_key.algorithm.name for each in kinds}) == 1
    assert len({each.alternative_key and each.alternative_key.algorithm for each in kinds}) == 1


def test_a_token_that_is_not_there_is_told(server, enrolled):
    [path] = enrolled.glob("installed/*/enclaves/fleet/robot1/key.pem")
    path.write_bytes(reference_to("pkcs11:token=t;object=k"))
    server.seen.clear()
    with pytest.raises(PqsecError, match="token"):
        renewed(server, enrolled)
    assert server.seen == []


# Whatever happens


@pytest.fixture(scope="module")
def outside(memory):
    root = made(memory / "outside", "pq", names=()).root
    with serving_outside(root) as (url, trust):
        yield root, url, trust


def ending_well(outside, robot, work):
    """The old set or the new one is there, and the same request is answered on the next run."""
    asked, before = waiting_request(robot), files(robot)
    work(robot)
    after = files(robot)
    assert after
    found = Certificate.from_pem(after[CERTIFICATE]).spki
    assert before or asked in {None, found}
    assert waiting_request(robot) is None
    if asked:
        assert found == asked
    left = {each.name for each in robot.iterdir()}
    assert left == {
        *("current", "installed", "requests", "trust.json", "installed.receipt", "server.json"),
    }


def enrolling(outside, root):
    keystore, url, trust = outside
    terms = KeyTerms(profile=profile_named("pq"), pins=pins_in_use(Keystore.open(keystore)))
    enrol(EstClient(server=url, trust=trust), ROBOT, root, terms, clock=clock())
    deliver_receipt(root)


def renewing(outside, root):
    _, url, trust = outside
    there = KnownServer(server=url, trust=trust)
    [found] = renew(there, (), root, KeyTerms(), clock=clock(), due=2 * YEAR)
    if isinstance(found, PqsecError):
        raise found
    deliver_receipt(root)


@pytest.mark.slow
@pytest.mark.parametrize("ends", ["killed", errno.ENOSPC])
@pytest.mark.parametrize("work", [enrolling, renewing])
def test_stopped_at_any_instant_the_next_run_ends_it(outside, place, work, ends):
    (place / "before").mkdir(mode=0o700)
    if work is renewing:
        enrolling(outside, place / "before")
    task = partial(work, outside)
    options = {} if ends == "killed" else {"trial": partial(fails_with, ends)}
    outcomes = []
    for root, done in copies(place, place / "before", task, every=17, **options):
        outcomes.append(done)
        assert work is enrolling or files(root)
        ending_well(outside, root, partial(enrolling, outside))
    assert len(outcomes) > 2


def test_two_at_once_make_one_request(server, terms, robot):
    results = []

    def one():
        try:
            results.append(enrol(client_of(server), ROBOT, robot, terms, clock=clock()))
        except KeystoreError as error:
            results.append(error)

    threads = [threading.Thread(target=one) for _ in range(4)]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    assert len(server.answers) == 1
    assert any(not isinstance(each, KeystoreError) for each in results)
    assert files(robot)


def test_one_command_at_a_time(server, terms, robot):
    with one_command(robot), pytest.raises(KeystoreError, match="another pqsec command"):
        enrol(client_of(server), ROBOT, robot, terms, clock=clock())


@pytest.mark.parametrize(
    "data", [b"", b"{}", b"[]", b"\xff", b'{"format": 2}', b'{"format": 1, "server": "http://a"}']
)
def test_a_damaged_file_of_the_server_is_told(robot, data):
    robot.mkdir()
    (robot / "server.json").write_bytes(data)
    with pytest.raises(KeystoreError, match=r"server\.json: (cannot be read|its format)"):
        KnownServer.at(robot)
