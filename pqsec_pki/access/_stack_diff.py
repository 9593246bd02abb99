"""Changes for a stack only: its answers differ, but those of the standard are the same."""

from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from itertools import islice, product

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access._rights import Dimensions
from pqsec_pki.access.deciding import InterpretedPolicy
from pqsec_pki.access.decision import Verdict
from pqsec_pki.access.interpretation import Interpretation
from pqsec_pki.access.interpretations import INTERPRETATIONS, SPEC, names_of
from pqsec_pki.access.question import MAX_NAME, Action, Question
from pqsec_pki.documents import MAX_DOMAIN, DomainRange, DomainSet, Governance, Grant, Permissions

MOST_ASKED = 2_000
"""Most questions for a pair of documents, so that it takes a second."""
MOST_WORK = 50_000
"""Most questions times rules, for the same reason."""

_BEGIN, _THEN, _END = (datetime(year, 1, 1, tzinfo=UTC) for year in (2000, 2001, 2002))
_DOMAINS = DomainSet(parts=(DomainRange(first=0, last=MAX_DOMAIN),))


@dataclass(frozen=True, slots=True)
class StackChange:
    """A question whose answer changed for a stack, but not for the standard."""

    name: str
    """As a value of `--as`: without a version if it changed for all versions."""
    titles: tuple[str, ...]
    """The stack with each version for which it changed."""
    question: Question
    before: Verdict
    after: Verdict


def stack_changes(old: Grant, new: Grant, dimensions: Dimensions) -> Iterator[StackChange]:
    """For each stack the first question that it now allows, denies, or crashes on.

    Versions of a stack for which the same answer changed are told together.
    """
    rules = len(old.rules) + len(new.rules) + 1
    questions = list(
        islice(_questions(new.subject_name, dimensions), min(MOST_ASKED, MOST_WORK // rules))
    )
    alike = [
        each for each, (before, after) in _answers(old, new, questions, SPEC) if before == after
    ]
    found: dict[tuple[str, Question, Verdict, Verdict], list[Interpretation]] = {}
    for interpretation in INTERPRETATIONS:
        seen = set[Verdict]()
        for question, (before, after) in _answers(old, new, alike, interpretation):
            if before != after and after not in seen:
                seen.add(after)
                key = interpretation.stack, question, before, after
                found.setdefault(key, []).append(interpretation)
    for (_, question, before, after), rows in found.items():
        titles = tuple(row.title for row in rows)
        yield StackChange(" and ".join(names_of(rows)), titles, question, before, after)


def _answers(
    old: Grant, new: Grant, questions: list[Question], interpretation: Interpretation
) -> Iterator[tuple[Question, tuple[Verdict, Verdict]]]:
    governance = Governance.protected(_DOMAINS)
    before, after = (
        InterpretedPolicy(governance, Permissions(grants=(_in_force(grant),)), interpretation)
        for grant in (old, new)
    )
    for question in questions:
        yield question, (before.decide(question).verdict, after.decide(question).verdict)


def _questions(subject: str, dimensions: Dimensions) -> Iterator[Question]:
    join = Question(subject=subject, domain=0, action=Action.JOIN, now=_THEN)
    domains = [each.first for each in dimensions.domains if each.first <= MAX_DOMAIN]
    yield from (replace(join, domain=domain) for domain in domains)
    names = [name for name in dimensions.topics.names if len(name) <= MAX_NAME]
    actions = (Action.PUBLISH, Action.SUBSCRIBE)
    for partitions, domain, topic, action in product(
        dimensions.partition_sets.tried, domains, names, actions
    ):
        if all(len(name) <= MAX_NAME for name in partitions):
            yield replace(join, domain=domain, action=action, topic=topic, partitions=partitions)


def _in_force(grant: Grant) -> Grant:
    return replace(grant, not_before=_BEGIN, not_after=_END)
