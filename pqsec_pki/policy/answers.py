"""The answer of each stack to one access question, on each domain."""

from collections.abc import Sequence
from dataclasses import replace
from datetime import timedelta

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access import (
    INTERPRETATIONS,
    SPEC,
    Action,
    Decision,
    Interpretation,
    InterpretedPolicy,
    Question,
    Viewpoint,
    domain_set,
    domains_named,
)
from pqsec_pki.documents import DomainRange, DomainSet, Grant
from pqsec_pki.policy.participants import PolicyInput
from pqsec_pki.stacks import Stack

_MAX_UTC_OFFSET = timedelta(hours=14)
"""The largest difference between a local time and UTC."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """The answer by one interpretation of the documents."""

    interpretation: Interpretation
    decision: Decision
    own: bool
    """Whether the participant's own stack allows it."""
    peers: bool
    """Whether its peers allow it, if they run the same stack."""
    hazard: str = ""

    @property
    def word(self) -> str:
        """`yes`, `no`, `crashes` or `readers differ`."""
        return self.decision.verdict.value

    @property
    def is_known(self) -> bool:
        """Whether it is yes or no."""
        return self.decision.verdict.is_known

    @property
    def disagreement(self) -> str:
        """How the two sides differ; empty if they agree."""
        if self.own == self.peers:
            return ""
        if self.own:
            return "its own stack would allow it, its peers refuse"
        return "its peers would accept it, its own stack refuses"

    @property
    def protection(self) -> tuple[str, ...]:
        """What the governance requires for it, in words; empty if it is denied."""
        protection = self.decision.protection
        return tuple(protection.words) if protection and self.decision.allowed else ()

    def to_json(self, policy_input: PolicyInput) -> dict[str, object]:
        """With the place of the rule that decided."""
        place = policy_input.place(self.decision)
        return {
            "as": self.interpretation.name,
            "allowed": self.decision.yes_or_no,
            "answer": self.word,
            "reason": self.decision.reason,
            "file": str(place[0]) if place else None,
            "line": place[1] if place else None,
            "criteria_line": policy_input.criteria_line(self.decision),
            "own_stack": self.own if self.is_known else None,
            "peers": self.peers if self.is_known else None,
            "hazard": self.hazard or None,
        }

    def differs(self, other: "Answer") -> bool:
        """Whether their verdicts differ."""
        return self.decision.verdict is not other.decision.verdict


def answer_of(
    policy_input: PolicyInput, question: Question, interpretation: Interpretation
) -> Answer:
    """The answer by that interpretation, and of each side of its stack."""
    policy = InterpretedPolicy(
        policy_input.governance.value, policy_input.permissions.value, interpretation
    )
    return Answer(
        interpretation=interpretation,
        decision=policy.decide(question),
        own=policy.decide(question, by=Viewpoint.OWN).allowed,
        peers=policy.decide(question, by=Viewpoint.PEER).allowed,
        hazard=_zone_hazard(
            interpretation.grant_for(policy_input.permissions.value, question), question
        )
        if interpretation.stack == Stack.FASTDDS
        else "",
    )


def _zone_hazard(grant: Grant | None, question: Question) -> str:
    """All versions of Fast DDS read the times of a grant as local time (measured)."""
    for edge in (grant.not_before, grant.not_after) if grant else ():
        if abs(edge - question.now) < _MAX_UTC_OFFSET:
            return (
                "it reads the times of a grant as local time, and this one begins or ends within"
                f" {_MAX_UTC_OFFSET.seconds // 3600} hours: outside UTC it may decide differently"
            )
    return ""


@dataclass(frozen=True, slots=True, kw_only=True)
class DomainsAnswer:
    """One answer that holds on several domains; `question` is for the first of them."""

    question: Question
    answer: Answer
    others: list[Answer]
    """Answers by other interpretations."""
    joins: bool
    domains: DomainSet

    @property
    def allowed(self) -> bool:
        """Whether it is allowed."""
        return self.answer.decision.allowed

    @property
    def where(self) -> str:
        """Such as `domain 0` or `domains 0-3,5`."""
        parts = self.domains.parts
        one = len(parts) == 1 and isinstance(parts[0], int)
        return f"domain{'' if one else 's'} {self.domains}"

    def to_json(self, policy_input: PolicyInput) -> dict[str, object]:
        """The answer, and those of the other interpretations."""
        return {
            "domain": self.question.domain,
            "domains": str(self.domains),
            **self.answer.to_json(policy_input),
            "protection": list(self.answer.protection),
            "others": [
                other.to_json(policy_input) | {"differs": other.differs(self.answer)}
                for other in self.others
            ],
        }

    def merge_key(self, policy_input: PolicyInput) -> object:
        """A key: equal where the same parts of the documents decide, by each interpretation."""
        answers = tuple(
            (
                each.decision.verdict,
                policy_input.place(each.decision),
                each.disagreement,
                each.hazard,
            )
            for each in (self.answer, *self.others)
        )
        return answers, self.joins, self.answer.decision.protection


def answers_by_domain(
    policy_input: PolicyInput,
    question: Question,
    chosen: Sequence[Interpretation],
    *,
    everywhere: bool,
) -> list[DomainsAnswer]:
    """The answers on all domains that the documents name, or on that of the question.

    Allowed ones come first. By the `chosen` interpretations, the versions of a stack: allowed if
    each allows it. Without any, by the standard, with all others.
    """
    if not everywhere:
        return [_answered(policy_input, question, chosen, DomainSet(parts=(question.domain,)))]
    found: dict[object, list[tuple[DomainRange, DomainsAnswer]]] = {}
    for stretch in domains_named(policy_input.governance.value, policy_input.permissions.value):
        here = replace(question, domain=stretch.first)
        each = _answered(policy_input, here, chosen, DomainSet(parts=(stretch,)))
        found.setdefault(each.merge_key(policy_input), []).append((stretch, each))
    merged = [
        replace(alike[0][1], domains=domain_set([stretch for stretch, _ in alike]))
        for alike in found.values()
    ]
    return sorted(merged, key=lambda each: (not each.allowed, not each.joins))


def _answered(
    policy_input: PolicyInput,
    question: Question,
    chosen: Sequence[Interpretation],
    domains: DomainSet,
) -> DomainsAnswer:
    answers = [
        answer
        for each in chosen or INTERPRETATIONS
        for answer in _in_locales(policy_input, question, each)
    ]
    denials = (each for each in answers if not each.decision.allowed)
    answer = next(denials, answers[0]) if chosen else answers[0]
    join = replace(question, action=Action.JOIN, topic=None)
    return DomainsAnswer(
        question=question,
        answer=answer,
        others=[each for each in answers if each is not answer],
        joins=allows_each(policy_input, join, chosen),
        domains=domains,
    )


def _in_locales(
    policy_input: PolicyInput, question: Question, interpretation: Interpretation
) -> list[Answer]:
    """The answer; those in C and in C.UTF-8 if it depends on the locale."""
    every = interpretation.locales or (interpretation,)
    answers = [answer_of(policy_input, question, each) for each in every]
    if any(each.differs(answers[0]) for each in answers):
        return answers
    return [replace(answers[0], interpretation=interpretation)]


def allows_each(
    policy_input: PolicyInput, question: Question, chosen: Sequence[Interpretation]
) -> bool:
    """Whether each of the chosen interpretations, or without any the standard, allows it.

    A chosen one in each locale, the standard as in C.
    """
    every = [row for each in chosen for row in each.locales or (each,)] or [SPEC]
    answers = (answer_of(policy_input, question, each) for each in every)
    return all(each.decision.allowed for each in answers)
