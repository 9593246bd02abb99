"""A robot that was stolen and came back: one token lets it in again, and no other does."""

from datetime import UTC, datetime

import pytest

from pqsec_pki.certificates import Reason
from pqsec_pki.errors import KeystoreError, UsageError
from pqsec_pki.keystore import State, status
from pqsec_pki.lifecycle import revoke
from pqsec_pki.server import record_token, token_states
from tests.unit.domains import NOW
from tests.unit.serving import Server
from tests.unit.test_serve_admission import ADMITTED, Desk, asked

REVOKED = 403, "/r1 was revoked"


class Stolen(Desk):
    """/r1 enrolled and was revoked since."""

    def __init__(self, folder):
        super().__init__(folder)
        assert self.ask(asked("/r1"), self.token("/r1")) == ADMITTED
        self.before = self.token("/r1", replaces=True)
        self.revoke()

    def revoke(self, reason=Reason.KEY_COMPROMISE):
        keystore = self.keystore
        revoke(keystore, keystore.unlock(None), ["/r1"], reason=reason, now=NOW)

    def back(self, names="/r1", **how):
        """What a client shows of a token for what was revoked."""
        made = self.made(names)
        options = {"uses": 1, "replaces": True, "after_revocation": True, **how}
        record_token(self.keystore, made, **options, now=NOW)
        return {"token": made.id, "secret": made.secret}

    @property
    def state(self):
        [found] = status(self.keystore, ["/r1"], now=NOW).participants
        return found.state


@pytest.fixture
def stolen(tmp_path):
    return Stolen(tmp_path)


def test_a_token_for_what_was_revoked_is_refused_when_it_is_made(stolen):
    """It was accepted, and `enrol` said Forbidden without a way out."""
    for replaces in (True, False):
        with pytest.raises(KeystoreError, match="revoked: /r1") as refused:
            stolen.token("/r1", replaces=replaces)
        assert "--replace --after-revocation" in refused.value.hint


def test_a_token_that_was_made_since_admits_it_once_with_a_new_key(stolen):
    shown = stolen.back()
    assert stolen.ask(asked("/r1", "second"), shown) == ADMITTED
    assert stolen.state is State.VALID
    assert stolen.ask(asked("/r1", "third"), shown)[0] == 401
    listed = {each.serial_number for each in stolen.keystore.revocation_list.revoked}
    [line] = [each for each in stolen.keystore.ledger() if each.kind == "revocation"]
    assert line.serial_number in listed


def test_the_key_that_was_stolen_does_not_come_back(stolen):
    request = asked("/r1")  # the same key
    code, words = stolen.ask(request, stolen.back())
    assert code == 403
    assert "compromised" in words
    assert stolen.state is State.REVOKED


def test_a_token_that_the_thief_may_have_does_not_admit_it(stolen):
    assert stolen.ask(asked("/r1", "second"), stolen.before) == REVOKED
    assert stolen.state is State.REVOKED


def test_a_token_for_many_does_not_admit_what_was_revoked(stolen):
    assert stolen.ask(asked("/r1", "second"), stolen.token("/*")) == REVOKED


def test_nobody_else_is_let_in_beside_it(stolen):
    """An issue for several at once has one option for all."""
    assert stolen.ask(asked("/r2"), stolen.token("/r2")) == ADMITTED
    keystore = stolen.keystore
    many = stolen.token("/*", uses=2)
    revoke(keystore, keystore.unlock(None), ["/r2"], now=NOW)
    assert stolen.ask(asked("/r2", "second"), many)[0] == 403


def test_a_token_is_spent_by_the_next_revocation(stolen):
    shown, more = stolen.back(), stolen.back()
    assert stolen.ask(asked("/r1", "second"), shown) == ADMITTED
    stolen.revoke(Reason.UNSPECIFIED)
    assert stolen.ask(asked("/r1", "third"), more) == REVOKED


def test_a_token_is_spent_when_the_reason_becomes_a_compromise(tmp_path):
    """Somebody learned that the robot was stolen, and not lost."""
    stolen = Desk(tmp_path)
    assert stolen.ask(asked("/r1"), stolen.token("/r1")) == ADMITTED
    Stolen.revoke(stolen, Reason.UNSPECIFIED)
    shown = Stolen.back(stolen)
    Stolen.revoke(stolen)
    assert stolen.ask(asked("/r1", "second"), shown)[0] == 403


def test_only_a_token_that_replaces_is_for_what_was_revoked(stolen):
    with pytest.raises(UsageError):
        stolen.back(replaces=False)
    with pytest.raises(UsageError):
        stolen.back("/*")


def test_where_plans_are_approved_no_token_brings_back_what_was_revoked(stolen):
    stolen.demand_approvals()
    with pytest.raises(KeystoreError) as refused:
        stolen.back()
    assert "pqsec propose issue" in refused.value.hint


def test_the_list_of_tokens_says_which_are_for_what_was_revoked(stolen):
    stolen.back()
    found = [each.to_json(NOW)["after_revocation"] for each in token_states(stolen.keystore)]
    assert found == [False, False, True]


@pytest.mark.slow
def test_a_stolen_robot_comes_back_over_the_network(tmp_path):
    """With the commands that the refusals name."""
    folder, robot, name = tmp_path / "s", tmp_path / "robot", "/fleet/r1"
    folder.mkdir()
    server = Server(folder, datetime.now(UTC))
    create = ("enrolment-token", "create", name, "--config", "serve.yaml")
    enrol = ("enrol", "--dir", robot, "--token-file")
    with server.running():
        server.cli(*create, "-o", "first.token")
        server.cli(*enrol, "first.token")
        server.cli(*create, "--replace", "-o", "thief.token")
        server.cli("revoke", name, "--reason", "keyCompromise", "--yes")
        forgot = server.cli(*enrol, "thief.token", check=False)  # without --force
        assert (forgot.returncode, forgot.stdout) == (1, "")
        assert "was revoked\npqsec: hint: if it came back, `pqsec enrol" in forgot.stderr
        refused = server.cli(*create, "--replace", "-o", "back.token", check=False)
        assert (refused.returncode, "--replace --after-revocation" in refused.stderr) == (3, True)
        assert not (folder / "back.token").exists()
        fleet = server.cli(*create[:2], "/fleet/*", *create[3:], "-o", "fleet.token")
        assert "the token does not admit /fleet/r1: revoked" in fleet.stderr
        thief = server.cli(*enrol, "thief.token", "--force", check=False)
        assert thief.returncode == 1
        assert "Forbidden: /fleet/r1 was revoked" in thief.stderr
        assert "hint: if it came back, `pqsec enrolment-token create NAME --replace" in thief.stderr
        server.cli(*create, "--replace", "--after-revocation", "-o", "back.token")
        done = server.cli(*enrol, "back.token", "--force")
        assert f"{name}  has a new certificate" in done.stdout
        delivery = server.cli("status", "--json").stdout
        assert '"without_receipt": 1' in delivery  # /local, whose keys are here
        assert '"late": []' not in delivery
