"""A server whose clock was ahead for a night: when it is right again, robots renew and enrol."""

from dataclasses import replace

import pytest

from pqsec_pki.algorithms import profile_named
from pqsec_pki.certificates import Certificate
from pqsec_pki.domain import read_domain
from pqsec_pki.enrolment import Bundle, pins_in_use, request
from pqsec_pki.est import EnrolmentToken
from pqsec_pki.keystore import State, status
from pqsec_pki.lifecycle import Renewal, renew, renew_list, store_approvals
from pqsec_pki.server.call import CallKind, SignerCall
from pqsec_pki.server.call_handling import CallHandler
from pqsec_pki.server.configuration import EnrolmentPolicy
from pqsec_pki.server.token_lines import record_token, token_states
from pqsec_pki.server.waiting import WaitingRequests
from pqsec_pki.server.waiting_folder import RequestFolder
from tests.unit.approving import make_key
from tests.unit.domains import DAY, NOW, Scene

FILE = """
profile: classical
validity: 90d
roles: {robot: {publish: [rt$name/pose]}}
participants:
  - {name: "/r{1..3}", role: robot, request: requests/}
  - {name: /kept, role: robot}
"""
AHEAD, TODAY = NOW + 40 * DAY, NOW + DAY


class Office(Scene):
    """A keystore with two robots, and the server, whose clock can be set."""

    def __init__(self, folder):
        super().__init__(folder, FILE)
        (folder / "requests").mkdir()
        for name in ("r1", "r2"):
            (folder / f"requests/{name}.csr").write_bytes(self.new(name).pem)
        self.take(self.plan_of_two(), NOW)
        self.now = TODAY
        keystore = self.keystore
        self.handler = CallHandler(
            keystore,
            replace(keystore.unlock(None), compares_clock=True),
            read_domain(self.file),
            lambda: self.now,
            WaitingRequests(RequestFolder(folder / "waiting"), 9),
            EnrolmentPolicy(renew_any_time=True),
            revocation_list=365 * DAY,
        )
        self.handler.keep_list()

    def plan_of_two(self):
        from pqsec_pki.domain import create_keystore  # noqa: PLC0415

        create_keystore(read_domain(self.file), self.root, passphrase=None, now=NOW)
        return self.plan(NOW)

    def new(self, name):
        folder = self.file.parent / name
        return request(f"/{name}", profile_named("classical"), folder, force=True).request

    def certificate(self, name="r1"):
        return Certificate.from_pem(self.file_of(f"/{name}", "cert.pem").read_bytes())

    def ask(self, kind, *, now, **call):
        """The answer with that clock."""
        self.now = now
        [answer] = self.handler.answers([SignerCall(kind=kind, **call)])
        return answer

    def state(self, name="/r1"):
        [found] = status(self.keystore, [name], now=TODAY).participants
        return found.state


@pytest.fixture
def office(tmp_path):
    return Office(tmp_path)


def certificate_in(answer, name="/r1"):
    """The certificate in a bundle, which is valid with all else today."""
    assert answer.status == 200, answer.detail or answer.note
    bundle = Bundle.from_bytes(answer.body)
    return Certificate.from_pem(bundle.enclaves[name]["cert.pem"])


@pytest.fixture
def night(office):
    """A robot that renewed while the clock was ahead: its old certificate, and its request."""
    held, asked = office.certificate(), office.new("r1")
    office.now = AHEAD
    answer = office.ask(CallKind.REQUEST, now=AHEAD, certificate=held.der, body=asked.der)
    assert certificate_in(answer).not_before > TODAY
    assert office.state() is State.NOT_YET_VALID
    office.now = TODAY
    office.handler.keep_list()  # the server looks from time to time
    return held, asked


def test_the_request_of_the_night_is_answered_again(office, night):
    held, asked = night
    answer = office.ask(CallKind.REQUEST, now=TODAY, certificate=held.der, body=asked.der)
    found = certificate_in(answer)
    assert (found.spki, found.not_before) == (asked.spki, TODAY - DAY)
    again = office.ask(CallKind.REQUEST, now=TODAY, certificate=held.der, body=asked.der)
    assert certificate_in(again).der == found.der
    assert office.state() is State.VALID


