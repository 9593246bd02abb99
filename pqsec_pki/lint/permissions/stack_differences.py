"""Rules about permissions that a stack reads differently from the standard.

The decision then depends on the stack. `pqsec explain` shows the decision of each stack.
"""

from collections.abc import Iterator
from dataclasses import field

from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents import Criteria, DefaultAction, DomainSet, Grant, PermissionRule
from pqsec_pki.lint.document import PermissionsFile
from pqsec_pki.lint.documents._shadows import Patterns, Starts, covers_domains, domains_meet
from pqsec_pki.lint.permissions._names import criteria_of
from pqsec_pki.lint.rule import Severity, Violation, lint_rule
from pqsec_pki.stacks import Stack

MAX_DOMAIN_SETS = 16
"""Different sets of domains in one grant that are compared with each other."""
_WARNING = Severity.WARNING
_OTHER = {"publish": "subscribe", "subscribe": "publish"}
_CYCLONE = "Cyclone DDS 0.10.2"


@dataclass(frozen=True, slots=True, eq=False)
class _Entry:
    """A topic pattern, with its rule, action and criteria."""

    rule: PermissionRule
    action: str
    criteria: Criteria
    topic: str


@dataclass(slots=True)
class _Allowed:
    """What is allowed, by action and domains."""

    all_of_it: bool
    """Whether the default allows everything."""
    starts: dict[tuple[str, object], tuple[DomainSet, Starts]] = field(default_factory=dict)

    def add(self, entry: _Entry) -> None:
        """Add an entry of an allow_rule."""
        domains = entry.rule.domains
        key = (entry.action, domains.parts if len(self.starts) < MAX_DOMAIN_SETS else None)
        self.starts.setdefault(key, (domains, Starts()))[1].add(entry.topic)

    def may_meet(self, entry: _Entry, action: str) -> bool:
        """Whether `action` may be allowed for a topic and a domain that `entry` names."""
        return self.all_of_it or any(
            starts.may_meet(entry.topic)
            for (other, parts), (domains, starts) in self.starts.items()
            if other == action and (parts is None or domains_meet(domains, entry.rule.domains))
        )


def _entries(grant: Grant) -> list[_Entry]:
    return [
        _Entry(rule, action, criteria, topic)
        for rule, action, criteria in criteria_of(grant)
        for topic in criteria.topics
    ]


