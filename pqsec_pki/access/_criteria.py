"""When the partitions and data tags of an endpoint meet those of criteria.

An endpoint without a partition is in the default one, whose name is empty.
"""

from pqsec_pki.access._expressions import meets, within
from pqsec_pki.access._witnesses import is_wildcard
from pqsec_pki.access.interpretation import EvaluationContext
from pqsec_pki.documents import Criteria, Rule

_DEFAULT = ("",)


def standard_partitions(context: EvaluationContext, criteria: Criteria, rule: Rule) -> bool:
    """9.4.1.3.2.3.1.4: all of them lie within those allowed, by default the default one.

    9.4.1.3.2.3.2.4: one of them meets those denied, by default all. They are expressions
    as those of the rule are: see `_expressions`.
    """
    if not rule.allow and not criteria.partitions:
        return True
    patterns, compare = criteria.partitions or _DEFAULT, within if rule.allow else meets
    among = (
        compare(each, patterns, context.budget)
        if is_wildcard(each)
        else _named(context, patterns, each)
        for each in context.question.partitions or _DEFAULT
    )
    return all(among) if rule.allow else any(among)


def named_partitions(context: EvaluationContext, criteria: Criteria, rule: Rule) -> bool:
    """The same of names, with wildcards or without: what an expression stands for are names."""
    if not rule.allow and not criteria.partitions:
        return True
    return cyclonedds_partitions(context, criteria, rule)


def cyclonedds_partitions(context: EvaluationContext, criteria: Criteria, rule: Rule) -> bool:
    """As names, and a deny_rule that names no partition denies only the default one.

    Cyclone DDS 0.10.2 (measured): its parser puts the default partition in both.
    """
    patterns = criteria.partitions or _DEFAULT
    among = (_named(context, patterns, each) for each in context.question.partitions or _DEFAULT)
    return all(among) if rule.allow else any(among)


def _named(context: EvaluationContext, patterns: tuple[str, ...], name: str) -> bool:
    return any(context.interpretation.covers(pattern, name) for pattern in patterns)


def opendds_partitions(context: EvaluationContext, criteria: Criteria, rule: Rule) -> bool:
    """As names, and an endpoint without partitions meets all that allow_rules name.

    OpenDDS 3.34 (read): partitions_match counts only partitions that the endpoint has,
    so it finds none that is not allowed, and none that is denied. Where an allow_rule names
    no partition there must be one at most.
    """
    if rule.allow and not criteria.partitions:
        return context.question.partitions in {(), _DEFAULT}
    if criteria.partitions and not context.question.partitions:
        return rule.allow
    return named_partitions(context, criteria, rule)


def standard_tags(context: EvaluationContext, criteria: Criteria, rule: Rule) -> bool:
    """9.4.1.3.2.3.1.5: all of them are among those allowed, by default none.

    9.4.1.3.2.3.2.5: one of them is among those denied, by default that is no condition.
    """
    tags = set(context.question.data_tags)
    if rule.allow:
        return tags <= set(criteria.data_tags)
    return not criteria.data_tags or bool(tags & set(criteria.data_tags))


def no_tags(_case: EvaluationContext, _criteria: Criteria, _rule: Rule) -> bool:
    """No stack looks at data tags (measured for Cyclone DDS and Fast DDS, read for OpenDDS)."""
    return True
