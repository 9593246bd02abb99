"""pqsec report: write a report of the keystore for people, or for programs."""

import sys
from pathlib import Path
from shlex import join

import click

from pqsec_pki._files import refuse_existing, write
from pqsec_pki.cli import _help, _printing, _settings
from pqsec_pki.errors import KeystoreError
from pqsec_pki.report import (
    Changes,
    Report,
    changes_since,
    csv_of,
    html_of,
    read_earlier,
    report_of,
)


@_help.command(
    examples={
        "Write a page for any browser": "pqsec report -o report.html",
        "Keep the data, to compare the next report with": "pqsec report --format json -o june.json",
        "Show what changed since an earlier one": "pqsec report --compare may.json -o june.html",
    },
    exit_codes={
        0: "the report is written",
        3: "incomplete: something could not be read or is not valid, and the report says what;"
        " or there is no report",
    },
)
@click.option(
    "--format",
    "form",
    type=click.Choice(["html", "json", "csv"]),
    default="html",
    show_default=True,
    help="Write in this format.",
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
@_settings.command_options
def report(form: str, output: Path | None, earlier: Path | None, *, force: bool) -> None:
    """Write a report of the keystore: who may command what, what ends when, and what changed.

    The page is one file that loads nothing, for a browser or a printer. It also shows what a
    quantum computer would break, the findings of `pqsec check`, and evidence: the ledger's head
    and the fingerprints of the CAs. No private key is needed. The report shows policy and
    weaknesses: it is readable for its owner only.
    """
    if output and not force:
        refuse_existing(output)
    before = read_earlier(earlier) if earlier else None
    keystore = _settings.open_keystore()
    found = report_of(keystore, now=_settings.now(), command=join(["pqsec", *sys.argv[1:]]))
    changes = changes_since(before, found, keystore) if before else None
    form = "json" if _settings.settings().json else form
    text = _text(form, found, changes)
    if output:
        write(output, text.encode(), private=True, force=force)
    else:
        _printing.say(text.rstrip("\n"))
    if found.gaps:
        for gap in found.gaps:
            _printing.note(f"incomplete: {gap.section}: {gap.reason}")
        raise KeystoreError(
            "the report is incomplete: a part could not be read or is not valid",
            hint="the report begins with what it lacks; `pqsec check` has the reasons",
        )


def _text(form: str, found: Report, changes: Changes | None) -> str:
    if form == "html":
        return html_of(found, changes)
    if form == "csv":
        return csv_of(found, changes)
    return _printing.as_json({**found.to_json(), "changes": changes}) + "\n"
