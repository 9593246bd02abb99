"""The file with an enrolment token."""

import json
import traceback
from datetime import timedelta

import pytest

from pqsec_pki.enrolment import pins_of
from pqsec_pki.errors import MalformedError, PqsecError, UsageError
from pqsec_pki.est import EnrolmentToken, checked_url, is_secret
from tests.unit.killing import NOW

PIN = "ab" * 32


def some_token(**changes):
    given = {
        "server": "https://fleet.example:8443/",
        "server_pins": frozenset({PIN}),
        "cas": pins_of([f"identity:{PIN}", f"permissions:{PIN}"]),
        "names": "/fleet/*",
        "profile": "pq",
        "not_after": NOW + timedelta(days=1),
    }
    return EnrolmentToken.new(**{**given, **changes})


def test_a_token_is_read_as_it_was_written():
    token = some_token()
    assert token.server == "https://fleet.example:8443"
    assert EnrolmentToken.from_bytes(token.to_bytes()) == token


def test_two_tokens_have_nothing_in_common():
    one, other = some_token(), some_token()
    assert one.id != other.id
    assert one.secret != other.secret


def test_the_server_keeps_only_what_proves_the_secret():
    token = some_token()
    assert is_secret(token.secret, token.secret_hash)
    assert not is_secret(some_token().secret, token.secret_hash)
    assert not is_secret("", "")
    assert not is_secret("ä", token.secret_hash)
    assert not is_secret(token.secret[:-4], token.secret_hash)


def test_the_secret_is_in_no_repr():
    token = some_token()
    assert token.secret not in repr(token)


CHANGES = [
    {"format": 2},
    {"kind": "bundle"},
    {"server": "http://fleet.example"},
    {"server": 5},
    {"server_pins": ["abc"]},
    {"server_pins": 1},
    {"cas": ["0" * 64]},
    {"id": "../etc"},
    {"secret": ""},
    {"secret": "c2hvcnQ"},
    {"not_after": "soon"},
    {"not_after": None},
]


@pytest.mark.parametrize("change", CHANGES, ids=json.dumps)
def test_a_damaged_token_is_refused_without_its_secret(change):
    token = some_token()
    data = json.dumps({**json.loads(token.to_bytes()), **change}).encode()
    with pytest.raises(MalformedError) as refused:
        EnrolmentToken.from_bytes(data)
    assert token.secret not in str(refused.value)
    assert token.secret not in "".join(traceback.format_exception(refused.value))


@pytest.mark.parametrize("data", [b"", b"[]", b"{}", b"\xff", b"[" * 100_000, b"1", b'"kind"'])
def test_anything_else_is_no_token(data):
    with pytest.raises(PqsecError):
        EnrolmentToken.from_bytes(data)


@pytest.mark.parametrize(
    "text",
    [
        *("fleet.example", "http://fleet.example", "https://", "https://a/path", "https://u:p@a"),
        *("https://a?x", "https://a#x", "https://a:99999", "https://[::1", "ftp://a"),
    ],
)
def test_what_is_not_the_url_of_a_server_is_refused(text):
    with pytest.raises(UsageError, match="not the URL of a server"):
        checked_url(text)
