"""A ledger that was put back to an earlier copy decides nothing, beside a head that shows it."""

import pytest

from pqsec_pki.algorithms import SIGNATURES
from pqsec_pki.approvals import ApprovalPolicy, Covered
from pqsec_pki.enrolment import Bundle
from pqsec_pki.errors import KeystoreError, PqsecError, VerificationError
from pqsec_pki.keystore import Keystore, audit, heads, registrations, status
from pqsec_pki.lifecycle import (
    change_passphrase,
    end_registrations,
    fetch_files,
    renew,
    renew_list,
    revocable,
    revoke,
    store_approvals,
)
from pqsec_pki.lint import check
from pqsec_pki.server.token_lines import record_token, revoke_tokens, token_states
from tests.unit.keystores import NOW, add, made
from tests.unit.test_ledger_heads import forget_heads
from tests.unit.test_registration import Line
from tests.unit.test_serve_calls import Served

OLDER = "the ledger lacks"


def rolled_back(keystore, change):
    """Make the change, and put the ledger back to what it was before."""
    path = keystore.root / "private/ledger.sqlite3"
    before = path.read_bytes()
    change()
    path.write_bytes(before)


def files(keystore):
    return {each: each.read_bytes() for each in keystore.root.rglob("*") if each.is_file()}


@pytest.fixture
def keystore(tmp_path):
    return made(tmp_path / "k", "classical")


def revoked(keystore):
    revoke(keystore, keystore.unlock(None), ["/talker"], now=NOW)


DECISIONS = {
    "issue": lambda k: add(k, more="0"),
    "renew": lambda k: renew(k, k.unlock(None), ["/listener"], now=NOW),
    "revoke": lambda k: revoke(k, k.unlock(None), ["/listener"], now=NOW),
    "what revoke would revoke": lambda k: revocable(k, ["/talker"], now=NOW),
    "a list": lambda k: renew_list(k, k.unlock(None), now=NOW),
    "a bundle": lambda k: Bundle.of(k, ["/listener"], now=NOW),
    "the rule of approvals": lambda k: k.approvals,
    "registration authorities": registrations,
    "tokens": token_states,
    "status": lambda k: status(k, now=NOW),
    "a passphrase": lambda k: change_passphrase(k, k.unlock(None), b"a new passphrase"),
    "fetching": lambda k: fetch_files(k, k.unlock(None), []),
    "lines": Keystore.lines,
}


@pytest.mark.parametrize("decision", DECISIONS)
def test_a_ledger_from_before_a_revocation_decides_nothing(keystore, decision):
    rolled_back(keystore, lambda: revoked(keystore))
    before = files(keystore)
    with pytest.raises(KeystoreError, match=OLDER) as caught:
        DECISIONS[decision](keystore)
    assert "restore the ledger" in caught.value.hint
    assert files(keystore) == before


def test_what_shows_the_ledger_shows_it_all_the_same(keystore):
    rolled_back(keystore, lambda: revoked(keystore))
    with pytest.raises(VerificationError, match="the end was cut off"):
        audit(keystore)
    assert keystore.as_found.lines()[-1].entry.kind == "permissions"
    assert status(keystore.as_found, now=NOW).participants
    assert [each.rule.id for each in check([keystore.root], now=NOW).findings].count("PQS008")


def test_the_ledger_of_another_history_is_refused_when_it_has_grown(keystore):
    """It is longer than the signed head, and its lines up to there are others."""
    path = keystore.root / "private/ledger.sqlite3"
    head = keystore.root / "public/ledger.checkpoint"
    before = path.read_bytes()
    revoked(keystore)
    newest = head.read_bytes()
    path.write_bytes(before)
    forget_heads(keystore)
    for number in range(3):
        add(keystore, **{f"more{number}": "0"})
    head.write_bytes(newest)
    (keystore.root / "public/ledger.tree").unlink()
    with pytest.raises(KeystoreError, match="lacks one of the"):
        add(keystore, last="0")


def test_the_rule_of_approvals_does_not_end_with_an_older_ledger(keystore):
    keys = {name: SIGNATURES.named("ecdsa-p256").generate().public_key for name in ("a", "b")}
    rule = ApprovalPolicy.of(2, {Covered.GROW}, keys)
    rolled_back(keystore, lambda: store_approvals(keystore, keystore.unlock(None), rule, now=NOW))
    with pytest.raises(KeystoreError, match=OLDER):
        add(keystore, more="0")
    with pytest.raises(KeystoreError, match=OLDER):
        keystore.refuse_unapproved(Covered.GROW)


def test_a_used_order_and_an_ended_grant_are_not_new_again(tmp_path):
    line = Line(tmp_path / "line")
    grant = line.add()
    order = line.order(grant, "/fleet/r1")
    rolled_back(line.keystore, lambda: line.perform(order))
    with pytest.raises(PqsecError, match=r"the end was cut off|the ledger lacks"):
        line.perform(line.order(grant, "/fleet/r2"))
    with pytest.raises(KeystoreError, match=OLDER):
        end_registrations(line.keystore, line.cas, ["line1"], now=NOW)


def test_a_used_token_is_not_new_again(tmp_path):
    served = Served(tmp_path)
    rolled_back(served.keystore, lambda: served.ask("/fleet/r1"))
    assert served.ask("/fleet/r2").status == 503
    with pytest.raises(KeystoreError, match=OLDER):
        revoke_tokens(served.keystore, [served.token.id], now=NOW)
    with pytest.raises(KeystoreError, match=OLDER):
        record_token(served.keystore, served.token, uses=2, replaces=False, now=NOW)


@pytest.mark.parametrize("profile", ["classical", "pq", "transition"])
def test_a_head_that_is_behind_the_ledger_is_no_reason_to_refuse(tmp_path, profile):
    """As a kill, or a change without the permissions CA's keys, leaves it."""
    keystore = made(tmp_path / "k", profile)
    head = keystore.root / "public/ledger.checkpoint"
    for number in range(4):  # sizes with subtrees of other lengths
        before = head.read_bytes()
        add(keystore, **{f"n{number}": "0"})
        newest = head.read_bytes()
        head.write_bytes(before)
        assert status(Keystore.open(keystore.root), now=NOW).participants
        head.write_bytes(newest)
        assert status(Keystore.open(keystore.root), now=NOW).participants


def test_a_change_by_another_thread_is_waited_for(keystore, monkeypatch):
    """A change puts the head into its place before its lines: a reader between them waits."""
    path = keystore.root / "private/ledger.sqlite3"
    older = path.read_bytes()
    add(keystore, more="0")
    newer = path.read_bytes()
    path.write_bytes(older)
    rest = heads.at_rest

    def at_rest(root):
        path.write_bytes(newer)  # the change is finished meanwhile
        return rest(root)

    monkeypatch.setattr(heads, "at_rest", at_rest)
    assert Keystore.open(keystore.root).lines()[-1].entry.name == "/more"
