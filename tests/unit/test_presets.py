"""Presets: what they promise is what their governance says."""

import pytest

from pqsec_pki.documents import (
    PRESETS,
    DomainSet,
    Governance,
    ProtectionKind,
    preset_named,
)
from pqsec_pki.errors import UsageError

NONE, SIGN, ENCRYPT = list(ProtectionKind)[:3]
DOMAINS = DomainSet.parse("0-3")


def rules_of(name):
    """(domain rule, its one topic rule)."""
    [rule] = preset_named(name).governance(DOMAINS).domain_rules
    [topic] = rule.topic_rules
    return rule, topic


every = pytest.mark.parametrize("preset", PRESETS, ids=lambda preset: preset.name)


@every
def test_a_preset_is_explained(preset):
    assert preset_named(preset.name) is preset
    assert preset.summary.endswith(".")
    assert len(preset.protects) > 80
    assert len(preset.costs) > 80


@every
def test_a_preset_covers_all_topics_of_its_domains_and_is_valid(preset):
    rule, topic = rules_of(preset.name)
    assert rule.domains == DOMAINS
    assert topic.topic_expression == "*"
    value = preset.governance(DOMAINS)
    assert Governance.from_xml(value.to_xml()) == value


def kinds_of(rule, topic):
    return {
        rule.discovery_protection_kind,
        rule.liveliness_protection_kind,
        rule.rtps_protection_kind,
        topic.metadata_protection_kind,
        topic.data_protection_kind,
    }


@every
def test_no_preset_asks_for_what_some_stack_refuses(preset):
    rule, topic = rules_of(preset.name)
    assert kinds_of(rule, topic) <= {NONE, SIGN, ENCRYPT}
    if rule.allow_unauthenticated_participants:  # Fast DDS 3
        assert rule.rtps_protection_kind is NONE


@every
def test_every_preset_controls_access_and_lets_nobody_alter_data(preset):
    rule, topic = rules_of(preset.name)
    assert rule.enable_join_access_control
    assert topic.enable_read_access_control
    assert topic.enable_write_access_control
    assert {topic.metadata_protection_kind, topic.data_protection_kind} != {NONE}


def test_strict_is_what_ca_init_writes():
    assert PRESETS[0].name == "strict"
    assert preset_named("strict").governance(DOMAINS) == Governance.protected(DOMAINS)


def test_authenticated_signs_and_encrypts_nothing():
    rule, topic = rules_of("authenticated")
    assert ENCRYPT not in kinds_of(rule, topic)
    assert topic.metadata_protection_kind is SIGN


@pytest.mark.parametrize("name", ["open-discovery", "migration"])
def test_discovery_is_in_clear_and_data_is_not(name):
    rule, topic = rules_of(name)
    assert rule.discovery_protection_kind is NONE
    assert not topic.enable_discovery_protection
    assert topic.data_protection_kind is ENCRYPT


def test_a_lossy_network_carries_nothing_more_for_each_packet():
    rule, topic = rules_of("lossy-network")
    assert rule.rtps_protection_kind is NONE
    assert topic.metadata_protection_kind is NONE
    assert topic.data_protection_kind is ENCRYPT


def test_only_migration_lets_strangers_in():
    rules = {preset.name: rules_of(preset.name)[0] for preset in PRESETS}
    open_ = [name for name, rule in rules.items() if rule.allow_unauthenticated_participants]
    assert open_ == ["migration"]


@pytest.mark.parametrize(("name", "hint"), [("stric", "strict"), ("x", "governance presets")])
def test_an_unknown_preset_is_refused_with_the_way_on(name, hint):
    with pytest.raises(UsageError, match="is not a preset") as refusal:
        preset_named(name)
    assert hint in refusal.value.hint
