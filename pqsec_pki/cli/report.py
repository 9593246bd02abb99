"""pqsec report: write a report of the keystore for people, or for programs."""

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from shlex import join

import click

from pqsec_pki import migration
from pqsec_pki._files import read, refuse_existing, write
from pqsec_pki.algorithms import profile_named
from pqsec_pki.certificates import verify_authority
from pqsec_pki.cli import _help, _migration_options, _passphrases, _printing, _settings
from pqsec_pki.credentials import only_certificate
from pqsec_pki.errors import KeystoreError, TooLargeError, UsageError, located
from pqsec_pki.keystore import Keystore, SigningCa, one_set
from pqsec_pki.report import (
    MAX_REPORT,
    Changes,
    Report,
    changes_since,
    csv_of,
    html_of,
    read_earlier,
    report_of,
    signature_path,
    statement_of,
)
from pqsec_pki.smime import Signer, sign
from pqsec_pki.tokens import key_in

_FORMATS = ("html", "json", "csv")


@_help.command(
    examples={
        "Write a page for any browser": "pqsec report -o report.html",
        "Keep the data, to compare the next report with": "pqsec report -o june.json",
        "Show what changed since an earlier one": "pqsec report --compare may.json -o june.html",
        "Sign it; `pqsec verify june.html.p7s` checks it": "pqsec report --sign -o june.html",
        "Add the steps to profile pq for robots with Cyclone DDS": (
            "pqsec report --migrate-to pq --stack cyclonedds -o report.html"
        ),
    },
    exit_codes={
        0: "the report is written",
        1: "not written: the certificate to sign with is not a CA's, or not valid",
        3: "incomplete: something could not be read or is not valid, and the report says what;"
        " or there is no report",
    },
)
@click.option(
    "--format",
    "form",
    type=click.Choice(_FORMATS),
    help="Write in this format.  [default: as the name of FILE ends, else html]",
)
@click.option(
    "-o", "--output", type=_settings.FILE, help="Write to this file.  [default: standard output]"
)
@click.option("--force", is_flag=True, help="Replace the file.")
@click.option(
    "--compare",
    "earlier",
    type=_settings.FILE,
    metavar="OLD.json",
    help="Show what changed since this earlier report, which is JSON.",
)
@_migration_options.target(
    "--migrate-to", help="Add the steps to this profile, as `pqsec migrate plan` shows them."
)
@_migration_options.stacks
@click.option(
    "--domain-file",
    type=_settings.FILE,
    metavar="FILE",
    help="Plan for the stacks that this domain.yaml names.",
)
@click.option(
    "--sign",
    "is_signed",
    is_flag=True,
    help="Sign the report with the permissions CA, in a file beside it with .p7s.",
)
@click.option(
    "--signer",
    nargs=2,
    type=_settings.FILE,
    metavar="CERT KEY",
    help="Sign it with this CA's certificate and private key instead.",
)
@click.option(
    "--set",
    "profile",
    metavar="PROFILE",
    help="Sign it with the permissions CA of this profile, if the keystore has several.",
)
@_passphrases.option
@_settings.command_options
def report(  # noqa: PLR0913 -- one for each option, by name
    form: str | None,
    output: Path | None,
    earlier: Path | None,
    signer: tuple[Path, Path] | None,
    passphrase_file: Path | None,
    *,
    profile: str | None,
    target: str | None,
    stacks: tuple[str, ...],
    domain_file: Path | None,
    is_signed: bool,
    force: bool,
) -> None:
    """Write a report of the keystore: who may command what, what ends when, and what changed.

    The page is one file that loads nothing, for a browser or a printer. It also shows what a
    quantum computer would break, the findings of `pqsec check`, and evidence: the ledger's head
    and the fingerprints of the CAs. No private key is needed, except to sign it. The report shows
    policy and weaknesses: it is readable for its owner only.
    """
    is_signed = is_signed or signer is not None
    form = "json" if _settings.settings().json else form or _named_form(output)
    _refuse_places(form, output, is_signed=is_signed, force=force)
    if profile and (signer or not is_signed):
        raise UsageError("--set chooses the CA that signs with --sign")
    before = read_earlier(earlier) if earlier else None
    keystore = _settings.open_keystore()
    planning = _planning(keystore, target, stacks, domain_file)
    signing = None
    if is_signed:
        signed_by = keystore if signer else one_set(keystore, profile)
        signing = _signing(signed_by, signer, passphrase_file)
    command = join(["pqsec", *sys.argv[1:]])
    found = report_of(keystore, now=_settings.now(), command=command, migration=planning)
    changes = changes_since(before, found, keystore) if before else None
    text = _text(form, found, changes)
    if output:
        _write(output, text.encode(), signing, force=force)
    else:
        _printing.say(text.rstrip("\n"))
    _refuse_gaps(found)


