"""A bounded number of spoilt archives in every run: each is refused in our words, and whole.

What atheris does for as long as it is let, with the same tricks and the same every time.
"""

import random

import pytest

from pqsec_pki.errors import PqsecError
from tests.fuzz import bundles, mutation
from tests.fuzz.targets import TARGETS

pytestmark = [
    pytest.mark.filterwarnings("ignore::cryptography.utils.CryptographyDeprecationWarning"),
    pytest.mark.filterwarnings("ignore:Attribute's length:UserWarning"),
]
RUNS = 60
"""Of each target, with all tricks together."""
SLOW = {bundles.bomb: 1, bundles.crowd: 1}
"""Tricks that fill the memory: one does here, more where they are fuzzed."""


def rng_of(name):
    return random.Random(name)  # noqa: S311 -- the same each time


@pytest.mark.slow(but=20)
@pytest.mark.parametrize("name", bundles.TARGETS)
@pytest.mark.parametrize("trick", dict.fromkeys(bundles.TRICKS), ids=lambda each: each.__name__)
def test_a_trick_ends_in_a_refusal_or_in_nothing_else_than_was_issued(name, trick, monkeypatch):
    monkeypatch.setattr(bundles, "TRICKS", [trick])
    target, rng = TARGETS[name], rng_of(f"{name} {trick.__name__}")
    [seed] = target.seeds()
    refused = 0
    for _ in range(SLOW.get(trick, RUNS // len(bundles.TRICKS))):
        try:
            target.take(target.spoilt(seed, rng, mutation.blindly(rng)))
        except PqsecError:
            refused += 1
    assert refused
