"""What an interpretation of the documents consists of, and what a check receives."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import field
from datetime import datetime
from enum import StrEnum
from typing import TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access._expressions import Budget
from pqsec_pki.access._patterns import Covers
from pqsec_pki.access._subjects import IsFor
from pqsec_pki.access._witnesses import is_plain
from pqsec_pki.access.decision import Decision
from pqsec_pki.access.question import Action, Question
from pqsec_pki.documents import (
    Crash,
    Criteria,
    DomainRule,
    DomainSet,
    Governance,
    Grant,
    PermissionRule,
    Permissions,
    TopicRule,
)


class Viewpoint(StrEnum):
    """The stack that checks: the participant's own, or a peer's."""

    OWN = "own"
    PEER = "peer"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Interpretation:
    """How one stack understands the documents.

    The checks of `join` are made for each question, those of `use` for each question with a
    topic; all must allow. Both sides count: the own stack creates the endpoint, and peers
    match with it.
    """

    name: str
    """The value of `--as`: a stack, after `@` its version if a stack has several rows, and after
    `/` the locale of its matching if it is for that locale only."""
    title: str
    """The standard or stack, with the version that it was compared with."""
    covers: Covers
    """Whether a topic or partition pattern of permissions covers a name."""
    governs: Covers
    """Whether a topic_expression of governance covers a name."""
    is_for: IsFor
    includes: Callable[[DomainSet, int], bool]
    in_force: Callable[[Grant, datetime], bool]
    skips_grants_out_of_force: bool
    """Whether a later grant for the subject is used if the first is not in force."""
    knows_relay: bool
    partitions_met: "Callable[[EvaluationContext, Criteria, PermissionRule], bool]"
    tags_met: "Callable[[EvaluationContext, Criteria, PermissionRule], bool]"
    flaw: Callable[[Governance, Permissions], str]
    """Why the stack refuses these documents as a whole; empty if it does not."""
    builtin: frozenset[str] = frozenset()
    """Topics that are open to all because of their names."""
    locales: "tuple[Interpretation, ...]" = ()
    """If its matching follows the locale of the process: as it is in C and in C.UTF-8. This row is
    as in C, which is the locale of a process that never called setlocale."""
    join: "dict[Viewpoint, tuple[Check, ...]]"
    use: "dict[Viewpoint, tuple[Check, ...]]"

    @property
    def stack(self) -> str:
        """The name of the stack, or of the standard."""
        return self.name.partition("/")[0].partition("@")[0]

    @property
    def version(self) -> str:
        """The versions of the stack for which it holds, such as 11.0; empty if it has one row."""
        return self.name.partition("/")[0].partition("@")[2]

    @property
    def locale(self) -> str:
        """The locale for which alone it holds; empty for all."""
        return self.name.partition("/")[2]

    def crash_in(self, crashes: Iterable[Crash]) -> Crash | None:
        """The first of them that crashes the stack."""
        ours = (each for each in crashes if each.shape.crashes(self.stack, self.version))
        return next(ours, None)

    def grant_for(self, permissions: Permissions, question: Question) -> Grant | None:
        """The grant that applies to the subject, if there is one."""
        own = [each for each in permissions.grants if self.is_for(_named(each), question.subject)]
        if self.skips_grants_out_of_force:
            own.sort(key=lambda each: not self.in_force(each, question.now))
        return own[0] if own else None


def _named(grant: Grant) -> str:
    """Its subject as its document has it."""
    return grant.written.subject_name if grant.spelling else grant.subject_name


@dataclass(slots=True, kw_only=True, eq=False)  # not frozen: a fleet has thousands for each answer
class EvaluationContext:
    """A question, and what an interpretation finds for it in the documents."""

    question: Question
    interpretation: Interpretation
    domain_rules: tuple[DomainRule, ...]
    """The domain rules that name the domain; the first one governs it."""
    grant: Grant
    """The grant that applies to the subject."""
    budget: Budget = field(default_factory=Budget)
    """Steps that are left for comparing partitions."""

    @property
    def topic_rules(self) -> Iterator[TopicRule]:
        """The topic rules of the first domain rule that cover the topic."""
        for rule in self.domain_rules[:1]:
            yield from self.covering(rule)

    def covering(self, domain_rule: DomainRule) -> Iterator[TopicRule]:
        """The topic rules that cover the topic, in order."""
        for rule in domain_rule.topic_rules:
            if self.interpretation.governs(rule.topic_expression, self.question.topic or ""):
                yield rule

    @property
    def rules(self) -> Iterator[PermissionRule]:
        """The rules of the grant for the domain, in order."""
        for rule in self.grant.rules:
            if self.interpretation.includes(rule.domains, self.question.domain):
                yield rule

    def criteria(self, rule: PermissionRule, action: Action) -> tuple[Criteria, ...]:
        """The criteria of the rule for an action."""
        match action:
            case Action.PUBLISH:
                return rule.publish
            case Action.SUBSCRIBE:
                return rule.subscribe
            case _:
                return rule.relay if self.interpretation.knows_relay else ()

    def has_topic(self, criteria: Criteria) -> bool:
        """Whether one of its patterns covers the topic."""
        topic = self.question.topic or ""
        if topic in criteria.topics and is_plain(topic):
            return True  # so with nearly all rights that a participant uses
        return any(self.interpretation.covers(pattern, topic) for pattern in criteria.topics)


Check: TypeAlias = Callable[[EvaluationContext], Decision]
