"""Describes a permissions document: what each participant may do, and when."""

from collections.abc import Iterator
from datetime import datetime

from pqsec_pki.documents import Criteria, Grant, PermissionRule, Permissions
from pqsec_pki.inspection import _times
from pqsec_pki.inspection.description import Fact, Row, Value


def permissions_fact(permissions: Permissions, now: datetime) -> Fact:
    """The whole content of the document."""
    rows: list[Row] = []
    for number, grant in enumerate(permissions.grants, 1):
        first, *rest = _grant_words(grant, now)
        rows += [(f"grant {number}", first), *(("", line) for line in rest)]
    values = tuple(_grant_value(grant, now) for grant in permissions.grants)
    return Fact("grants", values, tuple(rows))


def _grant_words(grant: Grant, now: datetime) -> Iterator[str]:
    yield f"subject: {grant.subject_name}"
    if grant.name != grant.subject_name:
        yield f"name: {grant.name}"
    yield f"validity: {_times.window(grant.not_before, grant.not_after, now)}"
    for rule in grant.rules:
        yield f"{_verb(rule)} on {rule.domains.words}"
        yield from (f"  {line}" for line in _rule_words(rule))
    yield f"{'everything' if not grant.rules else 'everything else'}: {grant.default.lower()}"


def _rule_words(rule: PermissionRule) -> Iterator[str]:
    actions = list(_actions(rule))
    for action, criteria in actions:
        for each in criteria:
            yield f"{action}: {_criteria_words(each)}"
    if not any(criteria for _, criteria in actions):
        yield "no topic"


def _criteria_words(criteria: Criteria) -> str:
    words = f"topics {', '.join(criteria.topics)}"
    if criteria.partitions:
        words += f" in partitions {', '.join(map(_quoted, criteria.partitions))}"
    if criteria.data_tags:
        tags = ", ".join(f"{name}={value}" for name, value in criteria.data_tags)
        words += f" with data tags {tags}"
    return words


def _quoted(name: str) -> str:
    return name or '"" (the default)'


def _actions(rule: PermissionRule) -> tuple[tuple[str, tuple[Criteria, ...]], ...]:
    return (("publish", rule.publish), ("subscribe", rule.subscribe), ("relay", rule.relay))


def _verb(rule: PermissionRule) -> str:
    return "allow" if rule.allow else "deny"


def _grant_value(grant: Grant, now: datetime) -> dict[str, Value]:
    return {
        "name": grant.name,
        "subject": grant.subject_name,
        "validity": _times.window_value(grant.not_before, grant.not_after, now),
        "rules": tuple(map(_rule_value, grant.rules)),
        "default": grant.default.value,
    }


def _rule_value(rule: PermissionRule) -> dict[str, Value]:
    actions: dict[str, Value] = {
        action: tuple(map(_criteria_value, criteria)) for action, criteria in _actions(rule)
    }
    return {"action": _verb(rule), "domains": str(rule.domains), **actions}


def _criteria_value(criteria: Criteria) -> dict[str, Value]:
    return {
        "topics": criteria.topics,
        "partitions": criteria.partitions,
        "data_tags": criteria.data_tags,
    }
