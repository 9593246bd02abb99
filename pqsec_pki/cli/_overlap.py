"""pqsec ca rotate --overlap: two identity CAs are trusted during the change to the new one."""

from collections.abc import Callable, Iterator, Sized
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import click
from click.core import ParameterSource

from pqsec_pki.cli import _passphrases, _printing, _settings
from pqsec_pki.errors import UsageError
from pqsec_pki.keystore import Keystore, Overlap, Phase
from pqsec_pki.lifecycle import (
    Rollover,
    begin_overlap,
    cancel_overlap,
    check_begin,
    finish_overlap,
    plan_rollover,
    switch_overlap,
)
from pqsec_pki.vendors.rollover import TRUST

_COPY = (
    "copy to every robot its enclave folder, with the files that its links point to, and restart"
    " it: one robot after the other, in any order"
)
_PINS = "where bundles are installed, name the CAs that are trusted now: `pqsec ca show --pins`"


class Step(StrEnum):
    """A step of an overlap."""

    BEGIN = "begin"
    SWITCH = "switch"
    FINISH = "finish"
    CANCEL = "cancel"


@dataclass(frozen=True, slots=True)
class OverlapOptions:
    """The keystore, and the options of the rollover."""

    keystore: Keystore
    terms: Rollover
    passphrase_file: Path | None

    @property
    def passphrase(self) -> bytes | None:
        """The passphrase of the old and new CAs; may ask at the terminal."""
        return _passphrases.of_cas(self.keystore, self.passphrase_file)


@dataclass(frozen=True, slots=True, kw_only=True)
class _StepActions:
    """A step, and what the operator does next."""

    planned: Callable[[OverlapOptions], Iterator[str]]
    """Describes what the step will do; raises the errors that the step would raise."""
    execute: Callable[[OverlapOptions], Iterator[str]]
    """Executes the step, and describes what was done."""
    robots: tuple[str, ...]
    options: frozenset[str] = frozenset()
    """Which options of _ISSUING_OPTIONS the step accepts."""


def run(options: OverlapOptions, step: Step, *, do: bool) -> None:
    """Execute the step, or print its plan. UsageError for an option that it does not accept."""
    chosen = _STEPS[step]
    _refuse_options(step, chosen.options)
    if not do:
        steps = list(chosen.planned(options))
        value = {"overlap": step.value, "steps": steps, "robots": chosen.robots, "trust": _trust()}
        _printing.emit(value, _plan_lines(step, steps, chosen.robots))
        return
    done = list(chosen.execute(options))
    value = {"overlap": step.value, "done": done, "robots": chosen.robots}
    _printing.emit(value, [*done, *(f"next: {each}" for each in chosen.robots)])


def _refuse_options(step: Step, accepted: frozenset[str]) -> None:
    context = click.get_current_context()
    given = [
        each.opts[0]
        for each in context.command.params
        if each.name in _ISSUING_OPTIONS - accepted
        and context.get_parameter_source(each.name) is ParameterSource.COMMANDLINE
    ]
    if given:
        raise UsageError(f"{', '.join(given)} does not go with --overlap {step}")


def _trust() -> list[dict[str, str | None]]:
    return [{"stack": row.stack, "identity_ca": row.how, "evidence": row.evidence} for row in TRUST]


def _plan_lines(step: Step, steps: list[str], robots: tuple[str, ...]) -> Iterator[str]:
    yield f"`--overlap {step} --apply` makes these changes, all or none:"
    yield from (f"  {number}. {text}" for number, text in enumerate(steps, start=1))
    yield from ("", "Then you:")
    yield from (f"  {number}. {text}" for number, text in enumerate(robots, start=1))
    yield from ("", "Stacks that trust both CAs during the overlap (docs/how-to/rollover.md):")
    yield from (f"  {row.stack}: {row.how or f'no ({row.evidence})'}" for row in TRUST)


# The steps