def test_of_two_copies_of_it_at_once_one_is_issued_for(office, night):
    """Each would have had a certificate of its own, and one of the two robots an old one."""
    held, asked = night
    office.now, lines = TODAY, len(office.keystore.ledger())
    call = SignerCall(kind=CallKind.REQUEST, certificate=held.der, body=asked.der)
    first, second = office.handler.answers([call, call])
    assert certificate_in(first).der == office.certificate().der
    assert (second.status, second.retry_after) == (503, 1)
    assert second.detail == "another request for the same is being answered"
    assert len(office.keystore.ledger()) == lines + 2  # a certificate and permissions


def test_another_request_is_answered_too(office, night):
    held, _ = night
    asked = office.new("r1")
    answer = office.ask(CallKind.REQUEST, now=TODAY, certificate=held.der, body=asked.der)
    assert certificate_in(answer).spki == asked.spki
    late = office.ask(CallKind.REQUEST, now=TODAY, certificate=held.der, body=office.new("r1").der)
    assert (late.status, late.detail) == (403, "this is not the current certificate of /r1")


def test_a_robot_that_only_fetches_gets_a_certificate_of_now(office, night):
    held, asked = night
    answer = office.ask(CallKind.BUNDLE, now=TODAY, certificate=held.der)
    found = certificate_in(answer)
    assert (found.spki, found.not_before) == (asked.spki, TODAY - DAY)
    lines = len(office.keystore.ledger())
    assert certificate_in(office.ask(CallKind.BUNDLE, now=TODAY, certificate=held.der)) is not None
    assert len(office.keystore.ledger()) == lines


def test_what_was_renewed_at_the_ca_is_fetched_for_now(office):
    """As `pqsec renew --all` there, with a clock that was ahead by fifteen months."""
    held = office.certificate()
    authorities = office.keystore.unlock(None)
    renew(office.keystore, authorities, ["/r1"], Renewal(rekey=False), now=NOW + 450 * DAY)
    office.now = TODAY
    assert office.handler.keep_list()
    found = certificate_in(office.ask(CallKind.BUNDLE, now=TODAY, certificate=held.der))
    assert (found.spki, found.not_before) == (held.spki, TODAY - DAY)


def test_keys_that_the_ca_made_have_no_request_that_is_answered_again(office):
    """The robot is told what is wrong, until the CA renews it or its certificate begins."""
    held = office.certificate("kept")
    renew(office.keystore, office.keystore.unlock(None), ["/kept"], Renewal(rekey=True), now=AHEAD)
    office.now = TODAY
    office.handler.keep_list()
    given, lines = office.certificate("kept"), len(office.keystore.ledger())
    answer = office.ask(CallKind.BUNDLE, now=TODAY, certificate=held.der)
    assert answer.status != 200
    assert "the certificate of CN=/kept is not valid before" in answer.detail
    begun = given.not_before + 2 * DAY
    answer = office.ask(CallKind.BUNDLE, now=begun, certificate=held.der)
    assert certificate_in(answer, "/kept").der == given.der
    assert len(office.keystore.ledger()) == lines


def test_where_only_plans_issue_a_certificate_of_the_future_is_not_issued_again(
    office, night, tmp_path
):
    """The robot is told what is wrong until a plan renews it, or until its certificate begins."""
    held, asked = night
    make_key(tmp_path, "alice")
    office.change("roles:", "approvals: {required: 1, of: {alice: alice.pub.pem}}\nroles:")
    policy = read_domain(office.file).approvals
    store_approvals(office.keystore, office.keystore.unlock(None), policy, now=TODAY)
    given, lines = office.certificate(), len(office.keystore.ledger())
    for kind, body in ((CallKind.REQUEST, asked.der), (CallKind.BUNDLE, b"")):
        call = {"certificate": held.der, "body": body}
        answer = office.ask(kind, now=TODAY, **call)
        assert answer.status != 200
        assert "the certificate of CN=/r1 is not valid before" in answer.detail
        begun = given.not_before + 2 * DAY
        assert certificate_in(office.ask(kind, now=begun, **call)).der == given.der
    assert len(office.keystore.ledger()) == lines


