"""Everything that some grants allow their subject, as `decide` answers."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from itertools import product
from typing import Any, TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access._checks import met
from pqsec_pki.access._criteria import named_partitions
from pqsec_pki.access._domains import domains_said, stretches
from pqsec_pki.access._endpoints import Sets, sets_to_try
from pqsec_pki.access._topics import SampleNames
from pqsec_pki.access.deciding import InterpretedPolicy
from pqsec_pki.access.interpretation import EvaluationContext
from pqsec_pki.access.interpretations import SPEC
from pqsec_pki.access.question import Action, Question
from pqsec_pki.documents import (
    Criteria,
    DefaultAction,
    DomainRange,
    DomainSet,
    Governance,
    Grant,
    PermissionRule,
    Permissions,
)

_NAMED = replace(SPEC, partitions_met=named_partitions)
"""The standard, but the partitions of an endpoint are names. An expression matches a set of names,
so grants that agree on all sets of names also agree on expressions."""
_ALL = Governance.protected(DomainSet(parts=(DomainRange(first=0),)))
_BEGIN, _THEN, _END = (datetime(year, 1, 1, tzinfo=UTC) for year in (2000, 2001, 2002))
_ACTIONS = (Action.PUBLISH, Action.SUBSCRIBE, Action.RELAY)
_ANY = "any topic"
_DEFAULT = ("",)
_OTHER_TAG = ("a tag that no rule names", "")

_Partitions: TypeAlias = tuple[str, ...]
_Tag: TypeAlias = tuple[str, str]
_Tags: TypeAlias = tuple[_Tag, ...]
Right: TypeAlias = tuple[Action, DomainRange, _Partitions, _Tags]
"""An action, on these domains, with an endpoint in these partitions with these tags."""
Rights: TypeAlias = dict[Right, frozenset[str]]
"""The topics for each right; joining needs no topic and has an empty name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Whole:
    """Several rights as one: all these actions, with all these topics, in all these places."""

    actions: tuple[Action, ...]
    domains: tuple[DomainRange, ...]
    partitions: tuple[_Partitions, ...]
    tags: tuple[_Tags, ...]
    names: frozenset[str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Dimensions:
    """The topics, domains, partitions and tags that some grants distinguish."""

    topics: SampleNames
    domains: tuple[DomainRange, ...]
    partitions: SampleNames
    partition_sets: Sets[str]
    tag_sets: Sets[_Tag]

    @classmethod
    def of(cls, grants: Iterable[Grant]) -> "Dimensions":
        """The dimensions that these grants distinguish."""
        grants = tuple(grants)
        rules = [rule for grant in grants for rule in grant.rules]
        criteria = list(_criteria(rules))
        named = (name for each in criteria for name in each.partitions)
        partitions = SampleNames(named, "partition", also=_DEFAULT)
        return cls(
            topics=SampleNames(topic for each in criteria for topic in each.topics),
            domains=stretches(rule.domains for rule in rules),
            partitions=partitions,
            partition_sets=_partition_sets(partitions, grants),
            tag_sets=_tag_sets(grants),
        )

    @property
    def complete(self) -> bool:
        """Whether two grants that agree on all of these agree on everything."""
        parts = (self.topics, self.partitions, self.partition_sets, self.tag_sets)
        return all(part.complete for part in parts)

    def rights(self, grant: Grant | None) -> Rights:
        """What a grant allows while it is valid, if governance controls everything."""
        found: Rights = {}
        if grant:
            always = replace(grant, not_before=_BEGIN, not_after=_END)
            policy = InterpretedPolicy(_ALL, Permissions(grants=(always,)))
            for stretch in self.domains:
                found |= self._on(policy, grant, stretch)
        return found

    def _on(self, policy: InterpretedPolicy, grant: Grant, stretch: DomainRange) -> Rights:
        subject, domain = grant.subject_name, stretch.first
        here = tuple(rule for rule in grant.rules if domain in rule.domains)
        join = Question(subject=subject, domain=domain, action=Action.JOIN, now=_THEN)
        if not policy.decide(join).allowed:
            return {}  # a participant that cannot join can do nothing
        found: Rights = {(Action.JOIN, stretch, _DEFAULT, ()): frozenset({""})}
        for action, partitions, tags in product(
            _ACTIONS, self.partition_sets.tried, self.tag_sets.tried
        ):
            asked = replace(join, action=action, topic=_ANY, partitions=partitions, data_tags=tags)
            context = EvaluationContext(
                question=asked,
                interpretation=_NAMED,
                domain_rules=(),
                grant=replace(grant, rules=here),
            )
            found[action, stretch, partitions, tags] = self._allowed(context)
        return found

    def _allowed(self, context: EvaluationContext) -> frozenset[str]:
        """The topics that the check `by_rules` allows, decided for all topics at once."""
        allowed, undecided = set[str](), set(self.topics.names)
        for rule in context.rules:
            for criteria in context.criteria(rule, context.question.action):
                if met(context, criteria, rule):
                    for pattern in criteria.topics:
                        named = undecided & self.topics.covered[pattern]
                        undecided -= named
                        allowed |= named if rule.allow else set()
        return frozenset(
            allowed | undecided if context.grant.default is DefaultAction.ALLOW else allowed
        )

    def where(self, whole: Whole) -> str:
        """Text such as `on domain 0 in partition 'A'`."""
        words = [f"on {domains_said(whole.domains)}"]
        if whole.partitions == self.partition_sets.tried:
            words.append("in any partition")
        elif whole.partitions != (_DEFAULT,):
            words.append(f"in {' or '.join(self._partitions_said(whole.partitions))}")
        if whole.tags == self.tag_sets.tried:
            words.append("whatever its data tags")
        elif whole.tags != ((),):
            words.append(f"with {' or '.join(map(_tags_said, whole.tags))}")
        return " ".join(words)

    def _partitions_said(self, sets: tuple[_Partitions, ...]) -> Iterator[str]:
        """The partitions that are allowed alone, and the largest sets that are allowed together."""
        alone = frozenset(name for each in sets if len(each) == 1 for name in each)
        several = [frozenset(each) for each in sets if len(each) > 1]
        words = " or ".join(map(str, self.partitions.described(alone)))
        if alone:
            yield f"{words}, alone or together" if alone in several else words
        for each in several:
            largest = not any(each < other for other in several)
            if largest and (each < alone or not each & alone):
                yield f"{' and '.join(map(str, self.partitions.described(each)))} together"


def wholes(rights: Rights) -> Iterator[Whole]:
    """The rights, with actions and places merged if they have the same topics."""
    items: list[tuple[Any, ...]] = [(*right, names) for right, names in rights.items() if names]
    for dimension in (1, 2, 3, 0):
        groups: dict[tuple[Any, ...], list[Any]] = {}
        for item in items:
            rest = (*item[:dimension], *item[dimension + 1 :])
            groups.setdefault(rest, []).append(item[dimension])
        items = [
            (*rest[:dimension], tuple(values), *rest[dimension:]) for rest, values in groups.items()
        ]
    for actions, domains, partitions, tags, names in items:
        yield Whole(actions=actions, domains=domains, partitions=partitions, tags=tags, names=names)


def _criteria(rules: Iterable[PermissionRule]) -> Iterator[Criteria]:
    for rule in rules:
        yield from (*rule.publish, *rule.subscribe, *rule.relay)


def _partition_sets(partitions: SampleNames, grants: tuple[Grant, ...]) -> Sets[str]:
    """Partition sets of the criteria; an allow_rule without one is for the default partition."""
    allowed = [
        partitions.covered_by(each.partitions or _DEFAULT) for each in _of_rules(grants, allow=True)
    ]
    if any(grant.default is DefaultAction.ALLOW for grant in grants):
        allowed.append(frozenset(partitions.names))
    denied = (partitions.covered_by(each.partitions) for each in _of_rules(grants, allow=False))
    found = sets_to_try(partitions.names, allowed, filter(None, denied))
    # An endpoint is in at least one partition.
    return replace(found, tried=tuple(filter(None, found.tried)))


def _tag_sets(grants: tuple[Grant, ...]) -> Sets[_Tag]:
    """Tag sets of the criteria, and a tag that is in none of them."""
    allowed = [frozenset(each.data_tags) for each in _of_rules(grants, allow=True)]
    denied = [frozenset(each.data_tags) for each in _of_rules(grants, allow=False)]
    every = tuple(dict.fromkeys([_OTHER_TAG, *sorted(frozenset().union(*allowed, *denied))]))
    if any(grant.default is DefaultAction.ALLOW for grant in grants):
        allowed.append(frozenset(every))
    return sets_to_try(every, allowed, filter(None, denied))


def _of_rules(grants: tuple[Grant, ...], *, allow: bool) -> Iterator[Criteria]:
    for grant in grants:
        yield from _criteria(rule for rule in grant.rules if rule.allow is allow)


def _tags_said(tags: _Tags) -> str:
    if not tags:
        return "no data tags"
    named = ", ".join(f"{name}={value}" for name, value in tags if (name, value) != _OTHER_TAG)
    words = [f"data tags {named}"] if named else []
    return " and ".join(words + [_OTHER_TAG[0]] * (_OTHER_TAG in tags))