def _plan_begin(options: OverlapOptions) -> Iterator[str]:
    check_begin(options.keystore, options.terms, _settings.now())
    second = options.terms.profile.alternative_key
    kinds = f"{options.terms.profile.identity_key.name}{f' and {second.name}' if second else ''}"
    yield f"create an identity CA ({kinds}), which does not issue yet"
    old = options.keystore.identity_ca.subject_name
    yield f"add it to the CAs that all participants trust, after {old}, which still issues"
    if options.keystore.has_revocation_list:
        yield "remove the revocation list, which is empty: it would be of one CA only"


def _begin(options: OverlapOptions) -> Iterator[str]:
    secret = options.passphrase
    kept = options.keystore.unlock(secret)
    done = begin_overlap(
        options.keystore, options.terms, kept=kept, passphrase=secret, now=_settings.now()
    )
    yield f"{done.overlap.other.subject_name} is now trusted too"
    yield f"{done.overlap.issuing.subject_name} still issues"
    if done.dropped_list:
        yield "the revocation list, which was empty, is removed"


def _plan_switch(options: OverlapOptions) -> Iterator[str]:
    overlap = Overlap.that_is(options.keystore, Phase.BEGUN)
    plan = plan_rollover(options.keystore, options.terms, now=_settings.now(), within_overlap=True)
    yield f"issue with {overlap.other.subject_name} from now on"
    if plan.keeping:
        yield f"reissue {count_participants(plan.keeping)} with the same keys"
    if plan.rekeyed:
        yield f"reissue {count_participants(plan.rekeyed)} with new keys"
    yield (f"keep the old CA in {plan.archive}" if not plan.destroy else "destroy the old key")
    yield f"keep trusting {overlap.issuing.subject_name}"


def _switch(options: OverlapOptions) -> Iterator[str]:
    secret = options.passphrase
    kept = options.keystore.unlock(secret)
    done = switch_overlap(
        options.keystore, options.terms, kept=kept, passphrase=secret, now=_settings.now()
    )
    count = count_participants(done.issued)
    yield f"generation {done.generation}: new identity CA, {count} reissued"
    yield f"{kept.identity.certificate.subject_name} is still trusted"


def _plan_finish(options: OverlapOptions) -> Iterator[str]:
    overlap = Overlap.that_is(options.keystore, Phase.SWITCHED)
    yield f"trust only {overlap.issuing.subject_name}"
    yield f"refuse certificates that {overlap.other.subject_name} issued"


def _finish(options: OverlapOptions) -> Iterator[str]:
    overlap = finish_overlap(options.keystore, now=_settings.now())
    yield f"{overlap.other.subject_name} is no longer trusted"


def _plan_cancel(options: OverlapOptions) -> Iterator[str]:
    overlap = Overlap.that_is(options.keystore, Phase.BEGUN)
    yield f"trust only {overlap.issuing.subject_name}, as before"
    yield f"destroy the key of {overlap.other.subject_name}, which has not issued anything"


def _cancel(options: OverlapOptions) -> Iterator[str]:
    overlap = cancel_overlap(options.keystore, now=_settings.now())
    yield f"{overlap.other.subject_name} is no longer trusted, and its key is destroyed"


def count_participants(participants: Sized) -> str:
    """Such as "1 participant" or "2 participants"."""
    return _printing.counted(len(participants), "participant")


_ISSUING_OPTIONS = frozenset({"name", "validity", "rekey", "destroy", "no_passphrase"})
_STEPS = {
    Step.BEGIN: _StepActions(
        planned=_plan_begin,
        execute=_begin,
        robots=(_COPY, _PINS, "when all robots have it, `pqsec ca rotate --overlap switch`"),
        options=frozenset({"name", "validity"}),
    ),
    Step.SWITCH: _StepActions(
        planned=_plan_switch,
        execute=_switch,
        robots=(_COPY, "when all robots have it, `pqsec ca rotate --overlap finish`"),
        options=frozenset({"rekey", "destroy"}),
    ),
    Step.FINISH: _StepActions(planned=_plan_finish, execute=_finish, robots=(_COPY, _PINS)),
    Step.CANCEL: _StepActions(planned=_plan_cancel, execute=_cancel, robots=(_COPY, _PINS)),
}
