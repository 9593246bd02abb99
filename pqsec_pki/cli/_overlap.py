"""pqsec ca rotate --overlap: two identity CAs are trusted, while robots go to the new one."""

from collections.abc import Callable, Iterator, Sized
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import click
from click.core import ParameterSource

from pqsec_pki.cli import _passphrases, _printing, _settings
from pqsec_pki.errors import UsageError
from pqsec_pki.keystore import (
    Keystore,
    Overlap,
    Phase,
    Rollover,
    begin_overlap,
    cancel_overlap,
    check_begin,
    finish_overlap,
    plan_rollover,
    switch_overlap,
)
from pqsec_pki.vendors.rollover import TRUST

_BRING = (
    "bring every robot its enclave folder, with the files that its links show, and restart it:"
    " one after the other, in any order"
)
_PINS = "where bundles are installed, name there the CAs that are trusted now: `pqsec ca show`"


class Step(StrEnum):
    """What is done to an overlap."""

    BEGIN = "begin"
    SWITCH = "switch"
    FINISH = "finish"
    CANCEL = "cancel"


@dataclass(frozen=True, slots=True)
class Order:
    """For whom, and how."""

    keystore: Keystore
    terms: Rollover
    passphrase_file: Path | None

    @property
    def passphrase(self) -> bytes | None:
        """Of the CAs, old and new; it may be asked for."""
        return _passphrases.of_cas(self.keystore, self.passphrase_file)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Round:
    """A step, and what follows from it for the robots."""

    planned: Callable[[Order], Iterator[str]]
    """What it will do; refuses what the step would."""
    taken: Callable[[Order], Iterator[str]]
    """Does it, and tells what was done."""
    robots: tuple[str, ...]
    options: frozenset[str] = frozenset()
    """Of those that say how CAs and participants are made, the ones that it takes."""


def run(order: Order, step: Step, *, do: bool) -> None:
    """Take the step, or tell what it would do. UsageError for an option that it has no use for."""
    chosen = _ROUNDS[step]
    _refuse_options(step, chosen.options)
    if not do:
        steps = list(chosen.planned(order))
        value = {"overlap": step.value, "steps": steps, "robots": chosen.robots, "trust": _trust()}
        _printing.emit(value, _plan_lines(step, steps, chosen.robots))
        return
    done = list(chosen.taken(order))
    value = {"overlap": step.value, "done": done, "robots": chosen.robots}
    _printing.emit(value, [*done, *(f"next: {each}" for each in chosen.robots)])


def _refuse_options(step: Step, taken: frozenset[str]) -> None:
    context = click.get_current_context()
    said = [
        each.opts[0]
        for each in context.command.params
        if each.name in _HOW - taken
        and context.get_parameter_source(each.name) is ParameterSource.COMMANDLINE
    ]
    if said:
        raise UsageError(f"{', '.join(said)} says nothing about --overlap {step}")


def _trust() -> list[dict[str, str | None]]:
    return [{"stack": row.stack, "identity_ca": row.how, "evidence": row.evidence} for row in TRUST]


def _plan_lines(step: Step, steps: list[str], robots: tuple[str, ...]) -> Iterator[str]:
    yield f"`--overlap {step} --apply` does, in one step that is done wholly or not at all:"
    yield from (f"  {number}. {text}" for number, text in enumerate(steps, start=1))
    yield from ("", "Then, by you:")
    yield from (f"  {number}. {text}" for number, text in enumerate(robots, start=1))
    yield from ("", "Who trusts both while it lasts (docs/rollover.md):")
    yield from (f"  {row.stack}: {row.how or f'no ({row.evidence})'}" for row in TRUST)


# The steps


def _plan_begin(order: Order) -> Iterator[str]:
    check_begin(order.keystore, order.terms, _settings.now())
    second = order.terms.profile.alternative_key
    kinds = f"{order.terms.profile.identity_key.name}{f' and {second.name}' if second else ''}"
    yield f"make an identity CA ({kinds}), which issues nothing yet"
    old = order.keystore.identity_ca.subject_name
    yield f"have all trust it too, behind {old}, which still issues"
    if order.keystore.has_revocation_list:
        yield "remove the revocation list, which names nobody: it would be of one CA only"


def _begin(order: Order) -> Iterator[str]:
    secret = order.passphrase
    kept = order.keystore.unlock(secret)
    done = begin_overlap(
        order.keystore, order.terms, kept=kept, passphrase=secret, now=_settings.now()
    )
    yield f"{done.overlap.other.subject_name} is trusted too"
    yield f"{done.overlap.issuing.subject_name} still issues"
    if done.dropped_list:
        yield "the revocation list, which named nobody, is gone"


def _plan_switch(order: Order) -> Iterator[str]:
    overlap = Overlap.that_is(order.keystore, Phase.BEGUN)
    plan = plan_rollover(order.keystore, order.terms, now=_settings.now(), within_overlap=True)
    yield f"issue by {overlap.other.subject_name} from now on"
    if plan.keeping:
        yield f"certify {whom(plan.keeping)} again, with the same keys"
    if plan.rekeyed:
        yield f"issue {whom(plan.rekeyed)} anew, with new keys"
    yield (f"keep the old CA in {plan.archive}" if not plan.destroy else "destroy the old key")
    yield f"have all trust {overlap.issuing.subject_name} still"


def _switch(order: Order) -> Iterator[str]:
    secret = order.passphrase
    kept = order.keystore.unlock(secret)
    done = switch_overlap(
        order.keystore, order.terms, kept=kept, passphrase=secret, now=_settings.now()
    )
    yield f"generation {done.generation}: identity CA, {whom(done.issued)} anew"
    yield f"{kept.identity.certificate.subject_name} is trusted still"


def _plan_finish(order: Order) -> Iterator[str]:
    overlap = Overlap.that_is(order.keystore, Phase.SWITCHED)
    yield f"have all trust {overlap.issuing.subject_name} alone"
    yield f"cut off whoever has a certificate of {overlap.other.subject_name} still"


def _finish(order: Order) -> Iterator[str]:
    overlap = finish_overlap(order.keystore, now=_settings.now())
    yield f"{overlap.other.subject_name} is trusted no more"


def _plan_cancel(order: Order) -> Iterator[str]:
    overlap = Overlap.that_is(order.keystore, Phase.BEGUN)
    yield f"have all trust {overlap.issuing.subject_name} alone, as before"
    yield f"destroy the key of {overlap.other.subject_name}, which has issued nothing"


def _cancel(order: Order) -> Iterator[str]:
    overlap = cancel_overlap(order.keystore, now=_settings.now())
    yield f"{overlap.other.subject_name} is trusted no more, and its key destroyed"


def whom(participants: Sized) -> str:
    """1 participant, 2 participants."""
    return _printing.counted(len(participants), "participant")


_HOW = frozenset({"name", "validity", "rekey", "destroy", "no_passphrase"})
_ROUNDS = {
    Step.BEGIN: _Round(
        planned=_plan_begin,
        taken=_begin,
        robots=(_BRING, _PINS, "when all have it, `pqsec ca rotate --overlap switch`"),
        options=frozenset({"name", "validity"}),
    ),
    Step.SWITCH: _Round(
        planned=_plan_switch,
        taken=_switch,
        robots=(_BRING, "when all have it, `pqsec ca rotate --overlap finish`"),
        options=frozenset({"rekey", "destroy"}),
    ),
    Step.FINISH: _Round(planned=_plan_finish, taken=_finish, robots=(_BRING, _PINS)),
    Step.CANCEL: _Round(planned=_plan_cancel, taken=_cancel, robots=(_BRING, _PINS)),
}
