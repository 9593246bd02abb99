"""Outcomes of many meetings: how many, and what the failures have in common."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from pqsec_pki.selfcheck.pairs import Finding, Outcome
from pqsec_pki.selfcheck.report import Step


class Cause(NamedTuple):
    """A failed step, without the names and sizes that differ between those that share it."""

    step: str
    words: str
    hint: str | None

    @classmethod
    def of(cls, step: Step, roles: Mapping[str, str]) -> "Cause":
        """`roles` says what stands for which name."""
        hint = None if step.hint is None else _general(step.hint, roles)
        return cls(_general(step.name, roles), _general(step.detail, roles), hint)


@dataclass(slots=True)
class Summary:
    """Outcomes, counted; those that failed under their cause."""

    met: int = 0
    failed: int = 0
    apart: int = 0
    """Pairs that share no domain."""
    no_common_topic: int = 0
    """Pairs that met, and share no topic."""
    tried: int = 0
    """Pairs whose handshake was run: both are sound each by itself."""
    causes: dict[Cause, list[Outcome]] = field(default_factory=dict)
    """Of pairs that were tried."""

    @property
    def ok(self) -> bool:
        """Whether all met that share a domain, and any did: nothing proves nothing."""
        return self.met > 0 and not self.failed

    def add(self, outcome: Outcome) -> None:
        """Count it."""
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


def faults(findings: Iterable[Finding]) -> dict[tuple[str, Cause], list[Finding]]:
    """Participants that are at fault by themselves, by how they behave and by cause."""
    groups: dict[tuple[str, Cause], list[Finding]] = {}
    for each in findings:
        if each.failed:
            cause = Cause.of(each.failed, {each.party.name: "NAME"})
            groups.setdefault((each.party.stack, cause), []).append(each)
    return groups


def _general(words: str, roles: Mapping[str, str]) -> str:
    for name, role in roles.items():
        words = re.sub(rf"(?<![\w.-]){re.escape(name)}(?![\w/.-])", role, words)
    return re.sub(r"\b[0-9]+ bytes(?=:|;|$)", "... bytes", words)
