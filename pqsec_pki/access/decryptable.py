"""Which recorded traffic a quantum computer decrypts later, because a stock stack gets its key.

A handshake with a stock stack agrees on its key by ECDH. Under that key a participant sends what
the peer needs to decrypt: the key of a writer to each of its readers, and with encrypted RTPS
messages the participant's own to each other participant (DDS-Security 1.1, 8.5.1.8). A writer has
one key for all its readers. So one stock reader is enough for what all readers get.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from datetime import datetime
from operator import attrgetter
from typing import Any, NamedTuple

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access._domains import domain_set, stretches
from pqsec_pki.access._patterns import posix
from pqsec_pki.access._witnesses import is_wildcard, witnesses
from pqsec_pki.access.deciding import InterpretedPolicy
from pqsec_pki.access.decision import Protection
from pqsec_pki.access.everywhere import Placed, who_may_anywhere
from pqsec_pki.access.interpretations import SPEC
from pqsec_pki.access.matrix import DocumentOwner, topics_named
from pqsec_pki.access.question import Action, Question
from pqsec_pki.documents import DomainRange, DomainSet, Governance


@dataclass(frozen=True, slots=True, kw_only=True)
class Decryptable:
    """Topics whose samples can be decrypted later, for all their readers."""

    senders: tuple[str, ...]
    """Those that may publish, if what they send can be decrypted."""
    receivers: tuple[str, ...]
    """All that may subscribe, also those that are not stock."""
    stock: tuple[str, ...]
    """The stock participants that get the keys; empty if the senders are stock themselves."""
    domains: DomainSet
    where: str
    """The partitions in words; empty for the default partition."""
    topics: tuple[str, ...]
    """Topics, and patterns of which at least some topics are."""

    def to_json(self) -> dict[str, object]:
        """The fields."""
        return {
            "from": list(self.senders),
            "to": list(self.receivers),
            "stock": list(self.stock),
            "domains": str(self.domains),
            "partitions": self.where,
            "topics": list(self.topics),
        }


@dataclass(frozen=True, slots=True)
class DecryptableTopics:
    """All of them. If it is not `complete`, the patterns were too many to look at all topics."""

    rows: tuple[Decryptable, ...] = ()
    complete: bool = True


def decryptable_later(
    governance: Governance,
    members: Sequence[DocumentOwner],
    stock: Collection[str],
    *,
    topics: Iterable[str] = (),
    now: datetime,
) -> DecryptableTopics:
    """What these participants send that can be decrypted later, by the standard.

    `stock` are the names of those that are met with classical keys. A topic is in no row if it is
    not encrypted: that can be read today. Those of `topics` have rows of their own, also if only a
    pattern of the rules covers them.
    """
    there = {each.name for each in members}.intersection(stock)
    if not there:
        return DecryptableTopics()
    rules = (each for rule in governance.domain_rules for each in rule.topic_rules)
    expressions = (each.topic_expression for each in rules)
    known = dict.fromkeys((*topics_named(members), *expressions, *topics))
    names = witnesses(known)
    rights = who_may_anywhere(
        governance, members, names.names, now=now, asked={each: each for each in names.names}
    )
    joining = _Joining(governance, members, now)
    found = [
        one
        for each in rights.rows
        for one in _of_topic(governance, each, frozenset(there), joining)
    ]
    return DecryptableTopics(
        tuple(_together(found, tuple(known))), complete=names.complete and rights.complete
    )


class _One(NamedTuple):
    """One topic of some senders, on domains that the governance treats alike."""

    who: tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...], str]
    """Senders, receivers, stock participants, and partitions in words."""
    topic: str
    domains: DomainRange


class _Joining:
    """Who may join which domain."""

    def __init__(
        self, governance: Governance, members: Iterable[DocumentOwner], now: datetime
    ) -> None:
        self._policies = {
            each.name: (InterpretedPolicy(governance, each.permissions, SPEC), each.subject)
            for each in members
        }
        self._now = now
        self._known: dict[int, tuple[str, ...]] = {}

    def on(self, domain: int) -> tuple[str, ...]:
        """The names of those that may, in the order of the members."""
        if domain not in self._known:
            self._known[domain] = tuple(
                name
                for name, (policy, subject) in self._policies.items()
                if policy.decide(
                    Question(subject=subject, domain=domain, action=Action.JOIN, now=self._now)
                ).allowed
            )
        return self._known[domain]


def _of_topic(
    governance: Governance, placed: Placed, stock: frozenset[str], joining: _Joining
) -> Iterator[_One]:
    row = placed.row
    for part in _parts(governance, placed.domains) if row.subscribers else ():
        protection = _protection(governance, part.first, row.topic)
        if protection is None:
            continue
        getters = [row.subscribers] if _encrypts_topic(protection) else []
        getters += [joining.on(part.first)] if protection.rtps.encrypts else []
        for senders, by in _known_by(row.publishers, row.subscribers, getters, stock):
            yield _One((senders, row.subscribers, by, row.where), row.topic, part)


def _parts(governance: Governance, domains: DomainSet) -> Iterator[DomainRange]:
    every = stretches([domains, *(rule.domains for rule in governance.domain_rules)])
    return (each for each in every if each.first in domains)


def _protection(governance: Governance, domain: int, topic: str) -> Protection | None:
    """The protection of the topic on that domain; None if no rule is for it."""
    rule = governance.rule_for(domain)
    for each in rule.topic_rules if rule else ():
        if rule and SPEC.governs(each.topic_expression, topic):
            return Protection.of(rule, each)
    return None


def _encrypts_topic(protection: Protection) -> bool:
    """Whether only readers of the topic get the key of its samples."""
    return any(kind and kind.encrypts for kind in (protection.data, protection.metadata))


def _known_by(
    senders: Iterable[str],
    receivers: tuple[str, ...],
    getters: Sequence[Sequence[str]],
    stock: frozenset[str],
) -> Iterator[tuple[tuple[str, ...], tuple[str, ...]]]:
    """Senders of which each key is known, and by which stock participants that get them.

    `getters` are, for each key that the samples are encrypted with, those that get it.
    """
    if not getters:
        return
    sending = [each for each in senders if (each,) != receivers]
    getting = [tuple(each for each in those if each in stock) for those in getters]
    others = tuple(each for each in sending if each not in stock)
    if others and all(getting):
        yield others, getting[0]
    if own := tuple(each for each in sending if each in stock):
        yield own, ()


def _together(found: Iterable[_One], known: Sequence[str]) -> list[Decryptable]:
    """One row for all topics that are alike, on all domains where they are."""
    parts: dict[tuple[object, str], dict[DomainRange, None]] = {}
    for each in found:
        parts.setdefault((each.who, _said(each.topic, known)), {})[each.domains] = None
    topics: dict[tuple[Any, DomainSet], list[str]] = {}
    for (who, topic), domains in parts.items():
        topics.setdefault((who, domain_set(list(domains))), []).append(topic)
    rows = (
        Decryptable(
            senders=senders,
            receivers=receivers,
            stock=stock,
            where=where,
            domains=domains,
            topics=tuple(sorted(together)),
        )
        for ((senders, receivers, stock, where), domains), together in topics.items()
    )
    return sorted(rows, key=attrgetter("senders", "where", "topics"))


def _said(topic: str, known: Sequence[str]) -> str:
    """The topic, or for a sample of patterns the longest one that covers it."""
    covering = (each for each in known if is_wildcard(each) and posix(each, topic))
    return topic if topic in known else max(covering, key=len, default=topic)
