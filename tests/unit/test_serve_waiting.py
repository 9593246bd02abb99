"""The requests that wait: whose are given up when it is full, and what names one."""

from datetime import timedelta

import pytest

from pqsec_pki.algorithms import profile_named
from pqsec_pki.enrolment import request
from pqsec_pki.errors import MalformedError, UsageError
from pqsec_pki.server.waiting import LIFETIME, PendingRequests
from tests.unit.keystores import NOW

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
        self.pending, self.now = PendingRequests(folder, most), NOW

    def ask(self, made, address, name):
        self.now += SECOND
        self.pending.add(made, name, address, self.now)

    @property
    def there(self):
        return [each.sha256 for each in self.pending.all()]


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
    before = asked.pending.all()[0]
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


def test_eight_digits_of_a_digest_name_nothing(asked, requests):
    asked.ask(requests[0], HOME, "/r")
    whole = requests[0].fingerprint
    with pytest.raises(UsageError, match="is too short"):
        asked.pending.named(whole[:15])
    assert asked.pending.named(whole[:16].upper()).sha256 == whole
    with pytest.raises(UsageError, match="no waiting request begins with"):
        asked.pending.named("0" * 16)


def test_a_file_with_another_request_than_its_name_says_is_refused(asked, requests):
    first, second = requests[:2]
    asked.ask(first, HOME, "/r")
    [waits] = asked.pending.all()
    assert asked.pending.request(waits).der == first.der
    path = asked.pending.folder / f"{waits.sha256}.request"
    path.write_bytes(waits.line + second.der)
    with pytest.raises(MalformedError, match="another request than its name says"):
        asked.pending.request(waits)
    path.write_bytes(b"{}\n")
    with pytest.raises(MalformedError, match="not a request that waits"):
        asked.pending.all()
