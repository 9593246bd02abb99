"""verify-handshake --all: run all pairs, print a matrix or JSON."""

import json
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import field
from typing import TypeVar

from pqsec_pki._dataclass import dataclass
from pqsec_pki._progress import counted
from pqsec_pki.cli import _printing, _settings
from pqsec_pki.errors import KeystoreError
from pqsec_pki.selfcheck import (
    PQSEC,
    AllPairsJob,
    Cause,
    CheckedStep,
    PairOutcome,
    PairsCheck,
    Summary,
    check_pairs,
    count_pairs,
    faults,
    stack_named,
)

MATRIX = 20
"""The most participants for which a matrix is printed."""
LISTED = 20
"""The most participants listed for one fault; --json lists all."""
_MET = "met"
_CELLS = {True: "ok", False: "FAIL", None: "-"}

Item = TypeVar("Item")


def try_all(job: AllPairsJob, names: Sequence[str], jobs: int) -> bool:
    """Run all pairs and print the result. Returns whether all succeeded."""
    if len(names) < 2:  # noqa: PLR2004 -- a pair
        raise KeystoreError(
            f"{job.root} has {len(names)} participants, and a handshake needs two",
            hint="issue more: pqsec issue NAME NAME",
        )
    parties = len(names) * len(set(job.stacks))
    with check_pairs(
        job, names, jobs, lambda found: counted(found, parties, "participants")
    ) as found:
        account = _Totals(found)
        if _settings.settings().json:
            for line in _json(account):
                _printing.say(line)
            return account.summary.ok
        for _ in account.outcomes():
            pass
    _printing.emit(None, _lines(account))
    return account.summary.ok


@dataclass(slots=True)
class _Totals:
    """The totals of all outcomes, collected while they pass."""

    check_pairs: PairsCheck
    summary: Summary = field(default_factory=Summary)
    cells: dict[tuple[str, str], str] = field(default_factory=dict)
    """The matrix: (name of the row, name of the column) -> text."""
    seconds: float = 0.0

    def outcomes(self) -> Iterator[PairOutcome]:
        """Each outcome, after it was counted."""
        names = self.check_pairs.names
        count = count_pairs(names, self.check_pairs.job)
        started = time.perf_counter()
        for outcome in counted(self.check_pairs.outcomes(), count, "pairs"):
            self.summary.add(outcome)
            if len(names) <= MATRIX:
                self._mark(outcome)
            yield outcome
        self.seconds = time.perf_counter() - started

    def _mark(self, outcome: PairOutcome) -> None:
        row, column = outcome.first.party.name, outcome.second.party.name
        self.cells[row, column] = self._cell(outcome, row)
        if len(set(self.check_pairs.job.stacks)) == 1:
            self.cells[column, row] = self._cell(outcome, column)

    def _cell(self, outcome: PairOutcome, sender: str) -> str:
        """The cell text: handshake result, and whether the other may subscribe to `sender`."""
        talks = outcome.result.talks if outcome.ok and outcome.result else ()
        no_topic = any(each.sender == sender and not each.topics for each in talks)
        return _MET if no_topic else _CELLS[outcome.ok]

    @property
    def totals(self) -> dict[str, float]:
        summary = self.summary
        count = summary.met + summary.failed + summary.apart
        return {
            "participants": len(self.check_pairs.names),
            "pairs": count,
            "ok": summary.met,
            "failed": summary.failed,
            "no_common_domain": summary.apart,
            "no_common_topic": summary.no_common_topic,
            "seconds": round(self.seconds, 3),
            "handshakes": summary.tried,
            "handshakes_per_second": round(summary.tried / self.seconds, 1),
        }


# As JSON: one object, written piece by piece.


def _json(account: _Totals) -> Iterator[str]:
    listed = json.dumps(account.check_pairs.participants_json(), indent=2)
    yield f'{{"version": {_printing.JSON_VERSION}, "participants": {listed},'
    yield '"pairs": ['
    comma = ""
    for outcome in account.outcomes():
        if outcome.ok is not None:
            yield comma + json.dumps(outcome.to_json())
            comma = ","
    yield "],"
    yield f'"ok": {json.dumps(account.summary.ok)},'
    yield f'"totals": {json.dumps(account.totals, indent=2)}}}'


# As text.


def _lines(account: _Totals) -> Iterator[str]:
    if account.cells:
        yield from _matrix(account)
    for (stack, cause), ones in faults(account.check_pairs.findings.values()).items():
        names = [each.party.name for each in ones]
        role = f" as {stack_named(stack).title}" if stack != PQSEC.name else ""
        yield from _fault_lines(cause, [each.failed for each in ones])
        yield f"  so no handshake of {_listed(names)}{role} can succeed"
        yield ""
    for cause, outcomes in account.summary.causes.items():
        yield from _fault_lines(cause, [each.failed for each in outcomes])
        yield from (f"  {line}" for line in _by_initiator(outcomes))
        yield ""
    if not account.summary.met + account.summary.failed:
        domain = account.check_pairs.job.domain
        yield f"No two participants share {'a domain' if domain is None else f'domain {domain}'}."
    yield (
        "{participants} participants; pairs: {pairs}, {ok} ok, {failed} failed,"
        " {no_common_domain} without a common domain, {no_common_topic} without a common topic;"
        " {seconds:.1f} s, {handshakes_per_second:.0f} handshakes/s".format(**account.totals)
    )


def _fault_lines(cause: Cause, steps: Sequence[CheckedStep | None]) -> Iterator[str]:
    """The cause that several steps share; for a single step, its own words."""
    [first, *others] = steps
    if first and not others:
        cause = Cause(first.name, first.detail, first.hint)
    yield f"FAIL  {cause.step}  {cause.words}"
    if cause.hint:
        yield f"  hint: {cause.hint}"


def _listed(names: Sequence[str]) -> str:
    rest = len(names) - LISTED
    return ", ".join(names[:LISTED]) + (f" and {rest} more" if rest > 0 else "")


def _by_initiator(outcomes: Iterable[PairOutcome]) -> Iterator[str]:
    """One line for each initiator, with its repliers."""
    repliers: dict[str, list[str]] = {}
    for each in outcomes:
        if result := each.result:
            repliers.setdefault(str(result.initiator), []).append(str(result.replier))
    for initiator, others in repliers.items():
        yield f"{initiator} to {', '.join(others)}"


def _matrix(account: _Totals) -> Iterator[str]:
    names, stacks = account.check_pairs.names, account.check_pairs.job.stacks
    numbers = [str(number) for number, _ in enumerate(names, 1)]
    rows = [
        (number, name, *(account.cells.get((name, other), "") for other in names))
        for number, name in zip(numbers, names, strict=True)
    ]
    yield from _printing.table(("", "", *numbers), rows)
    if _MET in account.cells.values():
        yield (f"{_MET}: it succeeds, but the column may not subscribe to what the row may publish")
    if stacks != (PQSEC.name, PQSEC.name):
        row, column = (stack_named(name).title for name in stacks)
        yield f"a row behaves as {row}, a column as {column}"
    yield ""
