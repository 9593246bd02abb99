"""The protection that a change of governance makes stronger and weaker."""

from collections.abc import Iterator
from typing import Any, TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access._domains import domains_said, stretches
from pqsec_pki.access._topics import SampleNames
from pqsec_pki.access.change import Change, Difference, Sense
from pqsec_pki.documents import (
    DomainRange,
    DomainRule,
    Governance,
    ProtectionKind,
    TopicRule,
)

Means: TypeAlias = tuple[frozenset[str], str]
"""The protections of a setting, and its text. A setting with more protections is stronger."""

_KINDS: dict[object, Means] = {
    ProtectionKind.NONE: (frozenset(), "in the clear"),
    ProtectionKind.SIGN: (frozenset({"signed"}), "signed"),
    ProtectionKind.ENCRYPT: (frozenset({"signed", "secret"}), "encrypted"),
    ProtectionKind.SIGN_WITH_ORIGIN_AUTHENTICATION: (
        frozenset({"signed", "origin"}),
        "signed by its origin",
    ),
    ProtectionKind.ENCRYPT_WITH_ORIGIN_AUTHENTICATION: (
        frozenset({"signed", "origin", "secret"}),
        "encrypted and signed by its origin",
    ),
}


def _flag(on: str, off: str) -> dict[object, Means]:
    return {True: (frozenset({"on"}), on), False: (frozenset(), off)}


_GRANT = _flag("those with a grant for it", "every participant that has joined")
_PROTECTED = _flag("protected as the domain says", "in the clear")


@dataclass(frozen=True, slots=True)
class _Aspect:
    """A setting, with what it concerns and the meaning of each value."""

    about: str
    setting: str
    means: dict[object, Means]

    def of(self, rule: DomainRule | TopicRule) -> Means:
        return self.means[getattr(rule, self.setting)]


_UNAUTHENTICATED: dict[object, Means] = {
    True: (frozenset(), "may use what is not protected"),
    False: (frozenset({"on"}), "may not take part"),
}
_DOMAIN = (
    _Aspect(
        "participants without credentials", "allow_unauthenticated_participants", _UNAUTHENTICATED
    ),
    _Aspect(
        "joining",
        "enable_join_access_control",
        _flag("needs a grant for the domain", "needs only a certificate"),
    ),
    _Aspect("discovery", "discovery_protection_kind", _KINDS),
    _Aspect("liveliness", "liveliness_protection_kind", _KINDS),
    _Aspect("whole messages", "rtps_protection_kind", _KINDS),
)
_TOPIC = (
    _Aspect("who may publish", "enable_write_access_control", _GRANT),
    _Aspect("who may subscribe", "enable_read_access_control", _GRANT),
    _Aspect("payload", "data_protection_kind", _KINDS),
    _Aspect("submessages", "metadata_protection_kind", _KINDS),
    _Aspect("discovery", "enable_discovery_protection", _PROTECTED),
    _Aspect("liveliness", "enable_liveliness_protection", _PROTECTED),
)

_Found: TypeAlias = dict[tuple[Sense, str], dict[Any, list[DomainRange]]]
"""(sense, text) -> topics, empty for the domain itself -> domains."""


def governance_diff(old: Governance, new: Governance) -> Difference:
    """The changes of protection for every domain and topic."""
    rules = (*old.domain_rules, *new.domain_rules)
    topics = SampleNames(
        topic_rule.topic_expression for rule in rules for topic_rule in rule.topic_rules
    )
    found: _Found = {}
    for stretch in stretches(rule.domains for rule in rules):
        one, other = old.rule_for(stretch.first), new.rule_for(stretch.first)
        for sense, text, names in _changes(one, other, topics):
            found.setdefault((sense, text), {}).setdefault(names, []).append(stretch)
    return Difference(tuple(_as_changes(found, topics)), topics.complete, old == new)


_Item: TypeAlias = tuple[Sense, str, frozenset[str]]


def _changes(
    old: DomainRule | None, new: DomainRule | None, topics: SampleNames
) -> Iterator[_Item]:
    """(sense, text, topics) of each change; no topics if the domain itself changes."""
    nothing = frozenset[str]()
    if old and new:
        for sense, text in _compared(old, new, _DOMAIN):
            yield sense, text, nothing
        if old.topic_rules != new.topic_rules:
            yield from _topic_changes(old, new, topics)
    elif new:
        yield Sense.GRANTED, "governed, so that participants can join", nothing
    elif old:
        yield Sense.TAKEN, "no longer governed: no participant can join", nothing


def _topic_changes(old: DomainRule, new: DomainRule, topics: SampleNames) -> Iterator[_Item]:
    found: dict[tuple[Sense, str], set[str]] = {}
    before, after = _governing(old, topics), _governing(new, topics)
    for name in topics.names:
        for change in _of_topic(before.get(name), after.get(name)):
            found.setdefault(change, set()).add(name)
    for (sense, text), names in found.items():
        yield sense, text, frozenset(names)


def _of_topic(old: TopicRule | None, new: TopicRule | None) -> Iterator[tuple[Sense, str]]:
    if old and new:
        yield from _compared(old, new, _TOPIC)
    elif new:
        yield Sense.GRANTED, "governed, so that it can be used"
    elif old:
        yield Sense.TAKEN, "no longer governed: no participant can use it"


def _compared(
    old: DomainRule | TopicRule, new: DomainRule | TopicRule, aspects: tuple[_Aspect, ...]
) -> Iterator[tuple[Sense, str]]:
    for aspect in aspects:
        (had, before), (has, after) = aspect.of(old), aspect.of(new)
        if had != has:
            sense = Sense.STRONGER if had < has else Sense.WEAKER if has < had else Sense.OTHER
            yield sense, f"{aspect.about}: {after}, before: {before}"


def _governing(domain: DomainRule, topics: SampleNames) -> dict[str, TopicRule]:
    """For each name the first rule that covers it, if there is one."""
    found: dict[str, TopicRule] = {}
    left = set(topics.names)
    for rule in domain.topic_rules:
        covered = left & topics.covered[rule.topic_expression]
        found |= dict.fromkeys(covered, rule)
        left -= covered
    return found


def _as_changes(found: _Found, topics: SampleNames) -> Iterator[Change]:
    for (sense, text), places in found.items():
        for names, domains in places.items():
            where = domains_said(domains)
            what = topics.described(names)
            about = f"{where}, {'; '.join(map(str, what))}" if what else where
            yield Change(sense=sense, text=f"{about}: {text}", topics=what, domains=where)
