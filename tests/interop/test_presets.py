"""Real stacks take every preset, and permissions made of YAML and of SROS2's policies.

The access control of Cyclone DDS and of Fast DDS reads the signed documents and lets a
participant join, or not. (Fast DDS joins domains that the documents do not name.)
"""

from datetime import timedelta
from pathlib import Path

import pytest

from pqsec_pki.documents import (
    PRESETS,
    DomainSet,
    governance_from_yaml,
    new_governance,
    new_permissions,
    permissions_from_yaml,
    sros2,
)
from tests.interop import cyclone, fastdds
from tests.interop.cyclone import RefusedError

pytestmark = pytest.mark.interop

POLICIES = Path(__file__).parents[1] / "vectors/corpus/sros2/test/policies"
TALKER = """
validity: 1w
grants:
  - name: /lab/alice
    domains: 0-2
    publish: [{topics: rt/map, partitions: [floor1], data_tags: {kind: x}}]
    nodes:
      - {node: /talker, publish: chatter, clients: /add, lifecycle: true, use_sim_time: true}
      - {node: planner, namespace: /robot, action_clients: go, parameters_of: /talker}
"""


STACKS = {"cyclonedds": ("plugins", cyclone), "fastdds": ("fastdds", fastdds)}


@pytest.fixture(params=STACKS)
def stack(request):
    """The name of each stack in turn."""
    return request.param


@pytest.fixture
def joins(request, labs, enclave, stack):
    """joins(domain, **{file: XML}) lets alice join with these documents, signed."""
    fixture, module = STACKS[stack]
    library = request.getfixturevalue(fixture)

    def join(domain, **documents):
        lab = labs("classical")
        signed = {f"{name}.p7s": lab.sign(xml) for name, xml in documents.items()}
        with module.participant(library, enclave(lab.alice, signed)) as alice:
            alice.join(domain)

    return join


@pytest.mark.parametrize("preset", PRESETS, ids=lambda preset: preset.name)
def test_every_preset_is_taken_on_its_domains(joins, stack, preset):
    governance = governance_from_yaml(new_governance(preset, DomainSet.parse("0,3-4"))).to_xml()
    for domain in (0, 4):
        joins(domain, governance=governance)
    if stack == "cyclonedds":
        with pytest.raises(RefusedError, match="domain 1"):
            joins(1, governance=governance)


def test_permissions_of_yaml_are_taken(joins, now):
    permissions = permissions_from_yaml(TALKER.encode(), now=now).to_xml()
    joins(2, permissions=permissions)
    other = permissions.replace(b"CN=/lab/alice", b"CN=/lab/other")
    with pytest.raises(RefusedError):
        joins(2, permissions=other)


def test_new_permissions_are_taken_as_they_are(joins, now):
    new = [new_permissions(["/lab/alice"], DomainSet.of(0), "1d", nodes=n) for n in (True, False)]
    for document in new:
        joins(0, permissions=permissions_from_yaml(document, now=now).to_xml())


def test_permissions_of_an_sros2_policy_are_taken(joins, now, tmp_path):
    text = (POLICIES / "talker_listener.policy.xml").read_text()
    (tmp_path / "common").symlink_to(POLICIES / "common")
    policy = tmp_path / "p.policy.xml"
    policy.write_text(text.replace("/talker_listener/talker", "/lab/alice"))
    enclaves = sros2.read_policy(policy, root=Path("/"))
    permissions = sros2.permissions_of(
        enclaves,
        domains=DomainSet.of(7),
        not_before=now - timedelta(days=1),
        not_after=now + timedelta(days=1),
    )
    joins(7, permissions=permissions.to_xml())
