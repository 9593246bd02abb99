"""The checks of the standard: DDS-Security 1.1, table 63, in its order.

Each checks one question; `decide` calls them in sequence.
"""

from pqsec_pki.access import _expressions
from pqsec_pki.access.decision import Decision, no, yes
from pqsec_pki.access.interpretation import EvaluationContext
from pqsec_pki.access.question import Action, Question
from pqsec_pki.documents import Criteria, DefaultAction, PermissionRule, TopicRule

_MOST_SAID = 4
"""Most partitions that a sentence names: an endpoint may have a thousand."""
_VERBS = {Action.PUBLISH: "publish", Action.SUBSCRIBE: "subscribe to", Action.RELAY: "relay"}


def governed(context: EvaluationContext) -> Decision:
    """validate_local_permissions, 1: a governance rule for the domain (9.4.1.2.7)."""
    if not context.domain_rules:
        return no(f"no governance rule names domain {context.question.domain}")
    return yes(f"governance covers domain {context.question.domain}", context.domain_rules[0])


def in_force(context: EvaluationContext) -> Decision:
    """validate_local_permissions, 3: the grant is in force (9.4.1.3.2.2)."""
    grant = context.grant
    if context.interpretation.in_force(grant, context.question.now):
        return yes(f"grant '{grant.name}' is in force", grant)
    if context.question.now <= grant.not_before:
        return no(f"grant '{grant.name}' starts at {grant.not_before}", grant)
    return no(f"grant '{grant.name}' ended at {grant.not_after}", grant)


def own_participant(context: EvaluationContext) -> Decision:
    """check_create_participant: a topic without access control also suffices to join, for the
    own stack but not for peers."""
    for rule in context.domain_rules[:1]:
        for topic_rule in rule.topic_rules:
            if not (
                topic_rule.enable_read_access_control and topic_rule.enable_write_access_control
            ):
                return yes("governance has a topic that is open to all", topic_rule)
    return remote_participant(context)


def remote_participant(context: EvaluationContext) -> Decision:
    """check_remote_participant.

    An allow_rule for the domain suffices, even without topics. If there is none, the default
    of the grant decides, as in Cyclone DDS and OpenDDS (OMG issue DDSSEC12-85).
    """
    domain, grant = context.question.domain, context.grant
    # 1: is_access_protected is false.
    for governing in context.domain_rules[:1]:
        if not governing.enable_join_access_control:
            return yes(f"join access control is off on domain {domain}", governing)
    # 2: the handshake compares the plugin names in the permissions tokens.
    # 3: the grant has an allow rule for the domain.
    for rule in context.rules:
        if rule.allow:
            return yes(f"grant '{grant.name}' has an allow_rule for domain {domain}", rule)
    # 4: otherwise the default decides.
    if grant.default is DefaultAction.ALLOW:
        return yes(f"the default of grant '{grant.name}' is ALLOW", grant)
    return no(f"grant '{grant.name}' has no allow_rule for domain {domain}", grant)


def endpoint(context: EvaluationContext) -> Decision:
    """check_create_datawriter, check_create_datareader and the two for a peer's endpoint."""
    rule = next(context.topic_rules, None)
    if rule is None:
        return ungoverned(context)
    if is_open(context, rule):
        return opened(context, rule)
    return by_rules(context)


def by_rules(context: EvaluationContext) -> Decision:
    """The first rule for the domain whose criteria match decides, otherwise the default."""
    action, missed = context.question.action, None
    for rule in context.rules:
        for criteria in context.criteria(rule, action):
            if context.has_topic(criteria):
                if met(context, criteria, rule):
                    return ruled(context, rule, criteria)
                missed = missed or rule
    return by_default(context, missed)


def met(context: EvaluationContext, criteria: Criteria, rule: PermissionRule) -> bool:
    """Whether the partitions and data tags match these criteria."""
    interpretation = context.interpretation
    return interpretation.partitions_met(context, criteria, rule) and interpretation.tags_met(
        context, criteria, rule
    )


def ungoverned(context: EvaluationContext) -> Decision:
    """9.4.1.2.7: a topic that no rule covers cannot be used."""
    question = context.question
    return no(f"no topic rule of governance covers '{question.topic}' on domain {question.domain}")


def is_open(context: EvaluationContext, rule: TopicRule) -> bool:
    """Whether governance allows the action to every participant, whatever its permissions."""
    if context.question.action is Action.PUBLISH:
        return not rule.enable_write_access_control
    return not rule.enable_read_access_control


def opened(context: EvaluationContext, rule: TopicRule) -> Decision:
    asked = f"{said(context)}, whatever its permissions (topic rule '{rule.topic_expression}')"
    return yes(f"governance lets every participant {asked}", rule)


def ruled(context: EvaluationContext, rule: PermissionRule, criteria: Criteria | None) -> Decision:
    """The decision by a rule, whose `criteria` match."""
    by = f"{name_of(rule)} of grant '{context.grant.name}'"
    if rule.allow:
        return yes(f"an {by} lets it {said(context)}", rule, criteria)
    return no(f"a {by} forbids it to {said(context)}", rule, criteria)


def by_default(context: EvaluationContext, missed: PermissionRule | None) -> Decision:
    """The decision by the default; `missed` is a rule with the topic but other criteria."""
    grant = context.grant
    start = f"no rule of grant '{grant.name}' says whether it may {said(context)}"
    if missed:
        start += f" ({name_of(missed)} has the topic, but for other partitions or data tags)"
    decide = yes if grant.default is DefaultAction.ALLOW else no
    return decide(f"{start}, and its default is {grant.default}", grant)


def said(context: EvaluationContext) -> str:
    """The question as text: "publish 'rt/chatter' on domain 0"."""
    question = context.question
    where = f" in {_partitions(question.partitions)}" if any(question.partitions) else ""
    return f"{_VERBS[question.action]} '{question.topic}'{where} on domain {question.domain}"


def reason_for_several(reason: str, question: Question) -> str:
    """The reason of a decision about `question`, in words that fit all topics that share it."""
    topic = f"'{question.topic}'"
    return reason.replace(f"{_VERBS.get(question.action)} {topic}", "use them").replace(
        topic, "them"
    )


def name_of(rule: PermissionRule) -> str:
    return "allow_rule" if rule.allow else "deny_rule"


def _partitions(names: tuple[str, ...]) -> str:
    more = f" and {len(names) - _MOST_SAID} more" if len(names) > _MOST_SAID else ""
    words = ", ".join(map(_expressions.said, names[:_MOST_SAID]))
    return f"partition{'s' if len(names) > 1 else ''} {words}{more}"
