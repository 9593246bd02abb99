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
from pqsec_pki.access.question import Action
from pqsec_pki.access.reading import Case
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


def cyclonedds_topic(case: Case) -> Decision:
    """check_create_topic: before an endpoint there is a topic, and that is asked first.

    A rule for the domain that has the topic decides, be it for publishing or subscribing
    and in whatever partition: so a deny_rule for one partition denies the topic.
    """
    if case.question.topic in _CYCLONEDDS_BUILTIN:
        return _builtin(case)
    rule = next(case.topic_rules, None)
    if rule is None:
        return ungoverned(case)
    if _is_half_open(rule):
        return opened(case, rule)
    for each in case.rules:
        for criteria in (*each.publish, *each.subscribe):
            if case.has_topic(criteria):
                return _topic_ruled(case, each, criteria)
    return by_default(case, None)


def cyclonedds_endpoint(case: Case) -> Decision:
    """check_create_datawriter and its siblings: as the standard, but for some names."""
    if case.question.topic in _CYCLONEDDS_BUILTIN:
        return _builtin(case)
    return endpoint(case)


def _builtin(case: Case) -> Decision:
    """get_topic_sec_attributes: a topic with the name of a builtin one is open to all."""
    return yes(f"'{case.question.topic}' is a builtin topic of Cyclone DDS, open to all members")


def _topic_ruled(case: Case, rule: Rule, criteria: Criteria) -> Decision:
    if rule.allow:
        return ruled(case, rule, criteria)
    text = f"a deny_rule of grant '{case.grant.name}' names the topic '{case.question.topic}'"
    return no(f"{text}, which cannot even be created", rule, criteria)


def fastdds_own_participant(case: Case) -> Decision:
    """check_create_participant: any allow_rule will do, whatever its domain, and one must be.

    check_subject_name means to drop the rules for other domains, and drops them from a
    copy that it has emptied before.
    """
    return _fastdds_participant(case, case.grant.rules, "")


def fastdds_remote_participant(case: Case) -> Decision:
    """check_remote_participant: an allow_rule for the domain, never the default."""
    for rule in case.domain_rules[:1]:
        if not rule.enable_join_access_control:
            return yes(f"join access control is off on domain {case.question.domain}", rule)
    return _fastdds_participant(case, case.rules, f" for domain {case.question.domain}")


def _fastdds_participant(case: Case, rules: Iterable[Rule], where: str) -> Decision:
    for rule in rules:
        if rule.allow:
            return yes(f"grant '{case.grant.name}' has an allow_rule{where}", rule)
    return no(f"grant '{case.grant.name}' has no allow_rule{where}", case.grant)


def fastdds_own_endpoint(case: Case) -> Decision:
    """check_create_datawriter, check_create_datareader: the rules for all domains count."""
    action = case.question.action
    if action is Action.RELAY:
        return yes("a participant's own stack is never asked about relaying")
    return _fastdds_endpoint(case, case.grant.rules, (action,))


def fastdds_remote_endpoint(case: Case) -> Decision:
    """check_remote_datawriter, check_remote_datareader: a reader may be a relay's."""
    action = case.question.action
    actions = (action,) if action is Action.PUBLISH else (Action.SUBSCRIBE, Action.RELAY)
    return _fastdds_endpoint(case, case.rules, actions)


def _fastdds_endpoint(case: Case, rules: Iterable[Rule], actions: tuple[Action, ...]) -> Decision:
    """The first rule that has the topic decides; then partitions are looked at.

    Those of all its criteria for the action count together; a deny_rule denies in every
    partition. Where no rule has the topic it is denied: the default is never used.
    """
    open_to = next(case.topic_rules, None)
    if open_to is None:
        return ungoverned(case)
    if is_open(case, open_to):
        return opened(case, open_to)
    for rule in rules:
        for action in actions:
            criteria = case.criteria(rule, action)
            found = next((each for each in criteria if case.has_topic(each)), None)
            if found:
                return _fastdds_ruled(case, rule, found, criteria)
    text = f"no rule of grant '{case.grant.name}' says whether it may {said(case)}"
    return no(f"{text}, and Fast DDS does not look at its default", case.grant)


def _fastdds_ruled(
    case: Case, rule: Rule, found: Criteria, criteria: tuple[Criteria, ...]
) -> Decision:
    patterns = [each for one in criteria for each in one.partitions or ("",)]
    for partition in (case.question.partitions or ("",)) if rule.allow else ():
        if not any(case.reading.covers(pattern, partition) for pattern in patterns):
            text = f"{name_of(rule)} of grant '{case.grant.name}' has '{case.question.topic}'"
            return no(f"{text}, but not in partition '{partition}'", rule, found)
    return ruled(case, rule, found)


def opendds_own_participant(case: Case) -> Decision:
    """check_create_participant: yes only if something is open (OpenDDS issue 5007).

    With join access control on, and read and write access control for every topic, no
    participant can be made, whatever its permissions.
    """
    for rule in case.domain_rules:
        if not rule.enable_join_access_control:
            return yes(f"join access control is off on domain {case.question.domain}", rule)
        for topic_rule in rule.topic_rules:
            if _is_half_open(topic_rule):
                return yes("governance has a topic that is open to all", topic_rule)
    text = "OpenDDS makes no participant where governance controls joining and every topic"
    return no(text, case.domain_rules[0])


def opendds_topic(case: Case) -> Decision:
    """check_create_topic: not if both publishing and subscribing are denied before allowed."""
    governing = _opendds_topic_rules(case)
    if not governing:
        return ungoverned(case)
    for topic_rule in governing:
        if _is_half_open(topic_rule):
            return opened(case, topic_rule)
    denied = set[Action]()
    for rule in case.rules:
        for action in _EITHER:
            for criteria in case.criteria(rule, action):
                if case.has_topic(criteria):
                    denied.add(action)
                    if rule.allow or len(denied) == len(_EITHER):
                        return _topic_ruled(case, rule, criteria)
    return by_default(case, None)


def opendds_endpoint(case: Case) -> Decision:
    """check_create_datawriter and its siblings: any topic rule that is open opens.

    Only where none is are the times of the grant looked at.
    """
    for rule in _opendds_topic_rules(case):
        if is_open(case, rule):
            return opened(case, rule)
    current = in_force(case)
    return by_rules(case) if current.allowed else current


def opendds_remote_participant(case: Case) -> Decision:
    """check_remote_participant: any governance rule for the domain may open it."""
    for rule in case.domain_rules:
        if not rule.enable_join_access_control:
            return yes(f"join access control is off on domain {case.question.domain}", rule)
    return remote_participant(case)


def _opendds_topic_rules(case: Case) -> list[TopicRule]:
    return [rule for domain_rule in case.domain_rules for rule in case.covering(domain_rule)]


def _is_half_open(rule: TopicRule) -> bool:
    return not (rule.enable_read_access_control and rule.enable_write_access_control)
