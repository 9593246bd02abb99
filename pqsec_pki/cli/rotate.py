"""pqsec ca rotate: replace the CAs, with a plan of the consequences."""

from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import click

from pqsec_pki.algorithms import PROFILES, Profile, profile_named
from pqsec_pki.approvals import Covered
from pqsec_pki.cli import _help, _key_uris, _overlap, _passphrases, _printing, _rollover, _settings
from pqsec_pki.cli._confirmation import confirm
from pqsec_pki.errors import KeystoreError, UsageError
from pqsec_pki.keystore import Keystore, key_algorithms
from pqsec_pki.lifecycle import (
    CA_VALIDITY,
    OverlapStep,
    Rollover,
    RolloverPlan,
    Scope,
    apply_rollover,
    plan_rollover,
    refuse_keys_in_files,
)


@_help.command(
    examples={
        "Show what a new profile changes and breaks": "pqsec ca rotate --profile pq",
        "Replace both CAs": "pqsec ca rotate --apply --yes --passphrase-file passphrase",
        "Begin to replace the identity CA, robot by robot": (
            "pqsec ca rotate --overlap begin --apply --passphrase-file passphrase"
        ),
    },
    exit_codes={
        0: "the plan is shown; with --apply, the CAs are replaced",
        1: "not replaced: a document is not valid",
        3: "not replaced: the keystore, its state or the passphrase is missing or wrong",
    },
)
@click.option("--plan", is_flag=True, help="Show what would be done and what breaks.  [default]")
@click.option("--apply", "do", is_flag=True, help="Replace the CAs.")
@click.option(
    "--set",
    "set_name",
    metavar="PROFILE",
    help="Replace the CAs of the credentials of this profile, if the keystore has several sets.",
)
@click.option("--yes", is_flag=True, help="With --apply: do not ask for confirmation.")
@click.option(
    "--profile",
    "profile_name",
    type=click.Choice([profile.name for profile in PROFILES], case_sensitive=False),
    help="Change to this profile.  [default: no change]",
)
@click.option(
    "--only",
    "scope",
    type=click.Choice([Scope.IDENTITY.value, Scope.PERMISSIONS.value]),
    help="Replace only this CA.  [default: replace both]",
)
@click.option(
    "--overlap",
    type=click.Choice([step.value for step in OverlapStep]),
    help="Make one step of a change during which robots trust the old and the new identity CA.",
)
@click.option(
    "--name", help="Start the names of the new CAs with this.  [default: as before, with G2, G3]"
)
@click.option(
    "--validity",
    type=_settings.Duration(),
    default=CA_VALIDITY,
    help="Issue the CA certificates for this long.  [default: 10y]",
)
@click.option(
    "--rekey", is_flag=True, help="Also replace participants' keys whose kind does not change."
)
@click.option(
    "--destroy-old-keys",
    "destroy",
    is_flag=True,
    help="Overwrite the old CA keys, and do not keep them.",
)
@_key_uris.options
@_passphrases.option
@_passphrases.weak_option
@click.option("--no-passphrase", is_flag=True, help="Leave the new CA keys unencrypted.")
@_settings.command_options
def rotate(
    passphrase_file: Path | None,
    *,
    plan: bool,
    do: bool,
    yes: bool,
    no_passphrase: bool,
    **asked: Any,
) -> None:
    """Replace the CAs and reissue everything they signed, or change the profile.

    Participants keep their rights, and their keys unless the profile needs another kind.
    The passphrase of the old CAs is needed only with --only or --overlap.

    Of several sets of credentials, one is changed at a time, and the files of the others stay as
    they are. Its participants keep the ends of their certificates, and its new CA keys get the
    passphrase of the others.

    With --overlap, robots change to a new identity CA one after the other, if their stack
    can trust two. The steps are begin, switch and finish; copy the files to the robots
    after each step.
    """
    if plan and do:
        raise UsageError("--plan and --apply exclude each other")
    keystore = _chosen(_settings.open_keystore(to_change=do), asked.pop("set_name"))
    if do:
        keystore.refuse_unapproved(Covered.ROTATE)
    terms = _terms(keystore, **asked)
    if terms.overlap:
        _overlap.refuse_options(terms.overlap)
    with keystore.hold() if do else nullcontext():  # no other command is in the middle of a change
        planned = plan_rollover(keystore, terms, now=_settings.now())
    if not do:
        _show(planned)
        return
    asks = not yes and _ends_something(terms)
    if asks:
        _ask(planned)
    _apply(keystore, planned, passphrase_file, no_passphrase=no_passphrase, confirmed=asks)


_OWN = {"plan", "do", "yes", "no_passphrase", "passphrase_file", "set_name"}


