"""pqsec ca rotate --overlap: two identity CAs are trusted during the change to the new one."""

from collections.abc import Iterator
from typing import Any

from pqsec_pki.cli import _printing, _settings
from pqsec_pki.errors import UsageError
from pqsec_pki.lifecycle import OverlapStep, RolloverPlan, RolloverResult
from pqsec_pki.vendors import TRUST

_COPY = (
    "copy to every robot its enclave folder, with the files that its links point to, and restart"
    " it: one robot after the other, in any order"
)
_PINS = "where bundles are installed, name the CAs that are trusted now: `pqsec ca show --pins`"
_ROBOTS = {
    OverlapStep.BEGIN: (
        *(_COPY, _PINS),
        "when all robots have it, `{rotate} --overlap switch`",
    ),
    OverlapStep.SWITCH: (_COPY, "when all robots have it, `{rotate} --overlap finish`"),
    OverlapStep.FINISH: (_COPY, _PINS),
    OverlapStep.CANCEL: (_COPY, _PINS),
}
"""Step -> what the operator does next; `{rotate}` is the command for this set of credentials."""
_ISSUING_OPTIONS = frozenset({"name", "validity", "rekey", "destroy", "no_passphrase"})
_ACCEPTED = {
    OverlapStep.BEGIN: frozenset({"name", "validity"}),
    OverlapStep.SWITCH: frozenset({"rekey", "destroy"}),
}
"""Step -> which of _ISSUING_OPTIONS it accepts."""


def refuse_options(step: OverlapStep) -> None:
    """UsageError for an option that the step does not accept."""
    refused = _ISSUING_OPTIONS - _ACCEPTED.get(step, frozenset())
    given = [option for name, option in _settings.given_options().items() if name in refused]
    if given:
        raise UsageError(f"{', '.join(given)} does not go with --overlap {step}")


def _robots(step: OverlapStep, plan: RolloverPlan) -> list[str]:
    return [each.format(rotate=plan.rotate) for each in _ROBOTS[step]]


def show(step: OverlapStep, plan: RolloverPlan) -> None:
    """Print the plan of the step."""
    value = {
        "overlap": step.value,
        "steps": plan.steps,
        "robots": _robots(step, plan),
        "trust": TRUST,
    }
    _printing.emit(value, _lines(step, plan))


def _lines(step: OverlapStep, plan: RolloverPlan) -> Iterator[str]:
    yield f"`--overlap {step} --apply` makes these changes, all or none:"
    yield from _printing.numbered(plan.steps)
    yield from ("", "Then you:")
    yield from _printing.numbered(_robots(step, plan))
    yield from ("", "Stacks that trust both CAs during the overlap (docs/how-to/rollover.md):")
    yield from (f"  {row.stack}: {row.how or f'no ({row.evidence})'}" for row in TRUST)


def print_done(step: OverlapStep, result: RolloverResult) -> None:
    """Print what the step did, and what the operator does next."""
    done = list(_done(step, result))
    robots = _robots(step, result.plan)
    value: dict[str, Any] = {"overlap": step.value, "done": done, "robots": robots}
    _printing.emit(value, [*done, *(f"next: {each}" for each in robots)])


def _done(step: OverlapStep, result: RolloverResult) -> Iterator[str]:
    plan = result.plan
    issuing = plan.issuing.subject_name
    other = result.overlap.other.subject_name if result.overlap else ""
    match step:
        case OverlapStep.BEGIN:
            yield f"{other} is now trusted too"
            yield f"{issuing} still issues"
            if plan.drop_list:
                yield "the revocation list, which was empty, is removed"
        case OverlapStep.SWITCH:
            count = _printing.counted(len(result.issued), "participant")
            yield f"generation {plan.generation}: new identity CA, {count} reissued"
            yield f"{issuing} is still trusted"
        case OverlapStep.FINISH:
            yield f"{other} is no longer trusted"
        case OverlapStep.CANCEL:
            yield f"{other} is no longer trusted, and its key is destroyed"
    if step in {OverlapStep.FINISH, OverlapStep.CANCEL} and plan.new_list:
        yield "an empty revocation list was issued"
