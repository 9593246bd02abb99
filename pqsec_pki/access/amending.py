"""Adds rights to a grant and removes them; what it says about other topics stays.

The rules of a grant are in an order, and the first that matches decides (DDS-Security 1.1,
9.4.1.3.2). So a right can be added only if no deny rule comes first, and a topic is removed only
if no other rule still allows it: otherwise nothing is changed, and the error names the rule.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access._expressions import Budget, meets, within
from pqsec_pki.access.question import Action
from pqsec_pki.documents import Criteria, DefaultAction, DomainSet, Grant, PermissionRule
from pqsec_pki.errors import UsageError

_HINT = "edit its permissions.xml, and sign it with `pqsec sign-permissions`"


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicRights:
    """Topics to publish and to subscribe to, as expressions of DDS (`rt/chatter`, `rt/*`)."""

    publish: tuple[str, ...] = ()
    subscribe: tuple[str, ...] = ()

    def __iter__(self) -> Iterator[tuple[Action, str]]:
        yield from ((Action.PUBLISH, topic) for topic in self.publish)
        yield from ((Action.SUBSCRIBE, topic) for topic in self.subscribe)


def allowed_domains(grant: Grant) -> DomainSet | None:
    """The domains of its first allow rule; None if it has none."""
    return next((rule.domains for rule in grant.rules if rule.allow), None)


def add_rights(grant: Grant, rights: TopicRights, domains: DomainSet) -> Grant:
    """The grant with these rights on these domains; what it allows already is not added again.

    UsageError if a deny rule is for one of them, and for an empty topic.
    """
    if "" in rights.publish + rights.subscribe:
        raise UsageError("a topic name is empty, which crashes Cyclone DDS")
    rules = [] if _denies_everything(grant) else list(grant.rules)
    for action, topic in rights:
        decided = _first(rules, action, topic, domains)
        if decided and not decided.allow:
            raise UsageError(
                f"{grant.name} may not {action} {topic}: {_at(decided)} denies it", hint=_HINT
            )
        if decided is None:
            _add(rules, action, topic, domains)
    return replace(grant, rules=tuple(rules))


def remove_rights(grant: Grant, rights: TopicRights) -> Grant:
    """The grant without these rights, on all domains.

    UsageError if it still allows one of them: by a pattern, or by default.
    """
    rules = [_without(rule, rights) for rule in grant.rules]
    kept = tuple(rule for rule in rules if rule.publish or rule.subscribe or rule.relay)
    for action, topic in rights:
        for rule in (each for each in kept if each.allow):
            left = [each for each in _topics(rule, action) if meets(topic, [each], Budget())]
            if left:
                raise UsageError(
                    f"{grant.name} may still {action} {topic}: {_at(rule)} allows"
                    f" {', '.join(left)}",
                    hint=f"remove that too, and add what stays; or {_HINT}",
                )
        if grant.default is DefaultAction.ALLOW:
            raise UsageError(
                f"{grant.name} may still {action} {topic}: its grant allows by default", hint=_HINT
            )
    if kept or not grant.rules:
        return replace(grant, rules=kept)
    everywhere = allowed_domains(grant) or grant.rules[0].domains
    return replace(grant, rules=(PermissionRule.deny_all(everywhere),))


def _first(
    rules: Iterable[PermissionRule], action: Action, topic: str, domains: DomainSet
) -> PermissionRule | None:
    """The rule that decides on all of these domains; None if none does, or only on some."""
    wanted = set(domains.ids())
    for rule in rules:
        here = wanted & set(rule.domains.ids())
        if rule.allow and here == wanted and within(topic, _plain(rule, action), Budget()):
            return rule
        if not rule.allow and here and meets(topic, _topics(rule, action), Budget()):
            return rule
    return None


def _add(rules: list[PermissionRule], action: Action, topic: str, domains: DomainSet) -> None:
    """Add the topic to the allow rule of these domains, or to a new rule at the end."""
    for number, rule in enumerate(rules):
        if rule.allow and rule.domains == domains:
            rules[number] = _with(rule, action, topic)
            return
    rules.append(_with(PermissionRule(allow=True, domains=domains), action, topic))


def _with(rule: PermissionRule, action: Action, topic: str) -> PermissionRule:
    criteria = list(_criteria(rule, action))
    for number, each in enumerate(criteria):
        if _is_plain(each):
            criteria[number] = replace(each, topics=(*each.topics, topic))
            return _replaced(rule, action, criteria)
    return _replaced(rule, action, [*criteria, Criteria(topics=(topic,))])


def _without(rule: PermissionRule, rights: TopicRights) -> PermissionRule:
    if not rule.allow:
        return rule
    for action, topic in rights:
        left = [
            replace(each, topics=topics)
            for each in _criteria(rule, action)
            if (topics := tuple(name for name in each.topics if name != topic))
        ]
        rule = _replaced(rule, action, left)
    return rule


def _replaced(rule: PermissionRule, action: Action, criteria: Iterable[Criteria]) -> PermissionRule:
    if action is Action.PUBLISH:
        return replace(rule, publish=tuple(criteria))
    return replace(rule, subscribe=tuple(criteria))


def _criteria(rule: PermissionRule, action: Action) -> tuple[Criteria, ...]:
    return rule.publish if action is Action.PUBLISH else rule.subscribe


def _topics(rule: PermissionRule, action: Action) -> list[str]:
    return [topic for each in _criteria(rule, action) for topic in each.topics]


def _plain(rule: PermissionRule, action: Action) -> list[str]:
    """Its topics that are not limited to partitions or data tags."""
    plain = [each for each in _criteria(rule, action) if _is_plain(each)]
    return [topic for each in plain for topic in each.topics]


def _is_plain(criteria: Criteria) -> bool:
    return not criteria.partitions and not criteria.data_tags


def _denies_everything(grant: Grant) -> bool:
    """Whether it is that of a participant without topics (`Grant.least`)."""
    rules = tuple(PermissionRule.deny_all(rule.domains) for rule in grant.rules[:1])
    return grant.rules == rules and grant.default is DefaultAction.DENY


def _at(rule: PermissionRule) -> str:
    where = "" if rule.line is None else f" on line {rule.line}"
    return f"the {'allow' if rule.allow else 'deny'} rule{where}"