def steps_of(keystore: Keystore, params: Mapping[str, Any]) -> tuple[str, ...]:
    """What the command does with these values of its options; errors as of `plan_rollover`."""
    chosen = _chosen(keystore, params["set_name"])
    terms = _terms(chosen, **{key: params[key] for key in params.keys() - _OWN})
    return plan_rollover(chosen, terms, now=_settings.now()).steps


def _chosen(keystore: Keystore, profile: str | None) -> Keystore:
    """The set of that profile; UsageError if none is named, and there are several."""
    if profile:
        return keystore.of_profile(profile)
    if len(keystore.profiles) > 1:
        names = ", ".join(each.name for each in keystore.profiles)
        raise UsageError(f"the keystore has several sets: name one with --set: {names}")
    return keystore


def _terms(
    keystore: Keystore,
    *,
    profile_name: str | None,
    scope: str | None,
    overlap: str | None,
    **how: Any,
) -> Rollover:
    return Rollover(
        profile=_profile(keystore, profile_name),
        scope=Scope(scope) if scope else Scope.IDENTITY if overlap else Scope.BOTH,
        overlap=OverlapStep(overlap) if overlap else None,
        **how,
    )


def _show(plan: RolloverPlan) -> None:
    if plan.terms.overlap:
        _overlap.show(plan.terms.overlap, plan)
    else:
        _rollover.show(plan)


def _ends_something(terms: Rollover) -> bool:
    """Whether a CA is no longer trusted afterwards, or a key is destroyed."""
    return terms.destroy or terms.overlap not in {OverlapStep.BEGIN, OverlapStep.SWITCH}


def _ask(plan: RolloverPlan) -> None:
    match plan.terms.overlap:
        case OverlapStep.FINISH:
            what = "an identity CA would no longer be trusted"
        case OverlapStep.CANCEL:
            what = "the new identity CA would no longer be trusted, and its key be destroyed"
        case OverlapStep.SWITCH:
            what = "the key of the old identity CA would be destroyed"
        case _:
            what = f"the {_rollover.CAS[plan.terms.scope]} would be replaced"
    confirm(
        lambda: _show(plan),
        "Make these changes?",
        what=what,
        hint="without --apply, `pqsec ca rotate` shows the changes; --yes makes them",
    )


def _profile(keystore: Keystore, name: str | None) -> Profile:
    """The named profile; without a name, the keystore's, with the algorithms chosen there."""
    if name is None or name == keystore.profile.name:
        return keystore.profile
    return profile_named(name)


def _apply(
    keystore: Keystore,
    plan: RolloverPlan,
    passphrase_file: Path | None,
    *,
    no_passphrase: bool,
    confirmed: bool,
) -> None:
    terms, uris = plan.terms, _key_uris.given()
    kept, passphrase = None, None
    refuse_keys_in_files(keystore, terms, uris)
    stays = plan.others and keystore.has_keys_in_files(without=(plan.set_name,))
    if no_passphrase and stays:
        raise UsageError(
            "the keys of all sets of credentials have one passphrase",
            hint="leave out --no-passphrase; `pqsec ca passphrase` changes it",
        )
    if plan.needs_old_cas or plan.needs_other_sets:
        without = () if plan.needs_old_cas else (plan.set_name,)
        passphrase = _passphrases.of_cas(keystore, passphrase_file, without=without)
        kept = _passphrases.unlocked(keystore, passphrase, without=without)
    algorithms = {name: key_algorithms(terms.profile)[name] for name in terms.new_keys}
    with _key_uris.keys(algorithms, uris) as keys:
        # the keys of an overlap, and of one of several sets, have the passphrase of those that stay
        if not (terms.overlap or stays) and len(keys) < len(key_algorithms(terms.profile)):
            passphrase = _passphrases.new(passphrase_file, none=no_passphrase)
        with keystore.hold():
            done = apply_rollover(
                keystore,
                _current(keystore, plan, confirmed=confirmed),
                kept=kept,
                passphrase=passphrase,
                pin=_passphrases.pin,
                keys=keys,
                compares_clock=_passphrases.compares_clock(),
                now=_settings.now(),
            )
    for name, reason in done.plan.left_out.items():
        _printing.note(f"{name} is not reissued: {reason}")
    if terms.overlap:
        _overlap.print_done(terms.overlap, done)
    else:
        _rollover.print_done(done)


def _current(keystore: Keystore, plan: RolloverPlan, *, confirmed: bool) -> RolloverPlan:
    """The plan; made again if another command changed the keystore, or refused if confirmed."""
    if keystore.head == plan.head:
        return plan
    if confirmed:
        raise KeystoreError(
            "another command changed the keystore since the plan was shown",
            hint="run it again, and confirm the new plan",
        )
    return plan_rollover(keystore, plan.terms, now=_settings.now())
