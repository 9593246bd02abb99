"""pqsec adopt: turn a keystore of SROS2 or OpenSSL into a pqsec keystore."""

from pathlib import Path
from shlex import quote

import click

from pqsec_pki.cli import _help, _printing, _settings
from pqsec_pki.cli.check import report_lines
from pqsec_pki.lifecycle import Adopted
from pqsec_pki.lifecycle import adopt as adopt_folder
from pqsec_pki.lint import check


@_help.command(
    examples={
        "Adopt a keystore of SROS2, and check it": "pqsec adopt sros2-keystore",
    },
    exit_codes={
        0: "adopted, whatever the check finds",
        3: "not adopted: the CAs cannot be read, or the folder cannot be written",
    },
)
@click.argument("folder", type=_settings.FOLDER, required=False, metavar="[DIR]")
@_settings.command_options
def adopt(folder: Path | None) -> None:
    """Turn a keystore of SROS2 or OpenSSL into a pqsec keystore, and check it.

    DIR has the layout of an SROS2 keystore; without it, the keystore of -k. Existing files
    do not change: pqsec.json, the ledger and a .gitignore are added. The findings of the check are
    printed, and do not change the exit code.
    """
    now = _settings.now()
    found = adopt_folder(folder or _settings.keystore_path(), gitignore=True, now=now)
    report = check((found.keystore.root,), now=now)
    _printing.emit(
        {
            "keystore": found.keystore.root,
            "profile": found.keystore.profile.name,
            "domains": str(found.keystore.domains),
            "participants": found.participants,
            "refused": found.refused,
            "one_ca": found.one_ca,
            "check": report,
        },
        [*_lines(found), *report_lines(report)],
    )
    if not found.fitting:
        _printing.note("no profile has these kinds of keys: new keys will be classical")
    if found.one_ca:
        _printing.note(
            "one key is both identity CA and permissions CA (CVE-2023-24010), so nothing can be"
            f" issued: `pqsec -k {quote(str(found.keystore.root))} ca rotate` shows how to get"
            " two CAs"
        )


def _lines(found: Adopted) -> list[str]:
    keystore = found.keystore
    count = _printing.counted(len(found.participants), "participant")
    first = f"{keystore.root}: {count}, profile {keystore.profile.name}, {keystore.domains.words}"
    refused = [f"not taken: {place}: {reason}" for place, reason in found.refused.items()]
    return [first, *refused]
