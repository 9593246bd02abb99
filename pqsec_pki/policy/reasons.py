"""Why a participant may use a topic, and where its documents say so."""

from datetime import datetime
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access import Action, Interpretation, InterpretedPolicy, Question
from pqsec_pki.policy.participants import PolicyInput


@dataclass(frozen=True, slots=True)
class Explanation:
    """The reason of a decision, and the place of the rule or grant that decided."""

    words: str
    path: Path | None
    line: int | None


def reason_of(  # noqa: PLR0913 -- what is asked, by name
    policy_input: PolicyInput,
    *,
    action: Action,
    topic: str,
    domain: int,
    now: datetime,
    interpretation: Interpretation,
    partitions: tuple[str, ...] = (),
) -> Explanation:
    """Why the participant may, or may not, do that with the topic on that domain at `now`."""
    policy = InterpretedPolicy(
        policy_input.governance.value, policy_input.permissions.value, interpretation
    )
    question = Question(
        subject=policy_input.subject,
        domain=domain,
        action=action,
        now=now,
        topic=topic,
        partitions=partitions,
    )
    decision = policy.decide(question)
    place = policy_input.place(decision)
    return Explanation(decision.reason, *(place or (None, None)))
