"""The plugin where so many packets get lost that no handshake goes through at the first try."""

from dataclasses import replace

import pytest

from pqsec_pki.documents import Governance, ProtectionKind
from tests.interop.conftest import DOMAINS
from tests.interop.plugin.hosts import cyclonedds
from tests.interop.plugin.processes import Stage, logs

pytestmark = pytest.mark.interop

LOSS = 0.1
MEETING = 20.0
"""Seconds; at such a loss one pair takes 3 to 13, and one in eight longer."""
RECEIVERS = 3


@pytest.fixture
def stage(requires, shim, plugins, tmp_path) -> Stage:
    folder = tmp_path / "configurations"
    folder.mkdir()
    found = requires(cyclonedds(), "Cyclone DDS to compile against", "cyclonedds-dev and -tools")
    return Stage(found, shim, plugins, folder)


@pytest.mark.slow
def test_one_meets_others_at_a_loss_of_ten_percent_and_nobody_crashes(stage, labs, enclave):
    """With rtps_protection_kind NONE, where Cyclone DDS repeats what was lost of a handshake."""
    lab = labs("pq")
    governance = Governance.protected(DOMAINS)
    rule = replace(governance.domain_rules[0], rtps_protection_kind=ProtectionKind.NONE)
    document = lab.sign(replace(governance, domain_rules=(rule,)).to_xml())
    alice, bob = (enclave(each, {"governance.p7s": document}) for each in (lab.alice, lab.bob))
    sender = stage.sender(alice, loss=LOSS)
    receivers = [stage.receiver(bob, loss=LOSS) for _ in range(RECEIVERS)]
    went = stage.run_peers(sender, *receivers, seconds=MEETING)
    assert not any(each.signal or each.refused for each in went.outcomes), logs(went)
    assert sender.text in {each.received for each in went.outcomes}, logs(went)
