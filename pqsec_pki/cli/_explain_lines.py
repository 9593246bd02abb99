"""How explain prints its answers: one topic in full, several with one line for each."""

from collections.abc import Iterator

from pqsec_pki._times import said
from pqsec_pki.access import Verdict, reason_for_several
from pqsec_pki.cli._printing import printable
from pqsec_pki.documents import ros
from pqsec_pki.policy import Answer, DomainsAnswer, PolicyInput, RightAnswer, Use


def right_lines(found: RightAnswer) -> Iterator[str]:
    """One line for each topic; those that are denied for one reason are together, before it."""
    word = found.word.upper()
    ends = [end for use in found.uses if (end := use.until(found.policy_input))]
    until = f", until {said(min(ends))}" if found.allowed and ends else ""
    what = f"{printable(found.policy_input.who)}: {printable(found.right.words)}"
    yield f"{word:<4}  {what}{until}, by {', '.join(found.by)}"
    together = dict[str, list[tuple[Use, DomainsAnswer]]]()
    for use in found.uses:
        for each in use.answers:
            together.setdefault(_why_not(each), []).append((use, each))
    for reason, rows in together.items():
        yield from (_use_line(found.policy_input, use, each) for use, each in rows)
        if len(rows) > 1 and reason:
            yield f"           for these {len(rows)}: {printable(reason)}"
        elif reason:
            yield f"           {printable(rows[0][1].answer.decision.reason)}"
    if titles := found.different():
        alone = "one topic" if len(found.uses) > 1 else "this participant alone"
        yield f"      {', '.join(titles)}: decided differently, ask for {alone}"


def _why_not(each: DomainsAnswer) -> str:
    """The reason in words that fit several topics; empty if it is allowed."""
    return "" if each.allowed else reason_for_several(each.answer.decision.reason, each.question)


def _use_line(policy_input: PolicyInput, use: Use, each: DomainsAnswer) -> str:
    answer, question = each.answer, each.question
    what = "join"
    if use.topic is not None:
        what = f"{question.action} {printable(ros.said(use.topic))}"
        if question.topic != use.topic:
            what += f" (pattern, as for {printable(question.topic or '')})"
    place = policy_input.place(answer.decision)
    where = f"  {printable(str(place[0]))}:{place[1]}" if place else ""
    return f"      {answer.word:<4} {what}, {each.where}{where}"


def lines_of(policy_input: PolicyInput, finding: DomainsAnswer) -> Iterator[str]:
    """The answer for one topic in full: reason, place, protection, and what stacks decide."""
    question, answer, others = finding.question, finding.answer, finding.others
    what = "join" if question.topic is None else f"{question.action} {printable(question.topic)}"
    title = f"{printable(policy_input.who)}: {what}, {finding.where}"
    yield f"{answer.word.upper():<4}  {title}, by {answer.interpretation.title}"
    yield from _why(policy_input, answer, "      ")
    until = policy_input.until(question, answer.interpretation) if finding.allowed else None
    if until:
        keys = f", keys {policy_input.keys}" if policy_input.keys else ""
        yield f"      until       {said(until)}{keys}"
    for number, word in enumerate(answer.protection):
        yield f"{'' if number else '      protected':<17} {word}"
    if others:
        yield from _compared(policy_input, answer, others)


def _compared(policy_input: PolicyInput, answer: Answer, others: list[Answer]) -> Iterator[str]:
    alike = [other.interpretation.title for other in others if not other.differs(answer)]
    if alike and answer.decision.verdict is not Verdict.READERS_DIFFER:
        yield f"same  {', '.join(alike)}"
    for other in others:
        if other.differs(answer):
            different = " decides differently" if other.is_known else ""
            yield f"{other.word.upper():<4}  {other.interpretation.title}{different}"
            yield from _why(policy_input, other, "      ")
        elif other.disagreement:
            yield f"note  {other.interpretation.title}: {other.disagreement}"
        if other.hazard:
            yield f"note  {other.interpretation.title}: {other.hazard}"


def _why(policy_input: PolicyInput, answer: Answer, indent: str) -> Iterator[str]:
    disagreement = f"; {answer.disagreement}" if answer.disagreement else ""
    yield f"{indent}{printable(answer.decision.reason)}{disagreement}"
    if place := policy_input.place(answer.decision):
        criteria = policy_input.criteria_line(answer.decision)
        topics = f" (its topics from line {criteria})" if criteria else ""
        yield f"{indent}{printable(str(place[0]))}:{place[1]}{topics}"
