"""pqsec inspect: describe a file."""

from pathlib import Path

import click

from pqsec_pki._files import read
from pqsec_pki.cli import _help, _pager, _printing, _settings
from pqsec_pki.errors import located
from pqsec_pki.inspection import Description, describe


@_help.command(
    examples={
        "Describe a certificate": "pqsec inspect robots/enclaves/talker/cert.pem",
        "Describe several files": "pqsec inspect robot1.csr robots/enclaves/governance.xml",
    },
    exit_codes={
        0: "described",
        1: "a document is not valid",
        3: "a file cannot be read, or its kind is not known",
    },
)
@click.argument(
    "files",
    nargs=-1,
    required=True,
    type=_settings.FILE,
    metavar="FILE...",
)
@_pager.option
@_settings.command_options
def inspect(files: tuple[Path, ...]) -> None:
    """Describe a certificate, key, request or document.

    FILE is a certificate, a private or public key, a request or a revocation list, in
    PEM or DER; or a governance or permissions document, signed or not. Signatures are not
    checked: use `pqsec verify`. The private part of a key is not shown.
    """
    described = [(file, _described(file)) for file in files]
    lines: list[str] = []
    for file, description in described:
        first, *rest = description.to_text()
        lines += [f"{file}: {first}", *rest]
    values = [{"file": str(file), **each.to_json()} for file, each in described]
    _printing.emit({"files": values}, lines)


def _described(file: Path) -> Description:
    data = read(file)
    with located(file):
        return describe(data, now=_settings.now())
