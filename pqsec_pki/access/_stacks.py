"""The checks in which stacks differ from the standard.

All of this was measured with the plugins of Cyclone DDS 0.10.2 and 11.0.1, and of Fast DDS 2.9.1.
For OpenDDS 3.34 it was read in the source, and its access control was run.
"""

from collections.abc import Iterable

from pqsec_pki.access._checks import (
    by_default,
    by_rules,
    endpoint,
    in_force,
    is_open,
    name_of,
    opened,
    remote_participant,
    ruled,
    said,
    ungoverned,
)
from pqsec_pki.access.decision import Decision, no, yes
from pqsec_pki.access.interpretation import EvaluationContext
from pqsec_pki.access.question import Action
from pqsec_pki.documents import Criteria, PermissionRule, TopicRule

_EITHER = (Action.PUBLISH, Action.SUBSCRIBE)
CYCLONEDDS_BUILTIN = frozenset(
    f"DCPS{name}"
    for name in (
        *("Participant", "Publication", "Subscription", "Topic", "ParticipantMessage"),
        *("TypeLookupRequest", "TypeLookupReply", "ParticipantsSecure", "PublicationsSecure"),
        *("SubscriptionsSecure", "ParticipantMessageSecure", "ParticipantStatelessMessage"),
        "ParticipantVolatileMessageSecure",
    )
)


def cyclonedds_topic(context: EvaluationContext) -> Decision:
    """check_create_topic of 0.10: an endpoint needs a topic, which is checked first.

    The first rule for the domain that has the topic decides, for publishing or subscribing and
    in any partition. So a deny_rule for one partition denies the topic.
    """
    return _cyclonedds_governed(context) or _first_with_topic(context, _EITHER)


def cyclonedds_11_topic(context: EvaluationContext) -> Decision:
    """check_create_topic of 11.0: denied only if publishing and subscribing both are.

    Each is decided by the first rule for the domain that has the topic for it, in any partition
    (upstream 5ac329b05).
    """
    if decision := _cyclonedds_governed(context):
        return decision
    own_first = sorted(_EITHER, key=lambda action: action is not context.question.action)
    decisions = [_first_with_topic(context, (action,)) for action in own_first]
    return next((each for each in decisions if each.allowed), decisions[0])


def _cyclonedds_governed(context: EvaluationContext) -> Decision | None:
    """The decision about the topic without permissions; None if they decide."""
    if context.question.topic in context.interpretation.builtin:
        return _builtin(context)
    rule = next(context.topic_rules, None)
    if rule is None:
        return ungoverned(context)
    return opened(context, rule) if rule.is_half_open else None


def _first_with_topic(context: EvaluationContext, actions: tuple[Action, ...]) -> Decision:
    """By the first rule for the domain that has the topic for one of the actions."""
    for rule in context.rules:
        for action in actions:
            for criteria in context.criteria(rule, action):
                if context.has_topic(criteria):
                    return _topic_ruled(context, rule, criteria)
    return by_default(context, None)


def cyclonedds_endpoint(context: EvaluationContext) -> Decision:
    """check_create_datawriter and similar: as the standard, except for builtin topic names."""
    if context.question.topic in context.interpretation.builtin:
        return _builtin(context)
    return endpoint(context)


def _builtin(context: EvaluationContext) -> Decision:
    """get_topic_sec_attributes: a topic with the name of a builtin one is open to all."""
    return yes(f"'{context.question.topic}' is a builtin topic of Cyclone DDS, open to all members")


def _topic_ruled(context: EvaluationContext, rule: PermissionRule, criteria: Criteria) -> Decision:
    if rule.allow:
        return ruled(context, rule, criteria)
    text = f"a deny_rule of grant '{context.grant.name}' names '{context.question.topic}'"
    return no(f"{text}, which cannot even be created", rule, criteria)


def fastdds_own_participant(context: EvaluationContext) -> Decision:
    """check_create_participant: it needs an allow_rule, for whatever domain.

    check_subject_name intends to remove the rules for other domains, but removes them from a
    copy that is already empty.
    """
    return _fastdds_participant(context, context.grant.rules, "")


def fastdds_remote_participant(context: EvaluationContext) -> Decision:
    """check_remote_participant: an allow_rule for the domain, never the default."""
    for rule in context.domain_rules[:1]:
        if not rule.enable_join_access_control:
            return yes(f"join access control is off on domain {context.question.domain}", rule)
    return _fastdds_participant(context, context.rules, f" for domain {context.question.domain}")


