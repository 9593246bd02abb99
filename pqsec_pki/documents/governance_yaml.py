"""Governance in YAML, for people to write, with a preset for all settings that are not given.

    preset: strict
    domains: 0-3
    topics:
      - ros_topic: /camera/image
        data_protection_kind: NONE
      - "*"

The keys are those of DDS-Security 1.1, 9.4.1.2. If domains differ, a list under `rules` has such a
rule for each.
"""

from collections.abc import Callable, Mapping
from dataclasses import fields as dataclass_fields
from functools import partial
from string import Template
from typing import Any, TypeAlias

from pqsec_pki._assets import asset
from pqsec_pki.documents import ros
from pqsec_pki.documents._domains_yaml import domains, domains_as_yaml
from pqsec_pki.documents._yaml import Item, Text, dump, refused
from pqsec_pki.documents._yaml_reading import (
    boolean,
    build,
    chosen,
    each,
    fields,
    one_of,
    one_or_more,
    peeked,
    read,
    table,
    text,
)
from pqsec_pki.documents.domains import DomainSet
from pqsec_pki.documents.governance import DomainRule, Governance, ProtectionKind, TopicRule
from pqsec_pki.documents.presets import PRESETS, STRICT, Preset, preset_named

_Readers: TypeAlias = dict[str, Callable[[Item], Any]]

_DOMAIN_0 = DomainSet.of(0)
_kind = partial(one_of, ProtectionKind)
_DOMAIN_KEYS: _Readers = {
    "allow_unauthenticated_participants": boolean,
    "enable_join_access_control": boolean,
    "discovery_protection_kind": _kind,
    "liveliness_protection_kind": _kind,
    "rtps_protection_kind": _kind,
}
_TOPIC_KEYS: _Readers = {
    "enable_discovery_protection": boolean,
    "enable_liveliness_protection": boolean,
    "enable_read_access_control": boolean,
    "enable_write_access_control": boolean,
    "metadata_protection_kind": _kind,
    "data_protection_kind": _kind,
}
_NAMES: Mapping[str, Callable[[str], tuple[str, ...]]] = {
    "topic": lambda name: (name,),
    "ros_topic": lambda name: (ros.topic(name),),
    "ros_service": ros.service_topics,
    "ros_action": ros.action_topics,
}
"""Key -> function: name to topic expressions. Each topic rule has one of these keys."""


def governance_from_yaml(data: bytes) -> Governance:
    """The governance in the YAML document; InvalidDocumentError lists everything that is wrong."""
    return read(data, governance_in)


def governance_to_yaml(value: Governance) -> bytes:
    """The complete document that `governance_from_yaml` reads as `value`."""
    return dump(governance_as_yaml(value))


def new_governance(preset: Preset, domains: DomainSet) -> bytes:
    """A commented document with all settings of the preset, for people to edit."""
    settings = {
        key: str(getattr(row, key)).lower() if reader is boolean else str(getattr(row, key))
        for row, keys in ((preset.rule, _DOMAIN_KEYS), (preset.topic_rule, _TOPIC_KEYS))
        for key, reader in keys.items()
    }
    template = Template(asset("templates", "governance.yaml").read_text("utf-8"))
    about = {"preset": preset.name, "summary": preset.summary, "domains": str(domains)}
    return template.substitute(settings, **about).encode()


# Reading


def governance_in(item: Item, default_domains: DomainSet = _DOMAIN_0) -> Governance:
    """The governance in the item; for `default_domains` if it names no domains."""
    if "rules" not in table(item).entries:
        return Governance(domain_rules=(_rule(STRICT, item, default_domains),))
    preset = peeked(item, "preset", _preset, STRICT)
    readers: _Readers = {
        "preset": _preset,
        "rules": partial(each, reader=partial(_rule, preset)),
    }
    rules = fields(item, readers)["rules"]
    return build(item, Governance, domain_rules=rules)


def _preset(item: Item) -> Preset:
    return preset_named(chosen(item, [preset.name for preset in PRESETS]))


def _rule(preset: Preset, item: Item, domain_set: DomainSet | None = None) -> DomainRule:
    preset = peeked(item, "preset", _preset, preset)
    given = fields(
        item,
        {
            "preset": _preset,
            "domains": domains,
            **_DOMAIN_KEYS,
            "topics": partial(_topic_rules, preset),
        },
        required=() if domain_set else ("domains",),
    )
    given.pop("preset", None)
    values = {key: getattr(preset.rule, key) for key in _DOMAIN_KEYS}
    values |= {"domains": domain_set, "topic_rules": given.pop("topics", preset.rule.topic_rules)}
    return build(item, DomainRule, **(values | given), line=item.line)


def _topic_rules(preset: Preset, item: Item) -> tuple[TopicRule, ...]:
    found = one_or_more(item, partial(_topic_rule, preset))
    return tuple(rule for rules in found for rule in rules)


def _topic_rule(preset: Preset, item: Item) -> tuple[TopicRule, ...]:
    """The rules of one entry: a ROS service has two topics, an action more."""
    values = {key: getattr(preset.topic_rule, key) for key in _TOPIC_KEYS}
    if isinstance(item, Text):
        expressions: tuple[str, ...] = (text(item),)
    else:
        readers: _Readers = {key: partial(_named, key) for key in _NAMES}
        given = fields(item, readers | _TOPIC_KEYS)
        names = [given.pop(key) for key in _NAMES if key in given]
        if len(names) != 1:
            raise refused(item, f"a topic rule has one of the keys {', '.join(_NAMES)}")
        [expressions] = names
        values |= given
    return tuple(
        build(item, TopicRule, topic_expression=each, **values, line=item.line)
        for each in expressions
    )


def _named(key: str, item: Item) -> tuple[str, ...]:
    name = text(item)
    return build(item, lambda: _NAMES[key](name))


# Writing


def governance_as_yaml(value: Governance) -> dict[str, object]:
    """The mapping that `governance_in` reads as `value`."""
    return {"rules": [_rule_as_yaml(rule) for rule in value.domain_rules]}


def _rule_as_yaml(rule: DomainRule) -> dict[str, object]:
    return {
        "domains": domains_as_yaml(rule.domains),
        **{key: _plain(getattr(rule, key)) for key in _DOMAIN_KEYS},
        "topics": [_topic_as_yaml(topic) for topic in rule.topic_rules],
    }


def _topic_as_yaml(rule: TopicRule) -> dict[str, object]:
    names = [field.name for field in dataclass_fields(rule) if field.name in _TOPIC_KEYS]
    settings = {name: _plain(getattr(rule, name)) for name in names}
    return {"topic": rule.topic_expression, **settings}


def _plain(value: bool | ProtectionKind) -> bool | str:  # noqa: FBT001 - a value, not a choice
    return value.value if isinstance(value, ProtectionKind) else value
