"""Finds roles: participants with the same rules, or the same with their names left open."""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from datetime import timedelta
from itertools import takewhile

from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents import Criteria, DefaultAction, DomainSet, PermissionRule
from pqsec_pki.domain._placeholders import own_values

_LEFT_OPEN = (
    *((), ("name",), ("base",), ("parent",)),
    *(("name", "base"), ("name", "parent"), ("name", "base", "parent")),
)
"""The placeholders to try for a participant, the plainest first."""
_NUMBERING = "0123456789_.-"
_ANY_DOMAIN = DomainSet.of(0)


@dataclass(frozen=True, slots=True)
class FoundParticipant:
    """A participant that was found in a source, with its rights."""

    name: str
    rules: tuple[PermissionRule, ...]
    default: DefaultAction
    validity: timedelta
    """The validity of its certificate, or of its permissions in a policy."""
    source: str
    key_elsewhere: bool = False
    """Whether its key is on its robot."""

    @property
    def domains(self) -> DomainSet | None:
        """The domains of all its rules; None if they differ."""
        first, *others = {rule.domains for rule in self.rules}
        return None if others else first


@dataclass(frozen=True, slots=True)
class SharedRules:
    """The rules of a role, with placeholders, and `$$` for `$`."""

    rules: tuple[PermissionRule, ...]
    default: DefaultAction
    domains: DomainSet | None
    """In all rules, in place of the participant's domains; None if the rules have their own."""


def shared_rules(
    participants: Sequence[FoundParticipant],
) -> dict[SharedRules, list[FoundParticipant]]:
    """The roles with their participants, in the order of `participants`.

    Each participant gets the role that most can share, the one with the fewest placeholders
    among equal ones.
    """
    choices = [_choices(each) for each in participants]
    sizes = Counter(role for roles in choices for role in set(roles))
    found: dict[SharedRules, list[FoundParticipant]] = {}
    for participant, roles in zip(participants, choices, strict=True):
        found.setdefault(max(roles, key=sizes.__getitem__), []).append(participant)
    return found


def labels(groups: Iterable[Sequence[FoundParticipant]]) -> list[str]:
    """A name for each role, made from the names of its participants; they differ."""
    taken: set[str] = set()
    found: list[str] = []
    for group in groups:
        plain = _label([each.name for each in group])
        numbered = (f"{plain}-{number}" for number in range(2, len(taken) + 3))
        found.append(next(each for each in (plain, *numbered) if each not in taken))
        taken.add(found[-1])
    return found


def _label(names: list[str]) -> str:
    """What the last parts of the names begin with; else the folder that all are in."""
    parts = [name.split("/")[1:] for name in names]
    if len(parts) == 1:
        return parts[0][-1]
    common = "".join(_begin([each[-1] for each in parts])).rstrip(_NUMBERING)
    folders = _begin([each[:-1] for each in parts])
    return common or (folders[-1] if folders else "participant")


def _begin(sequences: Iterable[Sequence[str]]) -> list[str]:
    """The items that all begin with. os.path.commonprefix is deprecated since Python 3.15."""
    alike = takewhile(lambda items: len(set(items)) == 1, zip(*sequences, strict=False))
    return [items[0] for items in alike]


def _choices(participant: FoundParticipant) -> list[SharedRules]:
    domains = participant.domains
    return [
        SharedRules(
            tuple(
                _with_texts(
                    rule if domains is None else replace(rule, domains=_ANY_DOMAIN),
                    _opener(participant.name, words),
                )
                for rule in participant.rules
            ),
            participant.default,
            None if domains is None else _ANY_DOMAIN,
        )
        for words in _LEFT_OPEN
    ]


def _opener(name: str, words: Sequence[str]) -> Callable[[str], str]:
    """A function that puts these placeholders into a text of the participant `name`."""
    values = {value: word for word, value in own_values(name).items() if value and word in words}
    if not values:
        return lambda text: text.replace("$", "$$")
    longest = sorted(values, key=len, reverse=True)
    # No part of a longer word is a name: neither robot1 in robot12, nor arm in alarm.
    starts = ("" if each.startswith("/") else "(?<![A-Za-z0-9])" for each in longest)
    either = "|".join(start + re.escape(each) for start, each in zip(starts, longest, strict=True))
    pattern = re.compile(f"(?:{either})(?![A-Za-z0-9])(?=(?P<joined>_)?)|[$]")

    def opened(text: str) -> str:
        return pattern.sub(_placeholder, text)

    def _placeholder(found: re.Match[str]) -> str:
        if found[0] == "$":
            return "$$"
        word = values[found[0]]
        return f"${{{word}}}" if found["joined"] else f"${word}"

    return opened


def _with_texts(rule: PermissionRule, change: Callable[[str], str]) -> PermissionRule:
    """The rule with each topic, partition and value of a data tag changed."""

    def changed(criteria: tuple[Criteria, ...]) -> tuple[Criteria, ...]:
        return tuple(
            Criteria(
                topics=tuple(map(change, each.topics)),
                partitions=tuple(map(change, each.partitions)),
                data_tags=tuple((name, change(value)) for name, value in each.data_tags),
            )
            for each in criteria
        )

    return replace(
        rule,
        publish=changed(rule.publish),
        subscribe=changed(rule.subscribe),
        relay=changed(rule.relay),
    )
