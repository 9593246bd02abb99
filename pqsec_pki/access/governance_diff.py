"""What a change of governance makes stronger and weaker."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, TypeAlias

from pqsec_pki.access._domains import domains_said, stretches
from pqsec_pki.access._topics import Universe
from pqsec_pki.access.change import Change, Difference, Sense
from pqsec_pki.documents import (
    DomainRange,
    DomainRule,
    Governance,
    ProtectionKind,
    TopicRule,
)

Means: TypeAlias = tuple[frozenset[str], str]
"""What a setting gives, and the words for it: of two settings, more gives is stronger."""

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
    """A setting: what it is about, and what its values mean."""

    about: str
    setting: str
    means: dict[object, Means]

    def of(self, rule: DomainRule | TopicRule) -> Means:
        return self.means[getattr(rule, self.setting)]


_STRANGERS: dict[object, Means] = {
    True: (frozenset(), "may take part in what is not protected"),
    False: (frozenset({"on"}), "are shut out"),
}
_DOMAIN = (
    _Aspect("participants without credentials", "allow_unauthenticated_participants", _STRANGERS),
    _Aspect(
        "joining",
        "enable_join_access_control",
        _flag("takes a grant for the domain", "takes a certificate only"),
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
"""Sense and words -> what is governed so -> where."""


def governance_diff(old: Governance, new: Governance) -> Difference:
    """For every domain and topic, what changes in its protection."""
    rules = (*old.domain_rules, *new.domain_rules)
    topics = Universe(
        topic_rule.topic_expression for rule in rules for topic_rule in rule.topic_rules
    )
    found: _Found = {}
    for stretch in stretches(rule.domains for rule in rules):
        one, other = old.rule_for(stretch.first), new.rule_for(stretch.first)
        for sense, text, names in _changes(one, other, topics):
            found.setdefault((sense, text), {}).setdefault(names, []).append(stretch)
    return Difference(tuple(_told(found, topics)), topics.complete, old == new)


_Item: TypeAlias = tuple[Sense, str, frozenset[str]]


def _changes(old: DomainRule | None, new: DomainRule | None, topics: Universe) -> Iterator[_Item]:
    """Sense, words, and the topics; no topics if the domain itself changes."""
    nothing = frozenset[str]()
    if old and new:
        for sense, text in _compared(old, new, _DOMAIN):
            yield sense, text, nothing
        if old.topic_rules != new.topic_rules:
            yield from _topic_changes(old, new, topics)
    elif new:
        yield Sense.GRANTED, "governed, so that participants can join", nothing
    elif old:
        yield Sense.TAKEN, "no longer governed: nobody can join", nothing


def _topic_changes(old: DomainRule, new: DomainRule, topics: Universe) -> Iterator[_Item]:
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
        yield Sense.TAKEN, "no longer governed: nobody can use it"


def _compared(
    old: DomainRule | TopicRule, new: DomainRule | TopicRule, aspects: tuple[_Aspect, ...]
) -> Iterator[tuple[Sense, str]]:
    for aspect in aspects:
        (had, before), (has, after) = aspect.of(old), aspect.of(new)
        if had != has:
            sense = Sense.STRONGER if had < has else Sense.WEAKER if has < had else Sense.OTHER
            yield sense, f"{aspect.about}: {after}, before: {before}"


def _governing(domain: DomainRule, topics: Universe) -> dict[str, TopicRule]:
    """The rule for each name that has one: the first that covers it."""
    found: dict[str, TopicRule] = {}
    left = set(topics.names)
    for rule in domain.topic_rules:
        covered = left & topics.covered[rule.topic_expression]
        found |= dict.fromkeys(covered, rule)
        left -= covered
    return found


def _told(found: _Found, topics: Universe) -> Iterator[Change]:
    for (sense, text), places in found.items():
        for names, domains in places.items():
            where = domains_said(domains)
            what = topics.described(names)
            about = f"{where}, {'; '.join(map(str, what))}" if what else where
            yield Change(sense=sense, text=f"{about}: {text}", topics=what, domains=where)
