"""Who is admitted, and as what: by a token, a certificate, a device's, an order, or nothing."""

from datetime import timedelta

import pytest

from pqsec_pki.certificates import Certificate, certificate_request
from pqsec_pki.domain import create_keystore, read_domain
from pqsec_pki.enrolment import pins_in_use
from pqsec_pki.est import EnrolmentToken
from pqsec_pki.server import record_token, requester
from pqsec_pki.server.call import CallKind, SignerCall
from pqsec_pki.server.call_handling import CallHandler
from pqsec_pki.server.configuration import EnrolmentPolicy
from pqsec_pki.server.factories import Factory
from pqsec_pki.server.waiting import WaitingRequests
from pqsec_pki.server.waiting_folder import RequestFolder
from tests.some_keys import some_key
from tests.unit.approving import make_key
from tests.unit.domains import DAY, NOW, Scene
from tests.unit.factory import KIND, Maker

FILE = """
profile: classical
validity: 90d
roles: {robot: {publish: [rt$name/pose]}}
groups: {fleet: ["/r*"], others: ["/d*"]}
participants:
  - {name: "/r{1..2}", role: robot, request: requests/}
  - {name: "/d{1..2}", role: robot, request: requests/, idevid: "acme:serialNumber=SN-1"}
"""
APPROVALS = "approvals: {required: 1, of: {alice: alice.pub.pem, bob: bob.pub.pem}}\n"
HOUR = timedelta(hours=1)


def asked(name, which="first"):
    """A new request for a key of that name: the first, or another."""
    return certificate_request(name, some_key(KIND, f"{which} {name}"))


class Desk(Scene):
    """A domain without certificates, and the handler of its server."""

    def __init__(self, folder):
        super().__init__(folder, FILE)
        self.folder = folder
        create_keystore(read_domain(self.file), self.root, passphrase=None, now=NOW)
        self.factories = {}
        self.waiting = WaitingRequests(RequestFolder(folder / "waiting"), 9)

    def demand_approvals(self):
        """From now on a plan needs them."""
        for name in ("alice", "bob"):
            make_key(self.folder, name)
        self.write(self.file.read_text() + APPROVALS)
        self.apply()

    def made(self, names, **changes):
        """A token that the ledger does not have yet."""
        given = {"server": "https://x", "server_pins": frozenset(), "profile": "classical"}
        given |= {"cas": pins_in_use(self.keystore), "not_after": NOW + DAY, **changes}
        return EnrolmentToken.new(names=names, **given)

    def token(self, names, *, uses=1, replaces=False):
        """What a client shows of a new token."""
        made = self.made(names)
        record_token(self.keystore, made, uses=uses, replaces=replaces, now=NOW)
        return {"token": made.id, "secret": made.secret}

    def certificate(self, name="/r1"):
        """What a client shows of the participant's certificate."""
        pem = self.file_of(name, "cert.pem").read_bytes()
        return {"certificate": Certificate.from_pem(pem).der}

    def answers(self, *calls, now=NOW, **policy):
        """The answers to calls that came at the same time."""
        keystore = self.keystore
        handler = CallHandler(
            keystore,
            keystore.unlock(None),
            read_domain(self.file),
            lambda: now,
            self.waiting,
            EnrolmentPolicy(**policy),
            self.factories,
        )
        return [(each.status, each.detail) for each in handler.answers(calls)]

    def ask(self, request, shown=None, *, now=NOW, kind=CallKind.REQUEST, label="", **policy):
        """The answer to a client that shows this."""
        call = SignerCall(kind=kind, label=label, body=request.der, **(shown or {}))
        [answer] = self.answers(call, now=now, **policy)
        return answer


@pytest.fixture
def desk(tmp_path):
    return Desk(tmp_path)


@pytest.fixture(scope="module")
def maker():
    return Maker(NOW)


