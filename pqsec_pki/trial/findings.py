"""Why it came to nothing: what the stacks said, with cause and remedy."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from pqsec_pki.errors import shown
from pqsec_pki.trial.peer import Act, PeerOutcome
from pqsec_pki.trial.words import words
from pqsec_pki.vendors.messages import Recognised, Tells, fit_for_a_command, recognise

_MOST = 3
"""Of one participant's; what comes first is what matters."""
_NO_NAME = "topic: Bad Parameter"
"""What Cyclone DDS says of a topic with other characters than letters, digits, / and _."""
_LONGEST = 300
"""Characters of a message that is shown as it is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """What participants, or their stacks, said."""

    participants: tuple[str, ...]
    said: str
    cause: str | None
    """None for words that are not known here."""
    remedy: str | None


def findings(
    outcomes: Sequence[PeerOutcome], *, stack: str, topic: str, by_standard: bool = False
) -> tuple[Finding, ...]:
    """What matters most of what the accounts tell, said once if both say it.

    `by_standard` if our plugin decided, and not the stack's own. Causes if there are any, else
    symptoms; words that are not known, as they are.
    """
    interpretation = "" if by_standard else f" --as {stack}"
    alike: dict[tuple[str, str | None, str | None], list[str]] = {}
    for outcome in outcomes:
        for said in _matter(outcome, stack, topic, interpretation):
            alike.setdefault(said, []).append(outcome.role.name)
    if not alike:
        names = tuple(outcome.role.name for outcome in outcomes)
        alike[_silence(names, interpretation)] = list(names)
    return tuple(
        Finding(participants=tuple(who), said=said, cause=cause, remedy=remedy)
        for (said, cause, remedy), who in alike.items()
    )


def _matter(
    outcome: PeerOutcome, stack: str, topic: str, interpretation: str
) -> Iterator[tuple[str, str | None, str | None]]:
    said = words(outcome.log)
    known = recognise("\n".join(said), stack=stack)
    causes = [each for each in known if each.message.tells is Tells.CAUSE]
    symptoms = [each for each in known if each.message.tells is Tells.SYMPTOM]
    joined_only = outcome.joined and outcome.refused is not None
    if causes:
        yield from map(_explained, _one_each(causes))
    elif symptoms and not joined_only:
        for each in _one_each(symptoms):
            yield shown(said[each.line - 1], _LONGEST), each.cause, each.remedy
    elif outcome.refused:
        yield _refusal(outcome, topic, interpretation)
    else:
        yield from ((shown(each, _LONGEST), None, None) for each in said[:_MOST])
    if outcome.signal:
        yield f"the stack crashed ({outcome.signal})", None, None


def _silence(names: Sequence[str], interpretation: str) -> tuple[str, None, str]:
    question = f"pqsec verify-handshake {' '.join(names)}{interpretation}{interpretation}"
    return (
        "no word of why",
        None,
        f"`{question}` goes through it step by step; a slow machine needs a longer --timeout.",
    )


def _one_each(found: list[Recognised]) -> list[Recognised]:
    """The first of each kind of message."""
    return list({each.message: each for each in reversed(found)}.values())[::-1][:_MOST]


def _explained(known: Recognised) -> tuple[str, str, str]:
    return known.said, known.cause, known.remedy


def _refusal(
    outcome: PeerOutcome, topic: str, interpretation: str
) -> tuple[str, str | None, str | None]:
    """What the peer says of its stack, which itself says nothing of use."""
    said = f"its own stack refused to make a {outcome.refused}"
    if not outcome.joined:
        target = interpretation.replace("--as", "--target")
        return said, None, f"`pqsec check{target}` tells what is wrong with its files"
    if outcome.refused == _NO_NAME:
        return said, f"No topic can be called {shown(topic)} there.", "Name another with --topic."
    name, may = outcome.role.name, "publish" if outcome.role.act is Act.SEND else "subscribe"
    word = topic if fit_for_a_command(topic) else "TOPIC"  # it is there to be copied
    question = f"pqsec explain --participant {name} --{may} {word}{interpretation}"
    return said, f"Its permissions do not let it {may} {shown(topic)}.", f"`{question}` tells why."
