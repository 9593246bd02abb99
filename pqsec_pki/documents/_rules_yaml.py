"""Reads and writes rules of permissions and their criteria in YAML.

Topics are a list of DDS names and patterns. An item with partitions or data tags is a
mapping: {topics: [rt/map], partitions: [floor1], data_tags: {colour: red}}.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeAlias

from pqsec_pki.documents._domains_yaml import domains, domains_as_yaml
from pqsec_pki.documents._nodes_yaml import node
from pqsec_pki.documents._yaml import Item, Items, YamlMapping, refused
from pqsec_pki.documents._yaml_reading import (
    all_of,
    build,
    each,
    fields,
    one_or_more,
    table,
    text,
)
from pqsec_pki.documents.domains import DomainSet
from pqsec_pki.documents.permissions import Criteria, PermissionRule
from pqsec_pki.documents.ros import Endpoints

Readers: TypeAlias = dict[str, Callable[[Item], Any]]

_ACTIONS = ("publish", "subscribe", "relay")


def rule(default_domains: DomainSet, item: Item) -> PermissionRule:
    """One item of `rules`: either `allow:` or `deny:`."""
    either: Readers = {
        "allow": partial(fields, readers={"domains": domains, **ALLOWED}),
        "deny": partial(fields, readers={"domains": domains, **_DENIED}),
    }
    effects = fields(item, either)
    if len(effects) != 1:
        raise refused(item, "each item of `rules` has either `allow:` or `deny:`, not both")
    [(effect, values)] = effects.items()
    domain_set = values.pop("domains", default_domains)
    return built_rule(item, domain_set, values, allow=effect == "allow")


def built_rule(
    item: Item, domain_set: DomainSet, values: dict[str, Any], *, allow: bool
) -> PermissionRule:
    """The rule; the topics of its nodes are added to those that it publishes and subscribes to."""
    nodes: tuple[Endpoints, ...] = values.pop("nodes", ())
    for action in ("publish", "subscribe"):
        of_nodes = [topic for node in nodes for topic in getattr(node, action)]
        if of_nodes:
            values[action] = _with_topics(values.get(action, ()), of_nodes, item.line)
    return build(item, PermissionRule, allow=allow, domains=domain_set, **values, line=item.line)


def _with_topics(
    criteria: tuple[Criteria, ...], topics: list[str], line: int
) -> tuple[Criteria, ...]:
    """`criteria` with `topics`, which are added to the criteria that have only topics."""
    plain = [each for each in criteria if not each.partitions and not each.data_tags][:1]
    others = tuple(each for each in criteria if each not in plain)
    own = [topic for each in plain for topic in each.topics]
    return (Criteria(topics=tuple(dict.fromkeys([*own, *topics])), line=line), *others)


def _all_criteria(item: Item) -> tuple[Criteria, ...]:
    """One Criteria for all plain topics of the list, and one for each mapping in it."""
    items = item.items if isinstance(item, Items) else [item]
    plain = [each for each in items if not isinstance(each, YamlMapping)]
    rest = [partial(_criteria, each) for each in items if isinstance(each, YamlMapping)]
    if not plain:
        return all_of(rest)
    return all_of([partial(_plain_criteria, plain), *rest])


def _plain_criteria(items: Sequence[Item]) -> Criteria:
    topics = all_of(partial(text, each) for each in items)
    return Criteria(topics=topics, line=items[0].line)


def _criteria(item: Item) -> Criteria:
    names = partial(one_or_more, reader=text)
    values = fields(
        item,
        {"topics": names, "partitions": names, "data_tags": _data_tags},
        required=("topics",),
    )
    return build(item, Criteria, **values, line=item.line)


def _data_tags(item: Item) -> tuple[tuple[str, str], ...]:
    """`{name: value}`, or a list of these if a name occurs twice."""
    if isinstance(item, Items):
        return tuple(pair for pairs in each(item, _data_tags) for pair in pairs)
    pairs = table(item).entries.values()
    return all_of(partial(_data_tag, name, value) for name, value in pairs)


def _data_tag(name: Item, value: Item) -> tuple[str, str]:
    return text(name), text(value)


_DENIED: Readers = dict.fromkeys(_ACTIONS, _all_criteria)
ALLOWED: Readers = _DENIED | {"nodes": partial(one_or_more, reader=node)}
"""Key -> reader, for the keys of an allow rule besides its domains."""


# Writing


def rules_as_yaml(
    rules: tuple[PermissionRule, ...], default_domains: DomainSet | None = None
) -> dict[str, object]:
    """The keys of a grant or role for its rules, in the short form if it is one allow rule.

    Domains that are `default_domains` are left out.
    """
    match rules:
        case [PermissionRule(allow=True) as only] if only.publish or only.subscribe or only.relay:
            return _rule_as_yaml(only, default_domains)
    effects = [
        ("allow" if each.allow else "deny", _rule_as_yaml(each, default_domains)) for each in rules
    ]
    return {"rules": [dict([effect]) for effect in effects]}


def _rule_as_yaml(rule: PermissionRule, default_domains: DomainSet | None) -> dict[str, object]:
    """The mapping under its `allow:` or `deny:`."""
    written: dict[str, object] = {}
    if rule.domains != default_domains:
        written["domains"] = domains_as_yaml(rule.domains)
    for action in _ACTIONS:
        if criteria := getattr(rule, action):
            written[action] = _all_criteria_as_yaml(criteria)
    return written


def _all_criteria_as_yaml(criteria: tuple[Criteria, ...]) -> list[object]:
    match criteria:
        case [Criteria(partitions=(), data_tags=()) as only]:
            return list(only.topics)
    return [_criteria_as_yaml(each) for each in criteria]


def _criteria_as_yaml(criteria: Criteria) -> dict[str, object]:
    written: dict[str, object] = {"topics": list(criteria.topics)}
    if criteria.partitions:
        written["partitions"] = list(criteria.partitions)
    if criteria.data_tags:
        once = dict(criteria.data_tags)
        unique = len(once) == len(criteria.data_tags)
        written["data_tags"] = once if unique else [{n: v} for n, v in criteria.data_tags]
    return written
