"""Explains why a trial failed: the stacks' messages, with cause and remedy."""

from collections.abc import Iterator, Sequence

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import shown
from pqsec_pki.trial.peer import Act, PeerOutcome
from pqsec_pki.trial.words import words
from pqsec_pki.vendors import MessageKind, Recognised, fit_for_a_command, recognise

_MOST = 3
"""Messages of one participant; the first ones matter most."""
_BAD_TOPIC = "topic: Bad Parameter"
"""Cyclone DDS's message for a topic with other characters than letters, digits, / and _."""
_LONGEST = 300
"""Characters of an unknown message that are shown."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LogFinding:
    """A message of participants or their stacks, with its cause and remedy."""

    participants: tuple[str, ...]
    said: str
    cause: str | None
    """None for an unknown message."""
    remedy: str | None


def findings(
    outcomes: Sequence[tuple[PeerOutcome, str]], *, topic: str, by_standard: bool = False
) -> tuple[LogFinding, ...]:
    """The most important messages of the outcomes, each with its stack; equal messages of several
    participants once.

    `by_standard` if pqsec's plugin decided instead of the stack's own. Causes if there are any,
    else symptoms, else unknown messages as they are.
    """
    alike: dict[tuple[str, str | None, str | None], list[str]] = {}
    interpretation = ""
    for outcome, stack in outcomes:
        interpretation = "" if by_standard else f" --as {stack}"
        for found in _main_messages(outcome, stack, topic, interpretation):
            alike.setdefault(found, []).append(outcome.role.name)
    if not alike:
        names = tuple(outcome.role.name for outcome, _ in outcomes)
        alike[_no_message(names, interpretation)] = list(names)
    return tuple(
        LogFinding(participants=tuple(who), said=said, cause=cause, remedy=remedy)
        for (said, cause, remedy), who in alike.items()
    )


def _main_messages(
    outcome: PeerOutcome, stack: str, topic: str, interpretation: str
) -> Iterator[tuple[str, str | None, str | None]]:
    lines = words(outcome.log)
    known = recognise("\n".join(lines), stack=stack)
    causes = [each for each in known if each.message.kind is MessageKind.CAUSE]
    symptoms = [each for each in known if each.message.kind is MessageKind.SYMPTOM]
    joined_only = outcome.joined and outcome.refused is not None
    if causes:
        yield from map(_explained, _one_each(causes))
    elif symptoms and not joined_only:
        for each in _one_each(symptoms):
            yield shown(lines[each.line - 1], _LONGEST), each.cause, each.remedy
    elif outcome.refused:
        yield _refusal(outcome, topic, interpretation)
    else:
        yield from ((shown(each, _LONGEST), None, None) for each in lines[:_MOST])
    if outcome.signal:
        command = f"pqsec explain --participant {outcome.role.name} --join{interpretation}"
        remedy = f"`{command}` says whether the documents crash it."
        yield f"the stack crashed ({outcome.signal})", None, remedy


def _no_message(names: Sequence[str], interpretation: str) -> tuple[str, None, str]:
    command = f"pqsec verify-handshake {' '.join(names)}{interpretation}{interpretation}"
    return (
        "no message",
        None,
        f"`{command}` checks each step; a slow machine needs a longer --timeout.",
    )


def _one_each(found: list[Recognised]) -> list[Recognised]:
    """The first of each kind of message."""
    return list({each.message: each for each in reversed(found)}.values())[::-1][:_MOST]


def _explained(known: Recognised) -> tuple[str, str, str]:
    return known.said, known.cause, known.remedy


def _refusal(
    outcome: PeerOutcome, topic: str, interpretation: str
) -> tuple[str, str | None, str | None]:
    """The peer's message about a refusal of its stack, whose own log does not help."""
    message = f"its own stack refused to create a {outcome.refused}"
    if not outcome.joined:
        target = interpretation.replace("--as", "--target")
        return message, None, f"`pqsec check{target}` shows what is wrong with its files"
    if outcome.refused == _BAD_TOPIC:
        cause = f"The stack does not allow the topic name {shown(topic)}."
        return message, cause, "Name another with --topic."
    name, may = outcome.role.name, "publish" if outcome.role.act is Act.SEND else "subscribe"
    word = topic if fit_for_a_command(topic) else "TOPIC"  # users copy the command
    command = f"pqsec explain --participant {name} --{may} {word}{interpretation}"
    cause = f"Its permissions do not let it {may} {shown(topic)}."
    return message, cause, f"`{command}` shows why."
