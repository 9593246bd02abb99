"""What a decision about waiting requests does, and what a token is in the ledger."""

from datetime import timedelta

import pytest

from pqsec_pki.domain import read_domain
from pqsec_pki.errors import KeystoreError, UsageError
from pqsec_pki.keystore import Entry, change
from pqsec_pki.server import (
    APPROVAL,
    REFUSAL,
    ServerSettings,
    decide,
    record_token,
    replacing,
    revoke_tokens,
    token_states,
)
from pqsec_pki.server.token_lines import TOKEN
from tests.unit.domains import DAY, NOW
from tests.unit.test_serve_admission import ADMITTED, Desk, asked

SECOND = timedelta(seconds=1)


class Deciding(Desk):
    """Three requests wait: two of them for one name."""

    def __init__(self, folder):
        super().__init__(folder)
        self.requests = [asked("/r1"), asked("/r1", "second"), asked("/r2")]
        for made, name in zip(self.requests, ("/r1", "/r1", "/r2"), strict=True):
            self.waiting.add(made, name, "192.0.2.1", NOW)
        state = {"url": "https://x", "path": folder / "serve.yaml", "state": folder, "tls": ()}
        self.settings = ServerSettings(keystore=self.root, domain=self.file, **state)

    def decide(self, kind, *numbers):
        ids = [self.requests[each].fingerprint for each in numbers]
        return decide(self.keystore, self.settings, ids, kind, now=NOW)

    @property
    def there(self):
        """Which of the requests wait."""
        left = {each.sha256 for each in self.waiting.all()}
        return [n for n, each in enumerate(self.requests) if each.fingerprint in left]

    @property
    def decided(self):
        """Which lines the ledger has."""
        kinds = {APPROVAL, REFUSAL}
        return [(each.kind, each.name) for each in self.keystore.ledger() if each.kind in kinds]

    def delivered(self):
        return (self.folder / "requests").exists()


@pytest.fixture
def deciding(tmp_path):
    return Deciding(tmp_path)


def test_an_approval_ends_the_wait_of_all_requests_for_its_name(deciding):
    deciding.decide(APPROVAL, 1)
    assert (deciding.there, deciding.decided) == ([2], [(APPROVAL, "/r1")])


def test_a_refusal_ends_the_wait_of_that_request_alone(deciding):
    deciding.decide(REFUSAL, 1)
    assert (deciding.there, deciding.decided) == ([0, 2], [(REFUSAL, "/r1")])


def test_of_one_name_several_are_refused_and_one_is_approved(deciding):
    with pytest.raises(UsageError, match="approve one request for /r1: the last would replace it"):
        deciding.decide(APPROVAL, 0, 1, 2)
    assert (deciding.there, deciding.decided) == ([0, 1, 2], [])
    deciding.decide(REFUSAL, 0, 1)
    assert (deciding.there, deciding.decided) == ([2], [(REFUSAL, "/r1")] * 2)


def test_only_what_is_approved_where_a_plan_issues_goes_to_the_domain_file(deciding):
    deciding.decide(APPROVAL, 2)
    assert not deciding.delivered()
    deciding.demand_approvals()
    deciding.decide(REFUSAL, 1)
    assert not deciding.delivered()
    deciding.decide(APPROVAL, 0)
    member = read_domain(deciding.file).members["/r1"]
    assert member.request.read_bytes() == deciding.requests[0].pem


def test_a_name_that_the_domain_file_lost_is_not_approved_where_a_plan_issues(deciding):
    deciding.demand_approvals()
    deciding.change("/r{1..2}", "/r1")
    with pytest.raises(UsageError, match=r"domain\.yaml no longer names /r2"):
        deciding.decide(APPROVAL, 0, 2)
    assert (deciding.there, deciding.decided, deciding.delivered()) == ([0, 1, 2], [], False)


def test_a_request_for_the_key_that_its_participant_has_replaces_nothing(deciding):
    assert deciding.ask(asked("/r1"), deciding.token("/r1")) == ADMITTED
    found = replacing(deciding.keystore, deciding.waiting.all(), now=NOW)
    assert found == {deciding.requests[1].fingerprint}


# Tokens


@pytest.fixture
def desk(tmp_path):
    return Desk(tmp_path)


def test_a_token_ends_after_the_second_that_it_names(desk):
    desk.token("/r1")
    [found] = token_states(desk.keystore)
    assert found.end(found.not_after) == ""
    assert found.end(found.not_after + SECOND) == "expired"


@pytest.mark.parametrize("uses", ["many", "-1", ""])
def test_a_token_without_a_number_of_uses_is_damaged(desk, uses):
    details = {"names": "/r1", "uses": uses}
    entry = Entry.of(TOKEN, "aa", "00" * 32, NOW, not_after=NOW + DAY, details=details)
    with change(desk.root) as transaction:
        transaction.record(entry)
    with pytest.raises(KeystoreError, match="line on enrolment-token aa is damaged"):
        token_states(desk.keystore)


def test_of_tokens_with_one_that_is_unknown_none_is_revoked(desk):
    known = desk.token("/r1")["token"]
    with pytest.raises(KeystoreError, match="the ledger has no enrolment token nobody"):
        revoke_tokens(desk.keystore, [known, "nobody"], now=NOW)
    assert [each.end(NOW) for each in token_states(desk.keystore)] == [""]
    revoke_tokens(desk.keystore, [known], now=NOW)
    assert [each.end(NOW) for each in token_states(desk.keystore)] == ["revoked"]


REPLACES = "for one name and one use"
REFUSED = {
    "past": ({"not_after": NOW - SECOND}, {}, "in the past"),
    "ends now": ({"not_after": NOW}, {}, "in the past"),
    "no name": ({"names": "/r1 r2/"}, {}, "'r2/' is not a participant's name"),
    "two uses": ({}, {"uses": 2, "replaces": True}, REPLACES),
    "a pattern": ({"names": "/r*"}, {"replaces": True}, REPLACES),
}


@pytest.mark.parametrize("flaw", REFUSED)
def test_a_token_that_cannot_be_is_not_recorded(desk, flaw):
    made, options, words = REFUSED[flaw]
    token = desk.made(**{"names": "/r1", **made})
    with pytest.raises(UsageError, match=words):
        record_token(desk.keystore, token, **{"uses": 1, "replaces": False, **options}, now=NOW)
    assert token_states(desk.keystore) == []


def test_a_token_that_ends_in_a_second_is_recorded(desk):
    token = desk.made("/r*", not_after=NOW + SECOND)
    record_token(desk.keystore, token, uses=2, replaces=False, now=NOW)
    [found] = token_states(desk.keystore)
    assert (found.uses, found.replaces, found.not_after) == (2, False, NOW + SECOND)
