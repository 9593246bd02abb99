"""pqsec domain: write a domain file from what there is, and its schema."""

from itertools import groupby
from pathlib import Path

import click

from pqsec_pki import _files
from pqsec_pki.cli import _help, _policy, _printing, _settings
from pqsec_pki.documents import DomainSet
from pqsec_pki.domain import Imported, import_domain


@_help.group()
@_settings.command_options
def domain() -> None:
    """Write a domain file from keystores and policies."""


@domain.command(
    "import",
    examples={
        "Describe the keystore in one file": "pqsec domain import -o imported.yaml",
        "Describe an SROS2 keystore, and show the file": ("pqsec domain import sros2-keystore"),
    },
    exit_codes={
        0: "the file is written",
        1: "SOURCE is not valid, or a participant is left out because its files are wrong",
        3: "SOURCE cannot be read, or the file cannot be written",
    },
)
@click.argument("sources", nargs=-1, type=_settings.PATH, metavar="[SOURCE]...")
@click.option(
    "--domain",
    "domains",
    default="0",
    show_default=True,
    help="The DDS domains of SROS2 policies: 0, or 0-3, or 0,5.",
)
@_policy.output_options
@_settings.command_options
def import_(sources: tuple[Path, ...], domains: str, output: Path | None, *, force: bool) -> None:
    """Write a domain file that describes what is there.

    SOURCE is a keystore, also one of SROS2; or permissions or governance, as XML, signed or not,
    or YAML; or an SROS2 policy. Without SOURCE it is the keystore of -k. Participants with the
    same rights share a role. `pqsec plan` then finds nothing to change in the keystore.

    Revoked and expired participants are left out, and named. Signatures are checked in
    keystores only.
    """
    paths = sources or (_settings.keystore_path(),)
    found = import_domain(paths, now=_settings.now(), domains=DomainSet.parse(domains))
    _put(found, output, force=force)
    for note in found.notes:
        _printing.note(note)
    by_reason = sorted(found.left_out, key=lambda each: (each.why, each.name))
    for why, some in groupby(by_reason, key=lambda each: each.why):
        _printing.note(f"left out: {_printing.few(each.name for each in some)} ({why})")
    if any(each.refused for each in found.left_out):
        click.get_current_context().exit(1)


def _put(found: Imported, output: Path | None, *, force: bool) -> None:
    """Write or print the file; with --json also what it is made of."""
    value: dict[str, object] = {
        "participants": found.participants,
        "roles": found.roles,
        "left_out": found.left_out,
        "notes": found.notes,
    }
    text = found.document.decode()
    if output is None:
        _printing.emit({"document": text, **value}, [text.removesuffix("\n")], verbatim=True)
        return
    _files.write(output, found.document, force=force)
    counted = _printing.counted
    numbers = [counted(len(found.participants), "participant"), counted(len(found.roles), "role")]
    _printing.emit({"written": output, **value}, [f"{output}: {', '.join(numbers)}"])