def _named_form(output: Path | None) -> str:
    """The format that the name of the file says."""
    suffix = output.suffix.removeprefix(".") if output else ""
    return suffix if suffix in _FORMATS else _FORMATS[0]


def _refuse_places(form: str, output: Path | None, *, is_signed: bool, force: bool) -> None:
    """Refuse where the report or its signature would be written, before any work."""
    if output is None:
        if is_signed:
            raise UsageError("a signature is written beside the report", hint="name it: -o FILE")
        if form == "html" and sys.stdout.isatty():
            raise UsageError(
                "a page is for a browser, not for a terminal", hint="write it: -o report.html"
            )
    elif not force:
        refuse_existing(output)
        if is_signed:
            refuse_existing(signature_path(output))


def _write(
    output: Path, data: bytes, signing: Callable[[bytes], bytes] | None, *, force: bool
) -> None:
    hint = "without -o it has no limit; then neither --compare nor `pqsec verify` reads it"
    TooLargeError.check("the report", len(data), MAX_REPORT, hint=hint)
    signature = signing(statement_of(output, data)) if signing else None
    write(output, data, private=True, force=force)
    if signature:
        write(signature_path(output), signature, private=True, force=force)


def _refuse_gaps(found: Report) -> None:
    """KeystoreError if the report is incomplete; a note for each gap."""
    for gap in found.gaps:
        _printing.note(f"incomplete: {gap.section}: {gap.reason}")
    if found.gaps:
        raise KeystoreError(
            "the report is incomplete: a part could not be read or is not valid",
            hint="the report begins with what it lacks; `pqsec check` has the reasons",
        )


def _planning(
    keystore: Keystore, target: str | None, stacks: tuple[str, ...], domain_file: Path | None
) -> Callable[[], migration.MigrationPlan] | None:
    """A function that plans the migration to `target`; None without a target."""
    if target is None:
        if stacks or domain_file:
            raise UsageError(
                "--stack and --domain-file are for a migration",
                hint="name the profile to change to: --migrate-to",
            )
        return None
    rows = _migration_options.chosen(stacks, domain_file)
    profile = profile_named(target)
    return lambda: migration.plan_migration(keystore, profile, rows, now=_settings.now())


def _signing(
    keystore: Keystore, signer: tuple[Path, Path] | None, passphrase_file: Path | None
) -> Callable[[bytes], bytes]:
    """A function that signs a text as S/MIME, with its certificate in it."""
    if signer is None:
        every = _passphrases.unlock(keystore, passphrase_file, SigningCa.PERMISSIONS).sets
        authorities = next(each for each in every if each.set_name == keystore.set_name)
        return partial(authorities.sign, now=_settings.now(), embed_certificate=True)
    place, key_file = signer
    certificate = only_certificate(read(place), str(place))
    with located(place):  # what `pqsec verify` would refuse
        verify_authority(certificate, now=_settings.now())
    passphrase = _passphrases.of_key(passphrase_file)
    with located(key_file):
        secret = passphrase.encode() if passphrase else None
        key = key_in(read(key_file), secret, _passphrases.pin)
    if key.public_key.spki != certificate.spki:
        raise KeystoreError(f"{key_file} is not the private key of {place}")
    return partial(sign, signer=Signer(certificate, key), now=_settings.now())


def _text(form: str, found: Report, changes: Changes | None) -> str:
    if form == "html":
        return html_of(found, changes)
    if form == "csv":
        return csv_of(found, changes)
    return _printing.as_json({**found.to_json(), "changes": changes}) + "\n"
