"""The requests that wait: whose are given up when it is full, and what names one."""

from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest

from pqsec_pki.algorithms import profile_named
from pqsec_pki.enrolment import request
from pqsec_pki.errors import FileError, MalformedError, UsageError
from pqsec_pki.server import APPROVAL, ServerSettings, decide, open_approvals, waiting_folder
from pqsec_pki.server.call import CallKind, SignerCall
from pqsec_pki.server.configuration import EnrolmentPolicy
from pqsec_pki.server.waiting import LIFETIME, WaitingRequests
from pqsec_pki.server.waiting_folder import RequestFolder
from tests.unit.domains import DAY
from tests.unit.keystores import NOW
from tests.unit.test_serve_expired import Office

HOME, ENEMY = "192.0.2.1", "192.0.2.66"
SECOND = timedelta(seconds=1)


@pytest.fixture(scope="module")
def requests(tmp_path_factory):
    """Requests for one name."""
    folder = tmp_path_factory.mktemp("requests")
    profile = profile_named("classical")
    return [request("/r", profile, folder, force=True).request for _ in range(9)]


class Asked:
    """Waiting requests, and a clock that goes on with each request."""

    def __init__(self, folder, most):
        self.waiting, self.now = WaitingRequests(RequestFolder(folder), most), NOW

    def ask(self, made, address, name):
        self.now += SECOND
        self.waiting.add(made, name, address, self.now)

    @property
    def there(self):
        return [each.sha256 for each in self.waiting.all()]


@pytest.fixture
def asked(tmp_path):
    return Asked(tmp_path / "waiting", 4)


def prints(requests):
    return [each.fingerprint for each in requests]


def test_a_full_room_gives_up_the_oldest_of_the_address_with_most(asked, requests):
    own, *strange = requests
    for number, each in enumerate(strange[:4]):
        asked.ask(each, ENEMY, f"/s{number}")
    asked.ask(own, HOME, "/r")
    assert asked.there == prints([*strange[1:4], own])
    for number, each in enumerate(strange[4:]):
        asked.ask(each, ENEMY, f"/t{number}")
    assert len(asked.there) == 4
    assert own.fingerprint in asked.there


def test_a_name_is_not_taken_by_who_asks_for_it_most(asked, requests):
    own, *strange = requests
    asked.ask(own, HOME, "/r")
    for each in strange:
        asked.ask(each, ENEMY, "/r")
    assert asked.there == prints([own, *strange[-2:]])


def test_of_clients_with_one_request_each_who_asks_again_stays(asked, requests):
    first, own, *others = requests
    asked.ask(first, "192.0.2.100", "/r")
    asked.ask(own, HOME, "/r")
    for number, each in enumerate(others):
        asked.ask(each, f"192.0.2.{number + 10}", "/r")
        asked.ask(own, HOME, "/r")
    assert asked.there == prints([own, *others[-2:]])
    before = asked.waiting.all()[0]
    assert (before.received, before.asked) == (NOW + 2 * SECOND, asked.now)


def test_a_network_of_ipv6_is_one_client(asked, requests):
    own, *strange = requests
    asked.ask(own, "2001:db8:1::1", "/r")
    for number, each in enumerate(strange):
        asked.ask(each, f"2001:db8:2::{number:x}", "/r")
    assert own.fingerprint in asked.there


def test_who_asks_no_more_is_forgotten_after_a_month(asked, requests):
    gone, stays, new = requests[:3]
    asked.ask(gone, HOME, "/r")
    asked.ask(stays, HOME, "/r")
    asked.now += LIFETIME - SECOND
    asked.ask(stays, HOME, "/r")
    asked.ask(new, HOME, "/r")
    assert asked.there == prints([stays, new])


