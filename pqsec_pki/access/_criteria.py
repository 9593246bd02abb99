"""Whether the partitions and data tags of an endpoint match those of criteria.

An endpoint without a partition is in the default partition, whose name is empty.
"""

from pqsec_pki.access._expressions import meets, within
from pqsec_pki.access._witnesses import is_wildcard
from pqsec_pki.access.interpretation import EvaluationContext
from pqsec_pki.documents import Criteria, PermissionRule

_DEFAULT = ("",)


def standard_partitions(
    context: EvaluationContext, criteria: Criteria, rule: PermissionRule
) -> bool:
    """9.4.1.3.2.3.1.4: an allow_rule must cover all of them, by default the default partition.

    9.4.1.3.2.3.2.4: a deny_rule must match one of them, and by default matches all. Both sides
    are expressions: see `_expressions`.
    """
    if not criteria.partitions and not (rule.allow and context.question.partitions):
        return True
    patterns, compare = criteria.partitions or _DEFAULT, within if rule.allow else meets
    among = (
        compare(each, patterns, context.budget)
        if is_wildcard(each)
        else _named(context, patterns, each)
        for each in context.question.partitions or _DEFAULT
    )
    return all(among) if rule.allow else any(among)


def named_partitions(context: EvaluationContext, criteria: Criteria, rule: PermissionRule) -> bool:
    """Like `standard_partitions`, but the endpoint's partitions are plain names."""
    if not rule.allow and not criteria.partitions:
        return True
    return cyclonedds_partitions(context, criteria, rule)


def cyclonedds_partitions(
    context: EvaluationContext, criteria: Criteria, rule: PermissionRule
) -> bool:
    """Partitions as names; a deny_rule that names none denies only the default partition.

    Cyclone DDS 0.10.2 (measured): its parser puts the default partition in both.
    """
    patterns = criteria.partitions or _DEFAULT
    among = (_named(context, patterns, each) for each in context.question.partitions or _DEFAULT)
    return all(among) if rule.allow else any(among)


def _named(context: EvaluationContext, patterns: tuple[str, ...], name: str) -> bool:
    return any(context.interpretation.covers(pattern, name) for pattern in patterns)


def opendds_partitions(
    context: EvaluationContext, criteria: Criteria, rule: PermissionRule
) -> bool:
    """Partitions as names; an endpoint without partitions matches every allow_rule.

    OpenDDS 3.34 (read): partitions_match looks only at partitions that the endpoint has, so it
    finds none that is not allowed, and none that is denied. If an allow_rule names no
    partition, the endpoint may have one at most.
    """
    if rule.allow and not criteria.partitions:
        return context.question.partitions in {(), _DEFAULT}
    if criteria.partitions and not context.question.partitions:
        return rule.allow
    return named_partitions(context, criteria, rule)


def standard_tags(context: EvaluationContext, criteria: Criteria, rule: PermissionRule) -> bool:
    """9.4.1.3.2.3.1.5: an allow_rule must list all of them, and by default lists none.

    9.4.1.3.2.3.2.5: a deny_rule must list one of them, and by default sets no condition.
    """
    if not context.question.data_tags:
        return rule.allow or not criteria.data_tags
    tags = set(context.question.data_tags)
    if rule.allow:
        return tags <= set(criteria.data_tags)
    return not criteria.data_tags or bool(tags & set(criteria.data_tags))


def no_tags(_case: EvaluationContext, _criteria: Criteria, _rule: PermissionRule) -> bool:
    """No stack looks at data tags (measured for Cyclone DDS and Fast DDS, read for OpenDDS)."""
    return True
