"""Decide a question by governance and permissions."""

from collections.abc import Iterable, Iterator
from dataclasses import field, replace
from datetime import datetime
from itertools import product

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access.decision import Decision, Protection, no
from pqsec_pki.access.interpretation import Check, EvaluationContext, Interpretation, Viewpoint
from pqsec_pki.access.interpretations import SPEC
from pqsec_pki.access.question import Action, Question
from pqsec_pki.documents import DomainRule, Governance, Grant, Permissions, parse_subject

_DOUBT = "comparing its partitions with those of the rules takes too many steps, so it is denied"


def decide(
    governance: Governance,
    permissions: Permissions,
    question: Question,
    interpretation: Interpretation = SPEC,
    *,
    by: Viewpoint | None = None,
) -> Decision:
    """Whether `interpretation` allows what `question` asks, in a running system.

    The participant's own stack and its peers' stacks must both allow it to join, and then to
    use the topic; `by` checks only one side. The first check that denies decides, otherwise
    the last one. The time is linear in the documents. Use Policy for many questions about
    the same documents.

    MalformedError if the subject is not a name.
    """
    return InterpretedPolicy(governance, permissions, interpretation).decide(question, by=by)


@dataclass(slots=True)
class InterpretedPolicy:
    """Two documents and an interpretation, for many questions."""

    governance: Governance
    permissions: Permissions
    interpretation: Interpretation = SPEC
    _flaw: str = field(init=False, repr=False)
    _found: dict[tuple[str, int, datetime], tuple[tuple[DomainRule, ...], Grant | None]] = field(
        default_factory=dict, init=False, repr=False
    )

    _names: set[str] = field(default_factory=set, init=False, repr=False)
    """Subjects that are names."""

    def __post_init__(self) -> None:
        self._flaw = self.interpretation.flaw(self.governance, self.permissions)

    def decide(self, question: Question, *, by: Viewpoint | None = None) -> Decision:
        """Decide like the function `decide`."""
        context = self._context(question)
        if context is None:
            return no(self._flaw or f"no grant is for {question.subject}")
        decision = replace(_checked(context, by), protection=_protection(context))
        if context.budget.spent and not decision.allowed:
            return replace(decision, reason=f"{_DOUBT}: {decision.reason}")
        return decision

    def grant(self, join: Question) -> Grant | None:
        """The grant that applies to the subject, on every domain; None if there is none."""
        context = self._context(join)
        return context.grant if context else None

    def joins(self, join: Question) -> bool:
        """Whether `decide` allows it to join."""
        context = self._context(join)
        return context is not None and _checked(context, None).allowed

    def uses(self, join: Question, topics: Iterable[str]) -> Iterator[tuple[Action, str]]:
        """The topics that `decide` allows it to publish or subscribe to, each with the action.

        `join` asks whether the participant may join, and `joins` allows it; its partitions are
        those of the endpoint.
        """
        use = self.interpretation.use
        checks = tuple(dict.fromkeys(check for side in Viewpoint for check in use[side]))
        for topic, action in product(topics, (Action.PUBLISH, Action.SUBSCRIBE)):
            question = replace(join, action=action, topic=topic)
            asked = self._context(question)
            if asked and all(check(asked).allowed for check in checks):
                yield action, topic

    def _context(self, question: Question) -> EvaluationContext | None:
        """None if no question is allowed: the documents have a flaw, or no grant is for it."""
        key = question.subject, question.domain, question.now
        if key not in self._found:
            if question.subject not in self._names:
                parse_subject(question.subject)
                self._names.add(question.subject)
            self._found[key] = ((), None) if self._flaw else self._find(question)
        rules, grant = self._found[key]
        if grant is None:
            return None
        return EvaluationContext(
            question=question, interpretation=self.interpretation, domain_rules=rules, grant=grant
        )

    def _find(self, question: Question) -> tuple[tuple[DomainRule, ...], Grant | None]:
        includes, domain = self.interpretation.includes, question.domain
        rules = [rule for rule in self.governance.domain_rules if includes(rule.domains, domain)]
        return tuple(rules), self.interpretation.grant_for(self.permissions, question)


def _checked(context: EvaluationContext, by: Viewpoint | None) -> Decision:
    for check in dict.fromkeys(_checks(context, by)):
        decision = check(context)
        if not decision.allowed:
            break
    return decision


def _checks(context: EvaluationContext, by: Viewpoint | None) -> Iterator[Check]:
    sides = [by] if by else list(Viewpoint)
    for side in sides:
        yield from context.interpretation.join[side]
    for side in sides if context.question.action is not Action.JOIN else ():
        yield from context.interpretation.use[side]


def _protection(context: EvaluationContext) -> Protection | None:
    if not context.domain_rules:
        return None
    topic_rule = next(context.topic_rules, None) if context.question.topic else None
    return Protection.of(context.domain_rules[0], topic_rule)
