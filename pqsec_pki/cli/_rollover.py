"""pqsec ca rotate: what a rollover without an overlap does and breaks, in words."""

from collections.abc import Iterator

from pqsec_pki.algorithms import protection_lost
from pqsec_pki.cli import _printing
from pqsec_pki.keystore import State
from pqsec_pki.lifecycle import RolloverPlan, RolloverResult, Scope
from pqsec_pki.vendors import TRUST

CAS = {
    Scope.BOTH: "identity CA and permissions CA",
    Scope.IDENTITY: "identity CA",
    Scope.PERMISSIONS: "permissions CA",
}


def show(plan: RolloverPlan) -> None:
    """Print the plan."""
    value = {
        **plan.to_json(),
        "robots": _to_robots(plan),
        "breaks": _breaks(plan),
        "overlap": TRUST,
    }
    _printing.emit(value, _plan_lines(plan))


def print_done(done: RolloverResult) -> None:
    """Print what was replaced, and what the operator does next."""
    plan = done.plan
    count = _printing.counted(len(done.issued), "participant")
    keys = (
        "certificates only, the keys are destroyed"
        if plan.terms.destroy
        else "readable by their owner only"
    )
    lines = [
        f"generation {plan.generation}: {CAS[plan.terms.scope]}, {count} reissued",
        f"generation {plan.generation - 1} is in {plan.archive} ({keys})",
        *(f"next: {step}" for step in _to_robots(plan)),
    ]
    _printing.emit(done.to_json(), lines)


def _plan_lines(plan: RolloverPlan) -> Iterator[str]:
    yield f"generation {plan.generation}: {CAS[plan.terms.scope]}, {_change(plan)}"
    yield from ("", "`--apply` makes these changes, all or none:")
    yield from _printing.numbered(plan.steps)
    yield from ("", "Then you:")
    yield from _printing.numbered(_to_robots(plan))
    yield from ("", "What breaks:")
    yield from (f"  - {text}" for text in _breaks(plan))
    yield from ("", "Stacks that can trust two generations of CAs at the same time:")
    if plan.terms.scope is not Scope.IDENTITY:
        yield "  permissions CAs: none"
    if plan.terms.scope is not Scope.PERMISSIONS:
        yield "  identity CAs, with `--overlap begin`:"
        yield from (f"  {row.stack}: {row.how or 'no'}" for row in TRUST)


def _change(plan: RolloverPlan) -> str:
    if plan.before.name == plan.terms.profile.name:
        return f"profile {plan.terms.profile.name} as before"
    return f"from profile {plan.before.name} to {plan.terms.profile.name}"


def _to_robots(plan: RolloverPlan) -> Iterator[str]:
    yield "copy to every robot its enclave folder, with the files that its links point to"
    yield "restart all participants of a domain together: stacks read the files when they start"
    if names := [name for name, why in plan.left_out.items() if why != State.REVOKED]:
        yield f"reissue the participants that were left out: {', '.join(names)}"


def _breaks(plan: RolloverPlan) -> Iterator[str]:
    yield (
        "Participants with old files and participants with new files refuse each other, from the"
        " first robot that restarts with new files until the last."
    )
    if plan.others:
        yield f"With credentials of {', '.join(plan.others)} nothing changes."
    yield "Running participants continue until they restart; DDS cannot notify them."
    before, after = plan.before, plan.terms.profile
    if before.name != after.name:
        yield f"Profile {after.name} runs in {after.runs_in}."
    yield from (f"Protection is lost: {each}." for each in protection_lost(before, after))
    if before.runs_in_stock and not after.runs_in_stock:
        yield "Participants in a stock stack stop working; install pqsec's plugin first."
        if not before.alternative_key:
            yield (
                "Change to `--profile transition` first: stock stacks run it, and you can install"
                " the plugin on one robot after the other."
            )
    if plan.one_ca:
        yield (
            "Until it is done, one key is both CAs: any participant's key can sign permissions"
            " that some stacks accept (CVE-2023-24010)."
        )
