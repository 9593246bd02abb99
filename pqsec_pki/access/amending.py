"""Adds rights to a grant and removes them; what it says about other topics stays.

The rules of a grant are in an order, and the first that matches decides (DDS-Security 1.1,
9.4.1.3.2). So a right can be added only if no deny rule comes first, and a topic is removed only
if no other rule still allows it: otherwise nothing is changed, and the error names the rule.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from shlex import quote

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


def granted_topics(grant: Grant, action: Action, topic: str | None = None) -> list[str]:
    """The topics and patterns that it allows for the action: all, or those that meet `topic`."""
    granted = [each for rule in grant.rules if rule.allow for each in _topics(rule, action)]
    return [each for each in granted if topic is None or meets(topic, [each], Budget())]


def add_rights(grant: Grant, rights: TopicRights, domains: DomainSet) -> Grant:
    """The grant with these rights on these domains; what it allows already is not added again.

    UsageError if a deny rule is for one of them, and for an empty topic.
    """
    rules = _rules_to_extend(grant)
    for action, topic in rights:
        _add(rules, grant, action, Criteria(topics=(topic,)), domains)
    return replace(grant, rules=tuple(rules))


def add_grant(grant: Grant, more: Grant) -> Grant:
    """The grant with all that `more` allows, with its partitions and data tags, on its domains.

    UsageError as in `add_rights`, and if `more` denies anything or allows by default: what it
    allows then depends on the order of its rules.
    """
    if _denies_everything(more):
        return grant
    if more.default is DefaultAction.ALLOW or not all(rule.allow for rule in more.rules):
        raise UsageError(f"the grant for {more.name} denies, or allows by default", hint=_HINT)
    rules = _rules_to_extend(grant)
    for rule in more.rules:
        for action in (Action.PUBLISH, Action.SUBSCRIBE, Action.RELAY):
            for criteria in _criteria(rule, action):
                for topic in criteria.topics:
                    one = replace(criteria, topics=(topic,))
                    _add(rules, grant, action, one, rule.domains)
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
                all_of_it = " ".join(f"--{action} {quote(each)}" for each in (*left, topic))
                raise UsageError(
                    f"{grant.name} may still {action} {topic}: {_at(rule)} allows"
                    f" {', '.join(left)}",
                    hint=f"`pqsec permit {quote(grant.name)} --remove {all_of_it}` removes that"
                    f" too, then add what stays; or {_HINT}",
                )
        if grant.default is DefaultAction.ALLOW:
            raise UsageError(
                f"{grant.name} may still {action} {topic}: its grant allows by default", hint=_HINT
            )
    if kept or not grant.rules:
        return replace(grant, rules=kept)
    everywhere = allowed_domains(grant) or grant.rules[0].domains
    return replace(grant, rules=(PermissionRule.deny_all(everywhere),))


def _rules_to_extend(grant: Grant) -> list[PermissionRule]:
    return [] if _denies_everything(grant) else list(grant.rules)


def _add(
    rules: list[PermissionRule], grant: Grant, action: Action, one: Criteria, domains: DomainSet
) -> None:
    """Add the criteria, of one topic, to the rules of the grant, unless they allow it already."""
    [topic] = one.topics
    if not topic:
        raise UsageError("a topic name is empty, which crashes Cyclone DDS")
    decided = _first(rules, action, one, domains)
    if decided and not decided.allow:
        raise UsageError(
            f"{grant.name} may not {action} {topic}: {_at(decided)} denies it", hint=_HINT
        )
    if decided is None:
        _extend(rules, action, one, domains)


def _first(
    rules: Iterable[PermissionRule], action: Action, one: Criteria, domains: DomainSet
) -> PermissionRule | None:
    """The rule that decides on all of these domains; None if none does, or only on some."""
    [topic] = one.topics
    wanted = set(domains.ids())
    for rule in rules:
        here = wanted & set(rule.domains.ids())
        if rule.allow and here == wanted and within(topic, _alike(rule, action, one), Budget()):
            return rule
        if not rule.allow and here and meets(topic, _topics(rule, action), Budget()):
            return rule
    return None


def _extend(rules: list[PermissionRule], action: Action, one: Criteria, domains: DomainSet) -> None:
    """Add the criteria to the allow rule of these domains, or to a new rule at the end."""
    for number, rule in enumerate(rules):
        if rule.allow and rule.domains == domains:
            rules[number] = _with(rule, action, one)
            return
    rules.append(_with(PermissionRule(allow=True, domains=domains), action, one))


def _with(rule: PermissionRule, action: Action, one: Criteria) -> PermissionRule:
    criteria = list(_criteria(rule, action))
    for number, each in enumerate(criteria):
        if _limits(each) == _limits(one):
            criteria[number] = replace(each, topics=(*each.topics, *one.topics))
            return _replaced(rule, action, criteria)
    return _replaced(rule, action, [*criteria, replace(one, line=None)])


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
    if action is Action.SUBSCRIBE:
        return replace(rule, subscribe=tuple(criteria))
    return replace(rule, relay=tuple(criteria))


def _criteria(rule: PermissionRule, action: Action) -> tuple[Criteria, ...]:
    if action is Action.PUBLISH:
        return rule.publish
    return rule.subscribe if action is Action.SUBSCRIBE else rule.relay


def _topics(rule: PermissionRule, action: Action) -> list[str]:
    return [topic for each in _criteria(rule, action) for topic in each.topics]


def _alike(rule: PermissionRule, action: Action, one: Criteria) -> list[str]:
    """Topics of the criteria that have the partitions and data tags of `one`."""
    alike = [each for each in _criteria(rule, action) if _limits(each) == _limits(one)]
    return [topic for each in alike for topic in each.topics]


def _limits(criteria: Criteria) -> tuple[frozenset[str], frozenset[tuple[str, str]]]:
    """The partitions and data tags, of which the order has no meaning."""
    return frozenset(criteria.partitions), frozenset(criteria.data_tags)


def _denies_everything(grant: Grant) -> bool:
    """Whether it is that of a participant without topics (`Grant.least`)."""
    rules = tuple(PermissionRule.deny_all(rule.domains) for rule in grant.rules[:1])
    return grant.rules == rules and grant.default is DefaultAction.DENY


def _at(rule: PermissionRule) -> str:
    where = "" if rule.line is None else f" on line {rule.line}"
    return f"the {'allow' if rule.allow else 'deny'} rule{where}"
