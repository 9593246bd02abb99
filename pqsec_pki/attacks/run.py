"""Run all attacks on the handshake of two participants, and report the outcomes."""

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from typing import Any

from pqsec_pki._dataclass import dataclass
from pqsec_pki.attacks._context import AttackContext, Attempt
from pqsec_pki.attacks.attack import Attack
from pqsec_pki.errors import UsageError
from pqsec_pki.handshake import WireVersion
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck import (
    CheckedStep,
    HandshakeCheck,
    HandshakeParty,
    HandshakeReport,
    HandshakeRun,
    HandshakeSetup,
    Steps,
    StoppedError,
)

OF_SECOND = (Code.C7, Code.C21, Code.C24, Code.C27, Code.C28)
"""Checks that refuse messages of the second version: their form comes before the others, and as
they repeat no values, the signatures refuse what comparisons refuse in the first."""
_HINT = "a check of pqsec is broken: please report it as SECURITY.md says"


@dataclass(frozen=True, slots=True, kw_only=True)
class AttemptResult:
    """The result of one attempt. If neither side refused it, `by` and `step` are None."""

    what: str
    by: str | None
    """The participant that refused."""
    step: CheckedStep | None
    """The step at which it refused; its detail is the error message."""
    due: tuple[Code, ...] = ()
    """The checks that have to refuse it."""
    shares_key: bool = False
    """Whether both ended the handshake with the same key, but with another peer."""

    @property
    def refused(self) -> bool:
        """Whether a side refused it, and only by checks in `due`."""
        codes = self.step.codes if self.step else frozenset()
        return bool(codes) and codes <= set(self.due)

    def to_json(self) -> dict[str, Any]:
        """The attempt for --json."""
        return {
            "what": self.what,
            "refused": self.refused,
            "by": self.by,
            "step": self.step.name if self.step else None,
            "cause": self.step.detail if self.step else None,
            "checks": sorted(self.step.codes) if self.step else [],
            "shares_key": self.shares_key,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class AttackOutcome:
    """The outcome of one attack."""

    attack: Attack
    results: tuple[AttemptResult, ...] = ()
    """One result for each attempt."""
    skipped: str | None = None
    """Why it was skipped."""

    @property
    def ok(self) -> bool:
        """Whether there were attempts and all were refused, or the attack was skipped."""
        if self.skipped:
            return True
        return bool(self.results) and self.refused == len(self.results)

    @property
    def refused(self) -> int:
        """The number of attempts that were refused."""
        return sum(each.refused for each in self.results)

    @property
    def example(self) -> AttemptResult | None:
        """The attempt to show: the first that was not refused, else the first."""
        return min(self.results, key=lambda each: each.refused, default=None)

    @property
    def hint(self) -> str | None:
        """What to do if not all attempts were refused."""
        return None if self.ok else _HINT

    def to_json(self) -> dict[str, Any]:
        """The attack for --json."""
        about = {"name": self.attack.name, "attacker": self.attack.attacker.value}
        about |= {"title": self.attack.title}
        if self.skipped:
            return about | {"ok": True, "skipped": self.skipped}
        attempts = [each.to_json() for each in self.results]
        found = {"ok": self.ok, "refused": self.refused, "attempts": attempts}
        return about | found | ({"hint": self.hint} if self.hint else {})


@dataclass(frozen=True, slots=True, kw_only=True)
class AttackReport:
    """The outcomes of all attacks."""

    control: HandshakeReport
    """The handshake without an attacker. If it fails, attacks prove nothing."""
    outcomes: tuple[AttackOutcome, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether the handshake succeeds without an attacker, and all attacks are refused."""
        return self.control.ok and all(each.ok for each in self.outcomes)

    @property
    def verdict(self) -> str:
        """The outcome in one sentence."""
        if self.control.failed:
            why = f"{self.control.failed.name} failed: {self.control.failed.detail}"
            return f"the handshake fails without an attacker, so attacks prove nothing; {why}"
        tried = [each for each in self.outcomes if not each.skipped]
        count = sum(len(each.results) for each in tried)
        attacks = "attack" if len(tried) == 1 else "attacks"
        through = [each.attack.name for each in tried if not each.ok]
        if through:
            return f"{len(through)} of {len(tried)} {attacks} succeeded: {', '.join(through)}"
        return f"{len(tried)} {attacks} in {count} attempts, all refused"

    def to_json(self) -> dict[str, Any]:
        """The report for --json."""
        return {
            "ok": self.ok,
            "verdict": self.verdict,
            "control": self.control.to_json(),
            "attacks": [each.to_json() for each in self.outcomes],
        }


def run_attacks(
    setup: HandshakeSetup,
    first: HandshakeParty,
    second: HandshakeParty,
    attacks: Iterable[Attack],
    progress: Callable[[AttackOutcome], None] | None = None,
) -> AttackReport:
    """Run attacks on the handshake of two participants; call `progress` after each attack.

    The handshake runs without an attacker first; if that fails, no attack is run.
    KeystoreError if a participant does not exist. UsageError for a stock stack, since its
    row does not say what it accepts wrongly.
    """
    _check_parties(setup, first, second)
    check = HandshakeCheck(setup)
    try:
        session = check.prepare(first, second)
        check.perform(session)
    except StoppedError:
        return AttackReport(control=check.report())
    control = check.report()
    context = AttackContext(session=session, recorded=control.sent)
    outcomes = []
    for attack in attacks:
        outcomes.append(attempted(attack, context))
        if progress:
            progress(outcomes[-1])
    return AttackReport(control=control, outcomes=tuple(outcomes))


def _check_parties(setup: HandshakeSetup, *parties: HandshakeParty) -> None:
    for party in parties:
        setup.keystore.refuse_unknown(party.name)
        if party.stack.is_stock:
            raise UsageError(
                f"attacks are on pqsec's own handshake, not on that of {party.stack.title}",
                hint="leave out --as",
            )


def attempted(attack: Attack, context: AttackContext) -> AttackOutcome:
    """Run one attack."""
    if reason := attack.not_applicable(context.session):
        return AttackOutcome(attack=attack, skipped=reason)
    second = context.session.version is WireVersion.SECOND
    attack = replace(attack, checks=(*attack.checks, *OF_SECOND)) if second else attack
    results = tuple(_result(attempt, attack) for attempt in attack.act(context))
    return AttackOutcome(attack=attack, results=results)


def _result(attempt: Attempt, attack: Attack) -> AttemptResult:
    run = HandshakeRun(attempt.session, Steps())
    with suppress(StoppedError):
        run.perform()
    failed = next((step for step in run.steps.done if not step.ok), None)
    by = _who_refused(failed, run) if failed else None
    # A refusal by the attacker itself does not count.
    if by is None or by == attempt.attacker:
        return AttemptResult(what=attempt.what, by=None, step=None, due=attack.checks)
    return AttemptResult(
        what=attempt.what, by=by, step=failed, due=attack.checks, shares_key=_share_a_key(run)
    )


def _share_a_key(run: HandshakeRun) -> bool:
    """Whether both sides have the same secret, but each with another peer."""
    if run.done is None:
        return False
    mine, theirs = run.done
    one, other = run.session.sides
    are_peers = (mine.peer.guid, theirs.peer.guid) == (other.guid, one.guid)
    return mine.shared_secret == theirs.shared_secret and not are_peers


def _who_refused(failed: CheckedStep, run: HandshakeRun) -> str:
    """The name of the side that checked permissions; else of the one that read the last message."""
    who, verb, *_ = [*failed.name.split(), ""]
    return who if verb == "admits" else run.sent[-1].receiver
