"""Counts of the outcomes of many pairs, and the common causes of failures."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import field
from typing import NamedTuple

from pqsec_pki._dataclass import dataclass
from pqsec_pki.selfcheck.pairs import PairOutcome, ParticipantCheck
from pqsec_pki.selfcheck.report import CheckedStep


class Cause(NamedTuple):
    """A failed step, without the names and sizes that differ between pairs with the same cause."""

    step: str
    words: str
    hint: str | None

    @classmethod
    def of(cls, step: CheckedStep, roles: Mapping[str, str]) -> "Cause":
        """The cause of a failed step; `roles` has the word that replaces each name."""
        hint = None if step.hint is None else _general(step.hint, roles)
        return cls(_general(step.name, roles), _general(step.detail, roles), hint)


@dataclass(slots=True)
class Summary:
    """Counts of outcomes, and the failed outcomes by their cause."""

    met: int = 0
    failed: int = 0
    apart: int = 0
    """Pairs that share no domain."""
    no_common_topic: int = 0
    """Pairs whose handshake succeeded, but which share no topic."""
    tried: int = 0
    """Pairs whose handshake was run, since both participants are valid alone."""
    causes: dict[Cause, list[PairOutcome]] = field(default_factory=dict)
    """The causes of pairs whose handshake was run."""

    @property
    def ok(self) -> bool:
        """Whether all pairs that share a domain succeeded, and there was at least one."""
        return self.met > 0 and not self.failed

    def add(self, outcome: PairOutcome) -> None:
        """Count an outcome."""
        self.met += outcome.ok is True
        self.failed += outcome.ok is False
        self.apart += outcome.ok is None
        self.no_common_topic += bool(
            outcome.ok and outcome.result and outcome.result.shares_no_topic
        )
        self.tried += outcome.result is not None
        if (result := outcome.result) and result.failed:
            roles = {result.initiator: "the initiator", result.replier: "the replier"}
            known = {name: role for name, role in roles.items() if name}
            self.causes.setdefault(Cause.of(result.failed, known), []).append(outcome)


def faults(findings: Iterable[ParticipantCheck]) -> dict[tuple[str, Cause], list[ParticipantCheck]]:
    """Participants that fail alone, by stack and cause."""
    groups: dict[tuple[str, Cause], list[ParticipantCheck]] = {}
    for each in findings:
        if each.failed:
            cause = Cause.of(each.failed, {each.party.name: "NAME"})
            groups.setdefault((each.party.stack, cause), []).append(each)
    return groups


def _general(words: str, roles: Mapping[str, str]) -> str:
    for name, role in roles.items():
        words = re.sub(rf"(?<![\w.-]){re.escape(name)}(?![\w/.-])", role, words)
    return re.sub(r"\b[0-9]+ bytes(?=:|;|$)", "... bytes", words)