def test_an_approval_that_nobody_uses_ends(tmp_path):
    """It never did: years later, anyone with the key got the certificate."""
    office = Office(tmp_path)
    made, other = office.new("r1"), office.new("r2")
    state = {"url": "https://x", "path": tmp_path / "serve.yaml", "state": tmp_path, "tls": ()}
    settings = ServerSettings(keystore=office.root, domain=office.file, **state)

    def ask(made, day):
        handler = replace(office.handler(days=day), policy=EnrolmentPolicy(approval=True))
        [answer] = handler.answers([SignerCall(kind=CallKind.REQUEST, body=made.der)])
        return answer.status, answer.detail

    def approved(day):
        with office.keystore.open_ledger() as ledger:
            return [each.name for each in open_approvals(ledger, NOW + day * DAY)]

    assert [ask(each, 0)[0] for each in (made, other)] == [202, 202]
    ids = [made.fingerprint, other.fingerprint]
    decide(office.keystore, settings, ids, APPROVAL, now=NOW)
    assert approved(30) == ["/r1", "/r2"]
    newer = office.new("r1")
    assert ask(newer, 30)[0] == 202  # nobody approved it
    assert ask(made, 30) == (200, "")
    assert (approved(30), approved(30.1)) == (["/r2"], [])
    assert ask(other, 30.1) == (403, "the approval of the request ended 2026-12-21 12:00 UTC")
    assert ask(made, 60) == (200, "")
    decide(office.keystore, settings, [newer.fingerprint], APPROVAL, now=NOW + 60 * DAY)
    assert ask(newer, 60) == (200, "")
    assert ask(made, 60) == (409, "this request was answered, and a later one too")


def test_eight_digits_of_a_digest_name_nothing(asked, requests):
    asked.ask(requests[0], HOME, "/r")
    whole = requests[0].fingerprint
    with pytest.raises(UsageError, match="is too short"):
        asked.waiting.named(whole[:15])
    assert asked.waiting.named(whole[:16].upper()).sha256 == whole
    with pytest.raises(UsageError, match="no waiting request begins with"):
        asked.waiting.named("0" * 16)


def test_of_the_requests_that_wait_no_file_is_read_again(asked, requests, monkeypatch):
    """Each request of a stranger read them all: with 500, half of the time that it took."""
    for each in requests[:3]:
        asked.ask(each, HOME, f"/{each.fingerprint}")
    before = asked.waiting.all()
    opened, counted = Path.open, []
    monkeypatch.setattr(Path, "open", lambda *each: counted.append(each) or opened(*each))
    assert asked.waiting.all() == before
    asked.ask(requests[3], HOME, "/r")
    assert counted == []
    assert len(asked.waiting.all()) == 4
    assert len(counted) == 1  # the new one


def test_a_request_that_came_again_from_elsewhere_is_shown_as_it_is(asked, requests):
    """A new file may get the inode of one that was removed, and be as long."""
    asked.ask(requests[0], HOME, "/r")
    [path] = asked.waiting.store.folder.iterdir()
    [waits] = asked.waiting.all()
    again = replace(waits, address="192.0.2.7")
    path.write_bytes(again.known.encode() + b"\n" + requests[0].der)
    assert [each.address for each in asked.waiting.all()] == ["192.0.2.7"]


def test_a_request_that_is_gone_waits_no_more_and_one_that_cannot_be_read_is_told(asked):
    assert asked.waiting.all() == []
    path = asked.waiting.store.folder / "0.request"
    assert waiting_folder._read(path) is None  # somebody just decided
    path.mkdir(parents=True)
    with pytest.raises(FileError, match=r"0\.request"):
        asked.waiting.all()


def test_a_file_with_another_request_than_its_name_says_is_refused(asked, requests):
    first, second = requests[:2]
    asked.ask(first, HOME, "/r")
    [waits] = asked.waiting.all()
    assert asked.waiting.request(waits).der == first.der
    path = asked.waiting.store.folder / f"{waits.sha256}.request"
    path.write_bytes(waits.known.encode() + b"\n" + second.der)
    with pytest.raises(MalformedError, match="its SHA-256 is another one"):
        asked.waiting.request(waits)
    path.write_bytes(b"{}\n")
    with pytest.raises(MalformedError, match="not a request that waits"):
        asked.waiting.all()
