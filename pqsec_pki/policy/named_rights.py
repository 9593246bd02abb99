"""Whether a participant may do what takes several topics, such as to serve a ROS 2 service."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import datetime

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access import (
    SPEC,
    Action,
    DocumentOwner,
    Interpretation,
    Question,
    Verdict,
    domains_named,
    topics_asked,
    topics_named,
)
from pqsec_pki.documents import ros
from pqsec_pki.policy.answers import DomainsAnswer, allows_each, answers_by_domain
from pqsec_pki.policy.participants import PolicyInput


@dataclass(frozen=True, slots=True)
class NamedRight:
    """Something that a participant may do, and what its endpoints need for it."""

    words: str
    """Such as `serve the service /reset`."""
    uses: tuple[tuple[Action, str | None], ...]
    """Actions with their DDS topic or pattern of topics; None for joining."""


@dataclass(frozen=True, slots=True)
class Use:
    """The answer for one topic, or one pattern of the rules, that the right needs."""

    topic: str | None
    """The topic or pattern in the rules; for a pattern, the question's topic is a sample of it."""
    answers: list[DomainsAnswer]

    def until(self, policy_input: PolicyInput) -> datetime | None:
        """The end of the right; None if it is not allowed, or has no end."""
        first = self.answers[0]
        own = policy_input.until(first.question, first.answer.interpretation)
        return own if first.allowed else None

    def to_json(self, policy_input: PolicyInput) -> dict[str, object]:
        """The answers: first what decides, then those of other domains."""
        first, *others = self.answers
        question = first.question
        return {
            "participant": policy_input.who,
            "subject": question.subject,
            "action": question.action.value,
            "topic": question.topic,
            "partitions": question.partitions,
            "data_tags": list(map("=".join, question.data_tags)),
            "at": question.now,
            "until": self.until(policy_input),
            "keys": policy_input.keys or None,
            "verified": policy_input.governance.verified and policy_input.permissions.verified,
            **first.to_json(policy_input),
            "elsewhere": [each.to_json(policy_input) for each in others],
        }


@dataclass(frozen=True, slots=True)
class RightAnswer:
    """Whether one participant has the right, with the answer for each topic."""

    policy_input: PolicyInput
    right: NamedRight
    uses: list[Use]
    allowed: bool
    """Whether all of it is allowed, on at least one domain."""
    by: tuple[str, ...]
    """The titles of the interpretations that must allow it."""

    @property
    def word(self) -> str:
        """`yes`; else what is not known of a topic, `crashes` or `readers differ`; else `no`."""
        if self.allowed:
            return Verdict.YES.value
        answers = (each.answer for use in self.uses for each in use.answers)
        return next((each.word for each in answers if not each.is_known), Verdict.NO.value)

    @property
    def yes_or_no(self) -> bool | None:
        """Whether it is allowed; None if that is not known."""
        return self.allowed if Verdict(self.word).is_known else None

    def different(self) -> list[str]:
        """The stacks that decide differently about at least one topic."""
        found = (
            other.interpretation.title
            for use in self.uses
            for each in use.answers
            for other in each.others
            if other.differs(each.answer)
        )
        return list(dict.fromkeys(found))

    def to_json(self) -> dict[str, object]:
        """The answers for all topics; `ros` is the topic in words of ROS 2."""
        return {
            "participant": self.policy_input.who,
            "right": self.right.words,
            "allowed": self.yes_or_no,
            "answer": self.word,
            "topics": [
                {
                    **each.to_json(self.policy_input),
                    "rule_topic": each.topic,
                    "ros": None if each.topic is None else ros.said(each.topic),
                }
                for each in self.uses
            ],
        }


def answer_right(
    policy_input: PolicyInput,
    right: NamedRight,
    question: Question,
    chosen: Sequence[Interpretation],
    *,
    everywhere: bool,
) -> RightAnswer:
    """The answer for all topics of the right; `question` has the domain, time and tags.

    A pattern is all topics and patterns of the participant's rules that it matches; if it matches
    none, one topic of its own. `chosen` and `everywhere` as in `answers_by_domain`.
    """
    own = replace(question, subject=policy_input.subject)
    asked = list(_questions(policy_input, right, own))
    uses = [
        Use(topic, answers_by_domain(policy_input, each, chosen, everywhere=everywhere))
        for topic, each in asked
    ]
    stretches = domains_named(policy_input.governance.value, policy_input.permissions.value)
    domains = [each.first for each in stretches] if everywhere else [question.domain]
    allowed = any(
        all(allows_each(policy_input, replace(each, domain=domain), chosen) for _, each in asked)
        for domain in domains
    )
    by = tuple(each.title for each in chosen or (SPEC,))
    return RightAnswer(policy_input, right, uses, allowed, by)


def _questions(
    policy_input: PolicyInput, right: NamedRight, question: Question
) -> Iterator[tuple[str | None, Question]]:
    owner = DocumentOwner(
        name=policy_input.who,
        subject=policy_input.subject,
        permissions=policy_input.permissions.value,
    )
    for action, topic in right.uses:
        if topic is None:
            yield None, replace(question, action=action, topic=None)
            continue
        asked = topics_asked([owner], [topic])
        if len(asked) > 1 and topic not in topics_named([owner]):
            asked.pop(topic, None)  # what no rule names
        for each, sample in asked.items():
            yield each, replace(question, action=action, topic=sample or each)
