"""One question, as each stack answers it."""

from dataclasses import dataclass
from datetime import timedelta

from pqsec_pki.access import FASTDDS, Decision, Policy, Question, Reading, Side
from pqsec_pki.cli._documents import Papers
from pqsec_pki.documents import Grant

_WIDEST_ZONE = timedelta(hours=14)
"""Local times lie at most that far from UTC."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What one reading says."""

    reading: Reading
    decision: Decision
    own: bool
    """What the participant's own stack says."""
    peers: bool
    """What its peers say, if they run the same stack."""
    hazard: str = ""

    @property
    def word(self) -> str:
        """`yes` or `no`."""
        return "yes" if self.decision.allowed else "no"

    @property
    def whose(self) -> str:
        """Where the two sides are not of one mind."""
        if self.own == self.peers:
            return ""
        if self.own:
            return "its own stack would let it, its peers refuse"
        return "its peers would accept it, its own stack refuses"

    def differs(self, other: "Answer") -> bool:
        """Whether one is a yes and the other a no."""
        return self.decision.allowed is not other.decision.allowed


def answer_of(papers: Papers, question: Question, reading: Reading) -> Answer:
    """What that reading answers, and what each side of its stack."""
    policy = Policy(papers.governance.value, papers.permissions.value, reading)
    return Answer(
        reading=reading,
        decision=policy.decide(question),
        own=policy.decide(question, by=Side.OWN).allowed,
        peers=policy.decide(question, by=Side.PEER).allowed,
        hazard=_zone_hazard(reading.grant_for(papers.permissions.value, question), question)
        if reading is FASTDDS
        else "",
    )


def _zone_hazard(grant: Grant | None, question: Question) -> str:
    """Fast DDS, all versions, reads the times of a grant as local ones (measured)."""
    for edge in (grant.not_before, grant.not_after) if grant else ():
        if abs(edge - question.now) < _WIDEST_ZONE:
            return (
                "it reads the times of a grant as local time, and this one begins or ends within"
                f" {_WIDEST_ZONE.seconds // 3600} hours: away from UTC it may decide otherwise"
            )
    return ""