class Devices(Desk):
    """It has a factory, whose device may enrol as two participants."""

    def know(self, maker, *, again=False):
        self.factories = {"acme": Factory((Certificate.from_pem(maker.root),), again=again)}
        return self.device(maker)

    def device(self, maker):
        """What the device shows."""
        own, *chain = Certificate.all_from_pem(maker.device("SN-1").chain)
        return {"certificate": own.der, "chain": tuple(each.der for each in chain)}


@pytest.fixture
def devices(tmp_path):
    return Devices(tmp_path)


ADMITTED = 200, ""
SHOW_CURRENT = 401, "show the current certificate as client certificate"
NOT_OURS = 403, "the client certificate was not issued here"
ANOTHER_KEY = 409, "/d1 has a certificate for another key"
BEFORE = 403, "the device has enrolled as /d1 before: it needs a new enrolment token"


def test_what_is_no_request_is_refused(desk):
    call = SignerCall(kind=CallKind.REQUEST, body=b"no request", **desk.token("/r1"))
    [(status, _)] = desk.answers(call)
    assert status == 400


def test_to_enrol_again_a_certificate_is_needed_and_a_token_does_not_count(desk):
    request, kind = asked("/r1"), CallKind.REENROL
    assert desk.ask(request, desk.token("/r1"), kind=kind) == SHOW_CURRENT
    assert desk.ask(request, kind=kind, approval=True) == SHOW_CURRENT
    assert desk.waiting.all() == []
    assert desk.ask(request, approval=True)[0] == 202
    assert len(desk.waiting.all()) == 1


def test_who_shows_no_certificate_fetches_no_bundle_beside_who_does(desk):
    assert desk.ask(asked("/r1"), desk.token("/r1")) == ADMITTED
    calls = [SignerCall(kind=CallKind.BUNDLE, **each) for each in (desk.certificate(), {})]
    nobody = 401, "show the participant's certificate as client certificate"
    assert desk.answers(*calls) == [ADMITTED, nobody]


def test_a_label_is_a_group_that_has_the_name(desk):
    request, shown = asked("/r1"), desk.token("/r1")
    unknown = 404, "unknown label: a label is a group of the domain file"
    assert desk.ask(request, shown, label="fleets") == unknown
    assert desk.ask(request, shown, label="others") == (403, "/r1 is not in the group others")
    assert desk.ask(request, shown, label="fleet") == ADMITTED


def both(desk, shown, *requests):
    """The answers to two requests at the same time."""
    calls = [SignerCall(kind=CallKind.REQUEST, body=each.der, **shown) for each in requests]
    return desk.answers(*calls)


BUSY = 503, "another request for the same is being answered"


def test_a_token_with_one_use_admits_one_of_two_at_the_same_time(desk):
    requests = asked("/r1"), asked("/r2")
    shown = desk.token("/r*")
    assert both(desk, shown, *requests) == [ADMITTED, BUSY]
    assert desk.ask(requests[1], shown) == (401, "the enrolment token is used up")
    assert both(desk, desk.token("/d*", uses=2), asked("/d1"), asked("/d2")) == [ADMITTED] * 2


def test_of_two_requests_for_one_name_at_the_same_time_one_is_answered(desk):
    shown = desk.token("/r*", uses=2)
    assert both(desk, shown, asked("/r1"), asked("/r1", "second")) == [ADMITTED, BUSY]


def test_a_token_for_two_names_admits_both_and_no_third(desk):
    shown = desk.token("/r1 /r2", uses=3)
    assert desk.ask(asked("/r1"), shown) == ADMITTED
    assert desk.ask(asked("/r2"), shown) == ADMITTED
    assert desk.ask(asked("/d1"), shown) == (403, "the enrolment token is not for /d1")


