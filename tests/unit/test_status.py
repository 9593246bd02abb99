"""What is due, what has ended, and what comes first."""

import shutil
from datetime import timedelta

import pytest

from pqsec_pki.errors import KeystoreError, UsageError
from pqsec_pki.keystore import State, status
from pqsec_pki.lifecycle import ParticipantSpec, issue, renew, renew_list, revoke
from tests.unit.keystores import DAY, NOW, made


@pytest.fixture
def keystore(tmp_path):
    """Participants that were issued for so many days as their names say."""
    keystore = made(tmp_path / "k", "classical", domains="0-3", names=())
    specs = [
        ParticipantSpec(
            name=f"/p{days}", domains=keystore.domains, publish=("x",), validity=days * DAY
        )
        for days in (300, 9, 90)
    ]
    issue(keystore, keystore.unlock(None), specs, now=NOW)
    return keystore


def states(keystore, now=NOW, **options):
    return {each.name: each.state for each in status(keystore, now=now, **options).participants}


@pytest.mark.parametrize(
    ("days", "expected"),
    [
        (0, {"/p9": "valid", "/p90": "valid", "/p300": "valid"}),
        (5.9, {"/p9": "valid", "/p90": "valid", "/p300": "valid"}),
        (6, {"/p9": "due", "/p90": "valid", "/p300": "valid"}),
        (60, {"/p9": "expired", "/p90": "due", "/p300": "valid"}),
        (299, {"/p9": "expired", "/p90": "expired", "/p300": "due"}),
    ],
)
def test_due_is_what_has_less_than_a_third_of_its_life_left(keystore, days, expected):
    found = states(keystore, NOW + days * DAY)
    assert found == expected
    assert list(found) == list(expected), "the most urgent first"


@pytest.mark.parametrize(
    ("due", "expected"), [(9, {"/p9"}), (90, {"/p9", "/p90"}), (8, set()), (1000, None)]
)
def test_due_may_be_a_time(keystore, due, expected):
    standing = status(keystore, now=NOW, due=due * DAY)
    assert set(standing.due) == ({"/p9", "/p90", "/p300"} if expected is None else expected)


def test_the_newest_certificate_counts(keystore):
    renew(keystore, keystore.unlock(None), ["/p9"], now=NOW + 8 * DAY)
    [found] = status(keystore, ["p9"], now=NOW + 10 * DAY).participants
    certificate = keystore.participant("/p9").certificate
    assert (found.state, found.not_after) == (State.VALID, certificate.not_after)
    assert found.serial == f"{certificate.serial_number:x}"
    assert (found.profile, found.domains) == ("classical", "0-3")


def test_who_is_revoked_or_gone_comes_last_and_is_not_due(keystore):
    revoke(keystore, keystore.unlock(None), ["/p9"], now=NOW)
    shutil.rmtree(keystore.root / "enclaves/p90")
    standing = status(keystore, now=NOW + 250 * DAY)
    found = {each.name: each.state for each in standing.participants}
    assert found == {"/p300": "due", "/p9": "revoked", "/p90": "gone"}
    assert list(found) == ["/p300", "/p9", "/p90"]
    assert standing.due == ["/p300"]
    counts = {
        "expired": 0,
        "not-yet-valid": 0,
        "previous-ca": 0,
        "due": 1,
        "incomplete": 0,
        "valid": 0,
        "revoked": 1,
        "gone": 1,
        "elsewhere": 0,
    }
    assert standing.counts() == counts


def test_the_cas_and_the_list_are_told_of_too(keystore, tmp_path):
    assert [each.kind for each in status(keystore, now=NOW).shared] == [
        "identity-ca",
        "permissions-ca",
    ]
    renew_list(keystore, keystore.unlock(None), now=NOW, validity=timedelta(days=30))
    terms = {each.kind: each for each in status(keystore, now=NOW + 25 * DAY).shared}
    assert terms["identity-ca"].not_after == keystore.identity_ca.not_after
    assert terms["crl"].state is State.DUE
    assert status(keystore, now=NOW + 25 * DAY).list_is_due
    other = made(tmp_path / "other", "transition", names=())
    kinds = [each.kind for each in status(other, now=NOW).shared]
    assert kinds == ["identity-ca", "permissions-ca", "countersigner"]


def test_nothing_is_no_error(tmp_path):
    standing = status(made(tmp_path / "k", "classical", names=()), now=NOW)
    assert standing.participants == ()
    assert standing.due == []


@pytest.mark.parametrize(("name", "error"), [("/nobody", KeystoreError), ("..", UsageError)])
def test_who_is_not_known_is_refused(keystore, name, error):
    with pytest.raises(error):
        status(keystore, ["/p9", name], now=NOW)


def test_no_files_of_participants_are_read(keystore):
    for name in ("p9", "p90", "p300"):
        for path in (keystore.root / "enclaves" / name).iterdir():
            if not path.is_symlink():
                path.write_bytes(b"")
    assert set(states(keystore)) == {"/p9", "/p90", "/p300"}
