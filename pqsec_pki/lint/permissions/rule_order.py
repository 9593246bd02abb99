"""Rules about the order of allow_rule and deny_rule."""

from collections.abc import Iterator

from pqsec_pki.documents import DomainSet, PermissionRule
from pqsec_pki.lint.document import ACTIONS, PermissionsFile
from pqsec_pki.lint.documents._shadows import Patterns, covers_domains
from pqsec_pki.lint.rule import Severity, Violation, lint_rule

ERROR, WARNING, _ = Severity
MAX_DOMAIN_SETS = 16
"""How many different sets of domains of one grant are compared."""


@lint_rule(
    "PQS254", ERROR, "a deny_rule after an allow_rule that covers it",
    why="The first rule that matches decides. An earlier allow_rule matches what this deny_rule"
    " denies, so it is allowed. Measured in all stacks.",
    fix="Move the deny_rule before the allow_rule.",
    rows=("allow(*) then deny(T)", "deny(T) then allow(*)"), measured="all six stacks",
    bad="""
        <allow_rule>
          <domains><id>0</id></domains>
          <publish><topics><topic>rt/*</topic></topics></publish>
        </allow_rule>
        <deny_rule>
          <domains><id>0</id></domains>
          <publish><topics><topic>rt/cmd</topic></topics></publish>
        </deny_rule>
    """,
    good="""
        <deny_rule>
          <domains><id>0</id></domains>
          <publish><topics><topic>rt/cmd</topic></topics></publish>
        </deny_rule>
        <allow_rule>
          <domains><id>0</id></domains>
          <publish><topics><topic>rt/*</topic></topics></publish>
        </allow_rule>
    """,
)  # fmt: skip
def late_deny(document: PermissionsFile) -> Iterator[Violation]:
    for line, action, topic, rule, earlier in _shadowed(document):
        if not rule.allow:
            yield document.at(
                line, f"{action} of {topic!a} is not denied:"
                f" the allow_rule in line {document.line(earlier.line)} covers it",
            )  # fmt: skip


@lint_rule(
    "PQS255", WARNING, "an allow_rule after a deny_rule that covers it",
    why="The first rule that matches decides. An earlier deny_rule matches what this allow_rule"
    " allows.",
    fix="Move the allow_rule before the deny_rule, or remove it.",
    rows=("deny(T) then allow(*)",), measured="all six stacks",
    bad="""
        <deny_rule>
          <domains><id>0</id></domains>
          <publish><topics><topic>rt/*</topic></topics></publish>
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
        <deny_rule>
          <domains><id>0</id></domains>
          <publish><topics><topic>rt/*</topic></topics></publish>
        </deny_rule>
    """,
)  # fmt: skip
def late_allow(document: PermissionsFile) -> Iterator[Violation]:
    for line, action, topic, rule, earlier in _shadowed(document):
        if rule.allow:
            yield document.at(
                line, f"{action} of {topic!a} is not allowed:"
                f" the deny_rule in line {document.line(earlier.line)} covers it",
            )  # fmt: skip


_Shadow = tuple[int | None, str, str, PermissionRule, PermissionRule]
"""Line, action, topic, its rule, and an earlier rule that decides the opposite."""


def _shadowed(document: PermissionsFile) -> Iterator[_Shadow]:
    for grant in document.grants:
        before: dict[tuple[object, ...], Patterns[PermissionRule]] = {}
        sets: list[DomainSet] = []
        for rule in grant.rules:
            if rule.domains not in sets and len(sets) < MAX_DOMAIN_SETS:
                sets.append(rule.domains)
            wider = [each for each in sets if covers_domains(each, rule.domains)]
            for action in ACTIONS:
                yield from _shadowed_in(rule, action, wider, before)


def _shadowed_in(
    rule: PermissionRule,
    action: str,
    wider: list[DomainSet],
    before: dict[tuple[object, ...], Patterns[PermissionRule]],
) -> Iterator[_Shadow]:
    for criteria in getattr(rule, action):
        limits = (action, criteria.partitions, criteria.data_tags)
        earlier = [before[key] for each in wider if (key := (*limits, each.parts)) in before]
        for topic in criteria.topics:
            above = [mark for patterns in earlier for mark in patterns.covering(topic)]
            first = min(above, key=lambda mark: mark.line or 0, default=None)
            if first and first is not rule and first.allow != rule.allow:
                yield criteria.line, action, topic, rule, first
                break
        own = before.setdefault((*limits, rule.domains.parts), Patterns())
        for topic in criteria.topics:
            own.add(topic, rule)
