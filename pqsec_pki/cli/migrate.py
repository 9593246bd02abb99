"""pqsec migrate: plan and rehearse the change to a post-quantum profile."""

from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path

import click

from pqsec_pki import _files
from pqsec_pki.algorithms import Profile, profile_named
from pqsec_pki.cli import _help, _migration_options, _passphrases, _printing, _settings
from pqsec_pki.cli.ca import Profiles
from pqsec_pki.keystore import Keystore
from pqsec_pki.migration import (
    MigrationPlan,
    Rehearsal,
    StepFile,
    plan_addition,
    plan_migration,
    rehearse,
    rehearse_addition,
    step_files,
)


@_help.group()
@_settings.command_options
def migrate() -> None:
    """Plan and rehearse the change to a post-quantum profile."""


@migrate.command(
    examples={
        "Show the steps to profile pq for robots with Cyclone DDS": (
            "pqsec migrate plan --stack cyclonedds"
        ),
        "Show how hybrid credentials are added beside classical ones": (
            "pqsec migrate plan --to classical,hybrid"
        ),
        "Rehearse the steps to CNSA 2.0 on a copy": "pqsec migrate plan --to cnsa2 --rehearse",
        "Write a domain file for each step, for `pqsec apply`": (
            "pqsec migrate plan domain.yaml --steps ."
        ),
    },
    exit_codes={
        0: "the steps are shown, and the rehearsal succeeded",
        1: "in the rehearsal, participants did not authenticate each other",
        3: "the keystore or FILE cannot be read, or a step's file cannot be written",
    },
)
@click.argument("file", type=_settings.FILE, required=False, metavar="[FILE]")
@click.option(
    "--to",
    "target",
    type=Profiles(),
    default="pq",
    show_default=True,
    metavar="PROFILE[,PROFILE]...",
    help="Plan the change to this profile; or, with those of the keystore before it, its addition.",
)
@_migration_options.stacks
@click.option(
    "--rehearse",
    "rehearsing",
    is_flag=True,
    help="Also make all changes on a copy, and run handshakes between old and new files.",
)
@click.option(
    "--steps",
    "folder",
    type=_settings.FOLDER,
    metavar="DIR",
    help="Write to DIR a domain file for each step, with which `pqsec apply` makes it.",
)
@click.option("--force", is_flag=True, help="Replace existing files in DIR.")
@_passphrases.option
@_settings.command_options
def plan(  # noqa: PLR0913 -- one for each option, by name
    file: Path | None,
    target: tuple[str, ...],
    stacks: tuple[str, ...],
    folder: Path | None,
    passphrase_file: Path | None,
    *,
    rehearsing: bool,
    force: bool,
) -> None:
    """Show the steps to a post-quantum profile, and rehearse them on a copy.

    For each step: what robots with each stack need, whether robots can change one by one, and
    what breaks without the step. This is found by handshakes between sample participants,
    in the same code as `pqsec verify-handshake`. The keystore is not changed. FILE is a
    domain.yaml with `stacks`, those of the robots. The passphrase is for a rehearsal that adds
    profiles: the CAs of the copy sign what is added.
    """
    keystore, now = _settings.open_keystore(), _settings.now()
    profiles = [profile_named(each) for each in target]
    rows = _migration_options.chosen(stacks, file)
    if len(profiles) > 1:
        found = plan_addition(keystore, profiles, rows, now=now)
    else:
        found = plan_migration(keystore, profiles[0], rows, now=now)
    rehearsal = _rehearsed(keystore, profiles, passphrase_file, now) if rehearsing else None
    files = step_files(found, keystore, file, folder, now=now) if folder else ()
    paths = _write_steps(files, folder, force=force) if folder else []
    value = found.to_json()
    lines = [*_plan_lines(found, now)]
    if folder:
        value["files"] = paths
        lines += ["", *(f"pqsec apply {path}" for path in paths)]
    if rehearsal is not None:
        value["rehearsal"] = rehearsal
        lines += ["", *_rehearsal_lines(rehearsal)]
    if any(step.lost for step in found.steps):
        _printing.note(
            f"profile {found.target} protects less against quantum computers than profile"
            f" {found.before}: see `lost`"
        )
    _printing.emit(value, lines)
    if rehearsal is not None and not rehearsal.ok:
        click.get_current_context().exit(1)


def _rehearsed(
    keystore: Keystore, profiles: Sequence[Profile], passphrase_file: Path | None, now: datetime
) -> Rehearsal:
    if len(profiles) == 1:
        return rehearse(keystore, profiles[0], now=now)
    passphrase = _passphrases.of_cas(keystore, passphrase_file)
    return rehearse_addition(keystore, profiles, passphrase=passphrase, now=now)


def _write_steps(files: Sequence[StepFile], folder: Path, *, force: bool) -> list[Path]:
    """Write the domain file of each step, or none; returns the paths."""
    paths = [folder / each.name for each in files]
    if not force:
        for path in paths:
            _files.refuse_existing(path)
    with _files.disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    for path, each in zip(paths, files, strict=True):
        _files.write(path, each.document, force=force)
    return paths


def _plan_lines(plan: MigrationPlan, now: datetime) -> Iterator[str]:
    counted = _printing.counted(len(plan.steps), "step")
    yield f"from profile {plan.before} to {plan.target}: {counted}"
    for number, step in enumerate(plan.steps, 1):
        yield ""
        yield from step.lines(number)
    yield ""
    yield "Dates:"
    for each in plan.deadlines:
        passed = " (passed)" if each.day < now.date() else ""
        yield f"  {each.day}{passed}  {each.what}"
        yield f"              {each.source}"


def _rehearsal_lines(rehearsal: Rehearsal) -> Iterator[str]:
    sample, all_ = len(rehearsal.sample), rehearsal.participants
    part = f"a sample of {sample} of {all_}" if sample < all_ else str(all_)
    yield f"Rehearsal on a copy, with {part} participants:"
    for step in rehearsal.steps:
        done = _printing.counted(step.succeeded, "pair")
        what = "added for" if "," in step.profile else "reissued"
        issued = f"{what} {step.reissued}" if "," in step.profile else f"{step.reissued} {what}"
        yield f"  {step.profile}: {issued}, {done} authenticated each other"
        yield from (f"    not: {each}" for each in step.failures)
        yield from (f"    not reissued: {name}: {why}" for name, why in step.left_out.items())
        if step.old_with_new_refused:
            yield f"    old files with new files: {step.old_with_new_refused} refused"
            yield f"      {step.reason}"
        if step.old_with_new:
            yield f"    old files with new files: {step.old_with_new} authenticated"