def _fastdds_participant(
    context: EvaluationContext, rules: Iterable[PermissionRule], where: str
) -> Decision:
    for rule in rules:
        if rule.allow:
            return yes(f"grant '{context.grant.name}' has an allow_rule{where}", rule)
    return no(f"grant '{context.grant.name}' has no allow_rule{where}", context.grant)


def fastdds_own_endpoint(context: EvaluationContext) -> Decision:
    """check_create_datawriter, check_create_datareader: rules for other domains count too."""
    action = context.question.action
    if action is Action.RELAY:
        return yes("a participant's own stack does not check relaying")
    return _fastdds_endpoint(context, context.grant.rules, (action,))


def fastdds_remote_endpoint(context: EvaluationContext) -> Decision:
    """check_remote_datawriter, check_remote_datareader: for a reader, relaying suffices too."""
    action = context.question.action
    actions = (action,) if action is Action.PUBLISH else (Action.SUBSCRIBE, Action.RELAY)
    return _fastdds_endpoint(context, context.rules, actions)


def _fastdds_endpoint(
    context: EvaluationContext, rules: Iterable[PermissionRule], actions: tuple[Action, ...]
) -> Decision:
    """The first rule that has the topic decides; then its partitions are checked.

    The partitions of all its criteria for the action count together; a deny_rule denies in
    every partition. If no rule has the topic, it is denied: the default is never used.
    """
    open_to = next(context.topic_rules, None)
    if open_to is None:
        return ungoverned(context)
    if is_open(context, open_to):
        return opened(context, open_to)
    for rule in rules:
        for action in actions:
            criteria = context.criteria(rule, action)
            found = next((each for each in criteria if context.has_topic(each)), None)
            if found:
                return _fastdds_ruled(context, rule, found, criteria)
    text = f"no rule of grant '{context.grant.name}' says whether it may {said(context)}"
    return no(f"{text}, and Fast DDS does not look at its default", context.grant)


def _fastdds_ruled(
    context: EvaluationContext,
    rule: PermissionRule,
    found: Criteria,
    criteria: tuple[Criteria, ...],
) -> Decision:
    patterns = [each for one in criteria for each in one.partitions or ("",)]
    for partition in (context.question.partitions or ("",)) if rule.allow else ():
        if not any(context.interpretation.covers(pattern, partition) for pattern in patterns):
            text = f"{name_of(rule)} of grant '{context.grant.name}' has '{context.question.topic}'"
            return no(f"{text}, but not in partition '{partition}'", rule, found)
    return ruled(context, rule, found)


def opendds_own_participant(context: EvaluationContext) -> Decision:
    """check_create_participant: allowed only if something is open (OpenDDS issue 5007).

    With join access control, and read and write access control for every topic, no
    participant can be created, whatever its permissions.
    """
    for rule in context.domain_rules:
        if not rule.enable_join_access_control:
            return yes(f"join access control is off on domain {context.question.domain}", rule)
        for topic_rule in rule.topic_rules:
            if topic_rule.is_half_open:
                return yes("governance has a topic that is open to all", topic_rule)
    text = "OpenDDS creates no participant if governance controls joining and every topic"
    return no(text, context.domain_rules[0])


def opendds_topic(context: EvaluationContext) -> Decision:
    """check_create_topic: denied if deny_rules for publishing and subscribing come before
    any allow_rule."""
    governing = _opendds_topic_rules(context)
    if not governing:
        return ungoverned(context)
    for topic_rule in governing:
        if topic_rule.is_half_open:
            return opened(context, topic_rule)
    denied = set[Action]()
    for rule in context.rules:
        for action in _EITHER:
            for criteria in context.criteria(rule, action):
                if context.has_topic(criteria):
                    denied.add(action)
                    if rule.allow or len(denied) == len(_EITHER):
                        return _topic_ruled(context, rule, criteria)
    return by_default(context, None)


def opendds_endpoint(context: EvaluationContext) -> Decision:
    """check_create_datawriter and similar: any topic rule without access control suffices.

    It checks the times of the grant only if there is no such rule.
    """
    for rule in _opendds_topic_rules(context):
        if is_open(context, rule):
            return opened(context, rule)
    current = in_force(context)
    return by_rules(context) if current.allowed else current


def opendds_remote_participant(context: EvaluationContext) -> Decision:
    """check_remote_participant: any governance rule for the domain may open it."""
    for rule in context.domain_rules:
        if not rule.enable_join_access_control:
            return yes(f"join access control is off on domain {context.question.domain}", rule)
    return remote_participant(context)


def _opendds_topic_rules(context: EvaluationContext) -> list[TopicRule]:
    return [rule for domain_rule in context.domain_rules for rule in context.covering(domain_rule)]
