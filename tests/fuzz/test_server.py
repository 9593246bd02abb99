"""A bounded number of spoilt requests and answers in every run, the same every time."""

import random

import pytest

from pqsec_pki.errors import PqsecError
from tests.fuzz import mutation, server
from tests.fuzz.targets import TARGETS

pytestmark = [
    pytest.mark.filterwarnings("ignore::cryptography.utils.CryptographyDeprecationWarning"),
    pytest.mark.filterwarnings("ignore:Attribute's length:UserWarning"),
]
RUNS = 200


@pytest.mark.slow(but=2)
@pytest.mark.parametrize("name", server.TARGETS)
def test_what_is_spoilt_is_answered_or_refused(name):
    target, rng = TARGETS[name], random.Random(name)  # noqa: S311 -- the same each time
    seeds, taken = target.seeds(), 0
    for number in range(RUNS):
        data = seeds[number % len(seeds)]
        for _ in range(1 + number % 3):
            data = target.spoilt(data, rng, mutation.blindly(rng))
        try:
            target.take(data)
            taken += 1
        except PqsecError:
            continue
    assert taken


def test_who_asks_too_often_on_one_connection_is_told_once():
    """Each of a thousand requests in one read was answered with 429, and nobody else meanwhile."""
    sent = server.take_http(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n" * 1000)
    assert server.STATUS.findall(sent) == [b"404"] * server.ENOUGH + [b"429"]
    assert b"Connection: close" in sent.rpartition(b"HTTP/1.1 429")[2]