def test_tokens_are_not_counted_by_the_day_and_renewals_are(desk, monkeypatch):
    """Somebody made the token; a robot renews by itself."""
    monkeypatch.setattr(requester, "MOST_OF_DAY", 1)
    assert desk.ask(asked("/r1"), desk.token("/r1")) == ADMITTED
    new = desk.token("/r1", replaces=True)
    assert desk.ask(asked("/r1", "second"), new, now=NOW + HOUR) == ADMITTED
    third, shown = asked("/r1", "third"), desk.certificate()
    status, words = desk.ask(third, shown, now=NOW + 2 * HOUR, renew_any_time=True)
    assert (status, "certificates of /r1 within a day" in words) == (429, True)
    assert desk.ask(third, shown, now=NOW + 2 * DAY, renew_any_time=True) == ADMITTED


# Devices


def test_a_device_enrols_once_as_each_of_its_participants(devices, maker):
    shown = devices.know(maker)
    for name in ("/d1", "/d2"):
        assert devices.ask(asked(name), shown) == ADMITTED
    for which in ("first", "second"):  # the same key, and another
        assert devices.ask(asked("/d1", which), shown) == BEFORE


def test_a_device_that_may_enrols_again_with_any_key(devices, maker):
    shown = devices.know(maker, again=True)
    for which in ("first", "first", "second"):
        assert devices.ask(asked("/d1", which), shown) == ADMITTED


def test_a_device_replaces_no_key_of_another(devices, maker):
    shown = devices.know(maker)
    assert devices.ask(asked("/d1"), devices.token("/d1")) == ADMITTED
    assert devices.ask(asked("/d1", "second"), shown) == ANOTHER_KEY
    assert devices.ask(asked("/d1"), shown) == ADMITTED


def test_a_device_is_counted_by_the_day(devices, maker, monkeypatch):
    monkeypatch.setattr(requester, "MOST_OF_DAY", 1)
    shown = devices.know(maker, again=True)
    assert devices.ask(asked("/d1"), shown) == ADMITTED
    assert devices.ask(asked("/d1"), shown)[0] == 429


def test_with_factories_a_participant_is_still_known_by_its_own_certificate(devices, maker):
    assert devices.ask(asked("/d1"), devices.know(maker)) == ADMITTED
    own = devices.certificate("/d1")
    assert devices.ask(asked("/d1", "second"), own, renew_any_time=True) == ADMITTED


def test_a_device_is_nobody_without_its_factory_and_renews_nothing(devices, maker):
    assert devices.ask(asked("/d1"), devices.device(maker)) == NOT_OURS
    shown = devices.know(maker)
    assert devices.ask(asked("/d1"), shown, kind=CallKind.REENROL) == NOT_OURS


def test_the_key_and_the_certificate_of_a_factory_are_no_others(devices, maker):
    shown = devices.know(maker)
    own = certificate_request("/d1", some_key(KIND, "acme device SN-1"))
    refused = 403, "the request is for the factory's key: make a new one for it"
    assert devices.ask(own, shown) == refused
    status, words = devices.ask(asked("/d1"), devices.device(Maker(NOW, "mallory")))
    assert (status, "the factory certificate is refused" in words) == (403, True)


# Where a plan issues


def test_a_request_that_was_planned_needs_no_decision_for_the_holder_of_a_token(desk):
    request = asked("/r1")
    (desk.folder / "requests").mkdir()
    (desk.folder / "requests/r1.csr").write_bytes(request.pem)
    desk.apply()
    desk.demand_approvals()
    issued = desk.certificate()
    assert desk.ask(request)[0] == 401
    assert desk.ask(request, desk.token("/r1")) == ADMITTED
    assert desk.ask(asked("/r2"), desk.token("/r2"))[0] == 202  # nobody planned that
    assert desk.certificate() == issued


def test_where_a_plan_issues_an_order_is_needed_for_the_next_certificate_too(desk):
    assert desk.ask(asked("/r1"), desk.token("/r1")) == ADMITTED
    desk.change("role: robot, request: requests/}", "role: robot, order: orders/}")
    new, shown = asked("/r1", "second"), desk.certificate()
    desk.demand_approvals()
    words = "/r1 is enrolled by a registration authority's order, and no order has this request"
    assert desk.ask(new, shown, renew_any_time=True) == (403, words)
    assert desk.waiting.all() == []
