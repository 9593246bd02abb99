"""Does each target get as far as it should? A harness that refuses its seeds finds nothing."""

import pytest

from tests.fuzz.targets import TARGETS

# cryptography warns of what it will refuse some day.
pytestmark = pytest.mark.filterwarnings(
    "ignore::cryptography.utils.CryptographyDeprecationWarning",
    "ignore:Attribute's length:UserWarning",
)


@pytest.mark.parametrize("name", TARGETS)
def test_a_target_takes_what_is_real(name):
    target = TARGETS[name]
    for seed in target.seeds():
        target.take(seed)
