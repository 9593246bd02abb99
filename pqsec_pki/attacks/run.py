"""Two participants are attacked in every way we know, and what became of it."""

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from pqsec_pki.attacks._context import AttackContext, Attempt
from pqsec_pki.attacks.attack import Attack
from pqsec_pki.errors import UsageError
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck.handshake_check import HandshakeCheck, HandshakeParty, HandshakeSetup
from pqsec_pki.selfcheck.report import Report, Step, Steps, StoppedError
from pqsec_pki.selfcheck.run import HandshakeRun

_WAY_OUT = "a check of pqsec is broken: please report it as SECURITY.md says"


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """How one attempt ended. If nobody refused it, `by` and `step` are None."""

    what: str
    by: str | None
    """The participant that refused."""
    step: Step | None
    """Where it did; the detail is the cause, in its own words."""
    due: tuple[Code, ...] = ()
    """The checks that had to refuse it."""
    shares_key: bool = False
    """Whether the two ended the handshake with one key, neither of them naming the other."""

    @property
    def refused(self) -> bool:
        """Whether somebody did, for the reason that was due and no other."""
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
class Outcome:
    """What became of one attack."""

    attack: Attack
    results: tuple[Result, ...] = ()
    """One for each attempt."""
    skipped: str | None = None
    """Why it was not tried."""

    @property
    def ok(self) -> bool:
        """Whether every attempt was refused, and there was one; or there is nothing to try."""
        if self.skipped:
            return True
        return bool(self.results) and self.refused == len(self.results)

    @property
    def refused(self) -> int:
        """How many attempts were."""
        return sum(each.refused for each in self.results)

    @property
    def example(self) -> Result | None:
        """The attempt to tell of: the first that was not refused, or else the first."""
        return min(self.results, key=lambda each: each.refused, default=None)

    @property
    def hint(self) -> str | None:
        """The way out, if not all were."""
        return None if self.ok else _WAY_OUT

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
    """What became of all of them."""

    control: Report
    """The same two without an attacker. Where they do not meet, attacks prove nothing."""
    outcomes: tuple[Outcome, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether the two meet, and nobody who attacks them gets through."""
        return self.control.ok and all(each.ok for each in self.outcomes)

    @property
    def verdict(self) -> str:
        """All of it in a sentence."""
        if self.control.failed:
            why = f"{self.control.failed.name} failed: {self.control.failed.detail}"
            return f"they do not meet without an attacker, so attacks prove nothing; {why}"
        tried = [each for each in self.outcomes if not each.skipped]
        count = sum(len(each.results) for each in tried)
        attacks = "attack" if len(tried) == 1 else "attacks"
        through = [each.attack.name for each in tried if not each.ok]
        if through:
            return f"{len(through)} of {len(tried)} {attacks} got through: {', '.join(through)}"
        return f"{len(tried)} {attacks} in {count} attempts, all refused"

    def to_json(self) -> dict[str, Any]:
        """The siege for --json."""
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
    progress: Callable[[Outcome], None] | None = None,
) -> AttackReport:
    """Attack the two when they meet; `progress` is told of each attack once it is over.

    They meet undisturbed first; if they cannot, no attack is tried. KeystoreError if a
    participant is not there at all. UsageError for a stock stack: what it takes that it
    should not, we do not know.
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
                hint="leave --as out",
            )


def attempted(attack: Attack, context: AttackContext) -> Outcome:
    """What becomes of one attack."""
    if reason := attack.not_applicable(context.session):
        return Outcome(attack=attack, skipped=reason)
    results = tuple(_result(attempt, attack) for attempt in attack.act(context))
    return Outcome(attack=attack, results=results)


def _result(attempt: Attempt, attack: Attack) -> Result:
    run = HandshakeRun(attempt.session, Steps())
    with suppress(StoppedError):
        run.perform()
    failed = next((step for step in run.steps.done if not step.ok), None)
    by = _who_refused(failed, run) if failed else None
    # An attacker does not stop itself.
    if by is None or by == attempt.attacker:
        return Result(what=attempt.what, by=None, step=None, due=attack.checks)
    return Result(
        what=attempt.what, by=by, step=failed, due=attack.checks, shares_key=_share_a_key(run)
    )


def _share_a_key(run: HandshakeRun) -> bool:
    """Whether the two have one secret, though each has it with somebody else."""
    if run.done is None:
        return False
    mine, theirs = run.done
    one, other = run.session.sides
    met = (mine.peer.guid, theirs.peer.guid) == (other.guid, one.guid)
    return mine.shared_secret == theirs.shared_secret and not met


def _who_refused(failed: Step, run: HandshakeRun) -> str:
    """Who judged the peer's permissions; else who read the last message."""
    who, verb, *_ = [*failed.name.split(), ""]
    return who if verb == "admits" else run.sent[-1].receiver
