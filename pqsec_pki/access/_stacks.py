"""The checks that stacks make otherwise than the standard.

Cyclone DDS 0.10.2 and Fast DDS 2.9.1 were asked in all of this, through their plugins;
OpenDDS 3.34 was read, and its access control run.
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
from pqsec_pki.documents import Criteria, Rule, TopicRule

_EITHER = (Action.PUBLISH, Action.SUBSCRIBE)
_CYCLONEDDS_BUILTIN = {
    f"DCPS{name}"
    for name in (
        *("Participant", "Publication", "Subscription", "Topic", "ParticipantMessage"),
        *("TypeLookupRequest", "TypeLookupReply", "ParticipantsSecure", "PublicationsSecure"),
        *("SubscriptionsSecure", "ParticipantMessageSecure", "ParticipantStatelessMessage"),
        "ParticipantVolatileMessageSecure",
    )
}


def cyclonedds_topic(context: EvaluationContext) -> Decision:
    """check_create_topic: before an endpoint there is a topic, and that is asked first.

    A rule for the domain that has the topic decides, be it for publishing or subscribing
    and in whatever partition: so a deny_rule for one partition denies the topic.
    """
    if context.question.topic in _CYCLONEDDS_BUILTIN:
        return _builtin(context)
    rule = next(context.topic_rules, None)
    if rule is None:
        return ungoverned(context)
    if _is_half_open(rule):
        return opened(context, rule)
    for each in context.rules:
        for criteria in (*each.publish, *each.subscribe):
            if context.has_topic(criteria):
                return _topic_ruled(context, each, criteria)
    return by_default(context, None)


def cyclonedds_endpoint(context: EvaluationContext) -> Decision:
    """check_create_datawriter and its siblings: as the standard, but for some names."""
    if context.question.topic in _CYCLONEDDS_BUILTIN:
        return _builtin(context)
    return endpoint(context)


def _builtin(context: EvaluationContext) -> Decision:
    """get_topic_sec_attributes: a topic with the name of a builtin one is open to all."""
    return yes(f"'{context.question.topic}' is a builtin topic of Cyclone DDS, open to all members")


def _topic_ruled(context: EvaluationContext, rule: Rule, criteria: Criteria) -> Decision:
    if rule.allow:
        return ruled(context, rule, criteria)
    text = f"a deny_rule of grant '{context.grant.name}' names the topic '{context.question.topic}'"
    return no(f"{text}, which cannot even be created", rule, criteria)


def fastdds_own_participant(context: EvaluationContext) -> Decision:
    """check_create_participant: any allow_rule will do, whatever its domain, and one must be.

    check_subject_name means to drop the rules for other domains, and drops them from a
    copy that it has emptied before.
    """
    return _fastdds_participant(context, context.grant.rules, "")


def fastdds_remote_participant(context: EvaluationContext) -> Decision:
    """check_remote_participant: an allow_rule for the domain, never the default."""
    for rule in context.domain_rules[:1]:
        if not rule.enable_join_access_control:
            return yes(f"join access control is off on domain {context.question.domain}", rule)
    return _fastdds_participant(context, context.rules, f" for domain {context.question.domain}")


def _fastdds_participant(context: EvaluationContext, rules: Iterable[Rule], where: str) -> Decision:
    for rule in rules:
        if rule.allow:
            return yes(f"grant '{context.grant.name}' has an allow_rule{where}", rule)
    return no(f"grant '{context.grant.name}' has no allow_rule{where}", context.grant)


def fastdds_own_endpoint(context: EvaluationContext) -> Decision:
    """check_create_datawriter, check_create_datareader: the rules for all domains count."""
    action = context.question.action
    if action is Action.RELAY:
        return yes("a participant's own stack is never asked about relaying")
    return _fastdds_endpoint(context, context.grant.rules, (action,))


def fastdds_remote_endpoint(context: EvaluationContext) -> Decision:
    """check_remote_datawriter, check_remote_datareader: a reader may be a relay's."""
    action = context.question.action
    actions = (action,) if action is Action.PUBLISH else (Action.SUBSCRIBE, Action.RELAY)
    return _fastdds_endpoint(context, context.rules, actions)


def _fastdds_endpoint(
    context: EvaluationContext, rules: Iterable[Rule], actions: tuple[Action, ...]
) -> Decision:
    """The first rule that has the topic decides; then partitions are looked at.

    Those of all its criteria for the action count together; a deny_rule denies in every
    partition. Where no rule has the topic it is denied: the default is never used.
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
    context: EvaluationContext, rule: Rule, found: Criteria, criteria: tuple[Criteria, ...]
) -> Decision:
    patterns = [each for one in criteria for each in one.partitions or ("",)]
    for partition in (context.question.partitions or ("",)) if rule.allow else ():
        if not any(context.interpretation.covers(pattern, partition) for pattern in patterns):
            text = f"{name_of(rule)} of grant '{context.grant.name}' has '{context.question.topic}'"
            return no(f"{text}, but not in partition '{partition}'", rule, found)
    return ruled(context, rule, found)


def opendds_own_participant(context: EvaluationContext) -> Decision:
    """check_create_participant: yes only if something is open (OpenDDS issue 5007).

    With join access control on, and read and write access control for every topic, no
    participant can be made, whatever its permissions.
    """
    for rule in context.domain_rules:
        if not rule.enable_join_access_control:
            return yes(f"join access control is off on domain {context.question.domain}", rule)
        for topic_rule in rule.topic_rules:
            if _is_half_open(topic_rule):
                return yes("governance has a topic that is open to all", topic_rule)
    text = "OpenDDS makes no participant where governance controls joining and every topic"
    return no(text, context.domain_rules[0])


def opendds_topic(context: EvaluationContext) -> Decision:
    """check_create_topic: not if both publishing and subscribing are denied before allowed."""
    governing = _opendds_topic_rules(context)
    if not governing:
        return ungoverned(context)
    for topic_rule in governing:
        if _is_half_open(topic_rule):
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
    """check_create_datawriter and its siblings: any topic rule that is open opens.

    Only where none is are the times of the grant looked at.
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


def _is_half_open(rule: TopicRule) -> bool:
    return not (rule.enable_read_access_control and rule.enable_write_access_control)
