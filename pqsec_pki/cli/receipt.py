"""pqsec receipt: record what robots run."""

from pathlib import Path

import click

from pqsec_pki._times import said
from pqsec_pki.cli import _help, _printing, _settings
from pqsec_pki.enrolment import ImportedReceipt, import_receipts


@_help.group()
@_settings.command_options
def receipt() -> None:
    """Record what robots run, from the receipts that `pqsec install` writes."""


@receipt.command(
    "import",
    examples={
        "Record what a robot runs": "pqsec receipt import credentials/installed.receipt",
        "Record what a robot runs that was restored from a backup": (
            "pqsec receipt import credentials/installed.receipt --older"
        ),
    },
    exit_codes={
        0: "recorded, now or earlier",
        1: (
            "nothing is recorded: a signature is not valid, the certificate was not issued here,"
            " all of a file are revoked, or a newer receipt is recorded"
        ),
        3: "a file cannot be read or is not a receipt, or the keystore cannot be changed",
    },
)
@click.argument("files", nargs=-1, required=True, type=_settings.FILE, metavar="FILE...")
@click.option(
    "--older",
    is_flag=True,
    help="Also record a receipt of a robot restored from a backup.",
)
@_settings.command_options
def import_(files: tuple[Path, ...], *, older: bool) -> None:
    """Record what robots run, from the receipts that `pqsec install` writes.

    FILE is DIR/installed.receipt of a robot. Each of its participants must have signed with all
    keys of a certificate that this keystore issued to it. If the certificate was renewed since, the
    robot is outdated. Receipts are recorded in the ledger, all or none, but not those of revoked
    certificates. Then `pqsec status` shows what each robot runs, and what it should run.

    Receipts are ordered by the numbers that the robot gives them, not by its clock. After a backup
    was restored there, its numbers are smaller than those recorded: import one with --older.
    """
    keystore = _settings.open_keystore(to_change=True)
    done = import_receipts(keystore, files, now=_settings.now(), older=older)
    _printing.emit({"receipts": done}, map(_line, done))
    for each in done:
        if each.clock:
            _printing.note(f"{each.path}: {each.receipt.participant}: {each.clock}")


def _line(each: ImportedReceipt) -> str:
    receipt = each.receipt
    if each.revoked:
        return f"{receipt.participant}  not recorded: its certificate was revoked  {each.path}"
    number = "without a number" if receipt.bundle is None else receipt.bundle
    word = "was recorded before" if each.already else "recorded"
    installed = f"installed {said(receipt.installed_at)}"
    return f"{receipt.participant}  {word}: bundle {number}, {installed}  {each.path}"
