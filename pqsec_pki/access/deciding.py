"""Decide a question by governance and permissions."""

from collections.abc import Iterable, Iterator
from dataclasses import field, replace
from datetime import datetime
from itertools import product
from typing import TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access.decision import Decision, Protection, crashes, no, readers_differ
from pqsec_pki.access.interpretation import Check, EvaluationContext, Interpretation, Viewpoint
from pqsec_pki.access.interpretations import SPEC
from pqsec_pki.access.question import Action, Question
from pqsec_pki.documents import (
    DomainRule,
    Governance,
    Grant,
    Kind,
    Permissions,
    governance_crashes,
    grant_crashes,
    parse_subject,
)

_DOUBT = "comparing its partitions with those of the rules takes too many steps, so it is denied"

_Found: TypeAlias = tuple[tuple[DomainRule, ...], Grant]
"""The domain rules for a domain, and the grant for a subject."""


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
    the last one. If the documents crash the stack, or readers differ about them, that is the
    answer. The time is linear in the documents. Use Policy for many questions about
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
    _refusal: Decision | None = field(init=False, repr=False)
    """The answer to every question, if the documents as a whole give one."""
    _found: dict[tuple[str, int, datetime], _Found | Decision] = field(
        default_factory=dict, init=False, repr=False
    )

    _names: set[str] = field(default_factory=set, init=False, repr=False)
    """Subjects that are names."""

    def __post_init__(self) -> None:
        self._refusal = self._refused()

    def decide(self, question: Question, *, by: Viewpoint | None = None) -> Decision:
        """Decide like the function `decide`."""
        context = self._context(question)
        if isinstance(context, Decision):
            return context
        decision = replace(_checked(context, by), protection=_protection(context))
        if context.budget.spent and not decision.allowed:
            return replace(decision, reason=f"{_DOUBT}: {decision.reason}")
        return decision

    def grant(self, join: Question) -> Grant | None:
        """The grant that applies to the subject, on every domain; None if there is none."""
        context = self._context(join)
        return None if isinstance(context, Decision) else context.grant

    def unanswered(self, join: Question) -> Decision | None:
        """The decision about all questions of the subject, if it is neither yes nor no."""
        context = self._context(join)
        if isinstance(context, Decision) and not context.verdict.is_known:
            return context
        return None

    def joins(self, join: Question) -> bool:
        """Whether `decide` allows it to join."""
        context = self._context(join)
        return not isinstance(context, Decision) and _checked(context, None).allowed

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
            if not isinstance(asked, Decision) and all(check(asked).allowed for check in checks):
                yield action, topic

    def _context(self, question: Question) -> EvaluationContext | Decision:
        """The decision about every such question if the checks are not reached."""
        key = question.subject, question.domain, question.now
        if key not in self._found:
            if question.subject not in self._names:
                parse_subject(question.subject)
                self._names.add(question.subject)
            self._found[key] = self._refusal or self._find(question)
        found = self._found[key]
        if isinstance(found, Decision):
            return found
        rules, grant = found
        return EvaluationContext(
            question=question, interpretation=self.interpretation, domain_rules=rules, grant=grant
        )

    def _refused(self) -> Decision | None:
        documents = ((Kind.GOVERNANCE, self.governance), (Kind.PERMISSIONS, self.permissions))
        for kind, document in documents:
            if document.markup:
                return readers_differ(kind, document.markup[0])
        interpretation = self.interpretation
        if crash := interpretation.crash_in(governance_crashes(self.governance.domain_rules)):
            return crashes(crash, interpretation.title)
        flaw = interpretation.flaw(self.governance, self.permissions)
        return no(flaw) if flaw else None

    def _find(self, question: Question) -> _Found | Decision:
        grant = self.interpretation.grant_for(self.permissions, question)
        if grant is None:
            return no(f"no grant is for {question.subject}")
        if crash := self.interpretation.crash_in(grant_crashes([grant])):
            return crashes(crash, self.interpretation.title)
        includes, domain = self.interpretation.includes, question.domain
        rules = [rule for rule in self.governance.domain_rules if includes(rule.domains, domain)]
        return tuple(rules), grant


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