def test_the_one_before_renews_until_the_new_one_begins(office, night):
    held, _ = night
    begun = AHEAD + DAY
    answer = office.ask(
        CallKind.REQUEST, now=begun, certificate=held.der, body=office.new("r1").der
    )
    assert (answer.status, answer.detail) == (403, "this is not the current certificate of /r1")


def test_a_revoked_one_does_not(office, night):
    from pqsec_pki.lifecycle import revoke  # noqa: PLC0415

    held, asked = night
    revoke(office.keystore, office.keystore.unlock(None), [f"{held.serial_number:x}"], now=TODAY)
    answer = office.ask(CallKind.REQUEST, now=TODAY, certificate=held.der, body=asked.der)
    assert (answer.status, answer.detail) == (403, "the client certificate was revoked")


# Tokens


def token(office, now):
    made = EnrolmentToken.new(
        server="https://enrol.example",
        server_pins=frozenset({"0" * 64}),
        cas=pins_in_use(office.keystore),
        names="/r3",
        profile="classical",
        not_after=now + 90 * DAY,
    )
    record_token(office.keystore, made, uses=1, replaces=False, now=now)
    return {"token": made.id, "secret": made.secret}


def used(office):
    return [each.used for each in token_states(office.keystore)]


def test_a_token_is_not_spent_while_the_list_is_of_the_future(office):
    shown, asked = token(office, TODAY), office.new("r3")
    renew_list(office.keystore, office.keystore.unlock(None), now=AHEAD)
    keeping = office.handler
    office.handler = replace(keeping, revocation_list=None)  # it keeps no list
    answer = office.ask(CallKind.REQUEST, now=TODAY, body=asked.der, **shown)
    assert (answer.status, answer.retry_after > 0) == (503, True)
    assert "not in force before" in answer.note
    assert used(office) == [0]
    assert not office.keystore.has("/r3")
    ready = office.ask(CallKind.READY, now=TODAY)
    assert (ready.status, "not ready" in ready.detail) == (503, True)
    office.handler = keeping
    assert office.handler.keep_list()
    assert office.ask(CallKind.READY, now=TODAY).status == 200
    answer = office.ask(CallKind.REQUEST, now=TODAY, body=asked.der, **shown)
    assert certificate_in(answer, "/r3").spki == asked.spki
    assert used(office) == [1]


def test_a_token_that_was_used_in_the_future_is_answered_again(office):
    shown, asked = token(office, TODAY), office.new("r3")
    answer = office.ask(CallKind.REQUEST, now=AHEAD, body=asked.der, **shown)
    assert certificate_in(answer, "/r3").not_before > TODAY
    office.now = TODAY
    office.handler.keep_list()
    answer = office.ask(CallKind.REQUEST, now=TODAY, body=asked.der, **shown)
    assert certificate_in(answer, "/r3").not_before < TODAY
    assert used(office) == [1]
    other = office.ask(CallKind.REQUEST, now=TODAY, body=office.new("r3").der, **shown)
    assert other.status in {401, 409}


def test_a_clock_that_is_behind_issues_nothing(office):
    """Before NTP has set it: the server answers when it is right."""
    held, asked = office.certificate(), office.new("r1")
    for days in (3, 12, 21, 30):
        renew_list(office.keystore, office.keystore.unlock(None), now=NOW + days * DAY)
    now, behind = NOW + 30 * DAY, NOW + 4 * DAY
    call = {"certificate": held.der, "body": asked.der}
    answer = office.ask(CallKind.REQUEST, now=behind, **call)
    assert answer.status in {500, 503}
    assert office.certificate().der == held.der
    assert certificate_in(office.ask(CallKind.REQUEST, now=now, **call)).spki == asked.spki


def test_what_was_signed_ahead_while_the_server_ran_holds_up_nobody(office):
    """The server does not wait until it looks at its list again."""
    held, asked = office.certificate(), office.new("r1")
    renew(office.keystore, office.keystore.unlock(None), ["/r2"], Renewal(rekey=False), now=AHEAD)
    answer = office.ask(CallKind.REQUEST, now=TODAY, certificate=held.der, body=asked.der)
    assert certificate_in(answer).spki == asked.spki