@lint_rule(
    "PQS270", _WARNING, "a deny_rule that also denies the other action",
    why="Cyclone DDS 0.10 first checks whether a participant may have the topic at all. The first"
    " rule that names the topic decides, for publishing and for subscribing. A participant that may"
    " not publish a topic cannot subscribe to it either. Since 11.0 it can.",
    fix="Move the allow_rule before the deny_rule.",
    stacks={Stack.CYCLONEDDS: "0.10.2"}, measured=f"{_CYCLONE}; 11.0.1 allows it",
    bad="""
        <deny_rule>
          <domains><id>0</id></domains>
          <publish><topics><topic>rt/chatter</topic></topics></publish>
        </deny_rule>
        <allow_rule>
          <domains><id>0</id></domains>
          <subscribe><topics><topic>rt/chatter</topic></topics></subscribe>
        </allow_rule>
    """,
    good="""
        <allow_rule>
          <domains><id>0</id></domains>
          <subscribe><topics><topic>rt/chatter</topic></topics></subscribe>
        </allow_rule>
        <deny_rule>
          <domains><id>0</id></domains>
          <publish><topics><topic>rt/chatter</topic></topics></publish>
        </deny_rule>
    """,
)  # fmt: skip
def denies_both(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        entries = _entries(grant)
        decides, denied = _not_allowed_above(entries), _denied(entries)
        below = _Allowed(all_of_it=grant.default is DefaultAction.ALLOW)
        for entry in reversed(entries):
            other = _OTHER[entry.action]
            if entry.rule.allow:
                below.add(entry)
            elif (
                entry in decides
                and not _is_covered(entry, denied[other])
                and below.may_meet(entry, other)
            ):
                yield document.at(
                    entry.criteria.line,
                    f"Cyclone DDS 0.10 does not let it {other} {entry.topic!a} either",
                )


def _not_allowed_above(entries: list[_Entry]) -> set[_Entry]:
    """Entries of deny_rules whose topic no earlier allow_rule is certain to cover."""
    allowed, found = Patterns[PermissionRule](), set[_Entry]()
    for entry in entries:
        if entry.rule.allow:
            allowed.add(entry.topic, entry.rule)
        elif not _is_covered(entry, allowed):
            found.add(entry)
    return found


def _denied(entries: list[_Entry]) -> dict[str, Patterns[PermissionRule]]:
    found = {action: Patterns[PermissionRule]() for action in _OTHER}
    for entry in entries:
        if not entry.rule.allow:
            found[entry.action].add(entry.topic, entry.rule)
    return found


def _is_covered(entry: _Entry, patterns: Patterns[PermissionRule]) -> bool:
    marks = patterns.covering(entry.topic)
    return any(covers_domains(mark.domains, entry.rule.domains) for mark in marks)


@lint_rule(
    "PQS271", _WARNING, "a deny_rule that also applies to other domains",
    why="Fast DDS ignores the domains in the rules for its own participant. What is denied for one"
    " domain is denied for all.",
    fix="If a participant joins several domains, give it separate permissions for each domain, each"
    " in its own folder.",
    stacks={Stack.FASTDDS: "2.9.1"}, measured="Fast DDS 2.9.1",
    bad="""
        <deny_rule>
          <domains><id>1</id></domains>
          <publish><topics><topic>rt/chatter</topic></topics></publish>
        </deny_rule>
        <allow_rule>
          <domains><id>0</id></domains>
          <publish><topics><topic>rt/chatter</topic></topics></publish>
        </allow_rule>
    """,
    good="""
        <allow_rule>
          <domains><id>0</id></domains>
          <publish><topics><topic>rt/chatter</topic></topics></publish>
        </allow_rule>
    """,
)  # fmt: skip
def denies_elsewhere(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        allowed = {rule.domains.parts: rule.domains for rule in grant.rules if rule.allow}
        some = list(allowed.values())[:MAX_DOMAIN_SETS]
        for rule in grant.rules:
            if not rule.allow and not all(covers_domains(rule.domains, each) for each in some):
                yield document.at(
                    rule.line, f"Fast DDS denies this on every domain, not only on {rule.domains}"
                )


@lint_rule(
    "PQS272", _WARNING, "a deny_rule without partitions",
    why="A deny_rule without partitions applies to all partitions. In Cyclone DDS it applies only"
    " to endpoints without a partition. An endpoint in a partition is allowed by the default, or by"
    " a later allow_rule with partitions. The check of the topic denies it only if governance"
    " controls both reading and writing and, in 0.10, no earlier allow_rule names the topic; in"
    " 11.0, if the other action is denied too.",
    fix="Write default DENY and allow only what is needed. Or name the partitions in the deny_rule"
    " too; <partition>*</partition> means all.",
    stacks={Stack.CYCLONEDDS: "0.10.2, 11.0.1"}, measured=f"{_CYCLONE}, 11.0.1",
    bad="""
        <allow_rule>
          <domains><id>0</id></domains>
          <subscribe><topics><topic>rt/*</topic></topics></subscribe>
        </allow_rule>
        <deny_rule>
          <domains><id>0</id></domains>
          <publish><topics><topic>rt/cmd</topic></topics></publish>
        </deny_rule>
        <allow_rule>
          <domains><id>0</id></domains>
          <publish>
            <topics><topic>rt/*</topic></topics>
            <partitions><partition>*</partition></partitions>
          </publish>
        </allow_rule>
    """,
    good="""
        <allow_rule>
          <domains><id>0</id></domains>
          <subscribe><topics><topic>rt/*</topic></topics></subscribe>
        </allow_rule>
        <allow_rule>
          <domains><id>0</id></domains>
          <publish>
            <topics><topic>rt/chatter</topic></topics>
            <partitions><partition>*</partition></partitions>
          </publish>
        </allow_rule>
    """,
)  # fmt: skip
def denies_without_partitions(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        below = _Allowed(all_of_it=grant.default is DefaultAction.ALLOW)
        for entry in reversed(_entries(grant)):
            if bool(entry.criteria.partitions) is not entry.rule.allow:
                continue
            if entry.rule.allow:
                below.add(entry)
            elif below.may_meet(entry, entry.action):
                yield document.at(
                    entry.criteria.line,
                    f"Cyclone DDS may not deny {entry.topic!a} to endpoints with a partition",
                )


@lint_rule(
    "PQS274", _WARNING, "a grant that allows nothing",
    why="Without an allow_rule and with default DENY, a participant cannot join a domain with join"
    " access control. With Fast DDS it cannot join any domain.",
    fix="Add an allow_rule for its domains, or remove the grant.",
    measured="Cyclone DDS 0.10.2, Fast DDS 2.9.1",
    bad="""
        <deny_rule>
          <domains><id>0</id></domains>
          <publish><topics><topic>*</topic></topics></publish>
        </deny_rule>
    """,
    good="""
        <allow_rule>
          <domains><id>0</id></domains>
        </allow_rule>
    """,
)  # fmt: skip
def allows_nothing(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        if grant.default is DefaultAction.DENY and not any(rule.allow for rule in grant.rules):
            yield document.at(
                grant.line, "the grant has no allow_rule: no participant can join with it"
            )
