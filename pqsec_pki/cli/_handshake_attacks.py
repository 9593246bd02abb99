"""verify-handshake --attack: run attacks and print the report."""

from collections.abc import Iterator

from pqsec_pki._progress import stage
from pqsec_pki.attacks import (
    ATTACKS,
    Attack,
    AttackOutcome,
    AttackReport,
    AttemptResult,
    attack_named,
    run_attacks,
)
from pqsec_pki.cli import _printing
from pqsec_pki.selfcheck import HandshakeParty, HandshakeSetup

EVERY = "all"


def attacks_named(name: str) -> tuple[Attack, ...]:
    """The attack of that name, or all. UnknownAlgorithmError for an unknown name."""
    return ATTACKS if name.lower() == EVERY else (attack_named(name),)


def try_attacks(
    setup: HandshakeSetup,
    parties: tuple[HandshakeParty, HandshakeParty],
    attacks: tuple[Attack, ...],
) -> bool:
    """Run the attacks and print the report. Returns whether all were refused."""
    with stage(len(attacks), "attacks") as here:
        attack_report = run_attacks(setup, *parties, attacks, lambda _: here.add(1))
    _printing.emit(attack_report.to_json(), _lines(attack_report, details=len(attacks) == 1))
    return attack_report.ok


def _lines(attack_report: AttackReport, *, details: bool) -> Iterator[str]:
    width = max((len(each.attack.name) for each in attack_report.outcomes), default=0)
    for outcome in attack_report.outcomes:
        yield f"{_mark(outcome)}  {outcome.attack.name.ljust(width)}  {_summary(outcome)}"
        for result in outcome.results:
            if details or not result.refused:
                yield f"      {_result_line(result)}"
        if outcome.hint:
            yield f"      hint: {outcome.hint}"
    if attack_report.outcomes:
        yield ""
    yield attack_report.verdict
    if (failed := attack_report.control.failed) and failed.hint:
        yield f"hint: {failed.hint}"


def _mark(outcome: AttackOutcome) -> str:
    if outcome.skipped:
        return "-   "
    return "ok  " if outcome.ok else "FAIL"


def _summary(outcome: AttackOutcome) -> str:
    if outcome.skipped:
        return f"not tried: {outcome.skipped}"
    places = dict.fromkeys(each.step.name for each in outcome.results if each.step)
    count = f"{outcome.refused} of {len(outcome.results)} refused"
    return f"{outcome.attack.title}: {count}{' at ' if places else ''}{', '.join(places)}"


def _result_line(result: AttemptResult) -> str:
    if result.step is None:
        return f"{result.what}: NOT refused"
    line = f"{result.what}: {result.by} refused ({result.step.name}): {result.step.detail}"
    if result.shares_key:
        line += (
            "; DDS-Security 1.1 accepts the earlier messages: both have the same key,"
            " each with the attacker as its peer"
        )
    due = ", ".join(result.due)
    return line if result.refused else f"{line}; NOT by the check that is due ({due})"
