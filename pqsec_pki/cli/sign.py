"""pqsec sign-governance, pqsec sign-permissions: check a document, then sign it."""

from pathlib import Path

import click

from pqsec_pki._files import read, write
from pqsec_pki.cli import _common
from pqsec_pki.documents import Governance, Kind, Permissions
from pqsec_pki.errors import located


def _options(command: _common.Command) -> _common.Command:
    for option in (
        click.option("--force", is_flag=True, help="Replace the signed file if it is there."),
        click.option(
            "--embed-certificate",
            is_flag=True,
            help="Put the signer's certificate in, even where the profile leaves it out.",
        ),
        click.option(
            "-o",
            "--output",
            type=click.Path(path_type=Path, dir_okay=False),
            help="Where to write. [default: FILE with .p7s]",
        ),
        click.argument("file", type=click.Path(path_type=Path, dir_okay=False)),
    ):
        command = option(command)
    return command


@click.command("sign-governance")
@_options
@_common.passphrase_option
@_common.command_options
def sign_governance(
    file: Path,
    output: Path | None,
    passphrase_file: Path | None,
    *,
    embed_certificate: bool,
    force: bool,
) -> None:
    """Check the governance document FILE against its schema and sign it.

    The keystore's permissions CA signs. Nothing is written if FILE breaks the schema.
    """
    with located(file):
        document = read(file)
        Governance.from_xml(document)
    goal = output or file.with_suffix(".p7s")
    signed = _signed(document, passphrase_file, embed=embed_certificate)
    _finish(Kind.GOVERNANCE, goal, signed, force=force)


@click.command("sign-permissions")
@_options
@_common.passphrase_option
@_common.command_options
def sign_permissions(
    file: Path,
    output: Path | None,
    passphrase_file: Path | None,
    *,
    embed_certificate: bool,
    force: bool,
) -> None:
    """Check the permissions document FILE against its schema and sign it.

    The keystore's permissions CA signs. Nothing is written if FILE breaks the schema.
    """
    with located(file):
        document = read(file)
        Permissions.from_xml(document)
    goal = output or file.with_suffix(".p7s")
    signed = _signed(document, passphrase_file, embed=embed_certificate)
    _finish(Kind.PERMISSIONS, goal, signed, force=force)


def _signed(document: bytes, passphrase_file: Path | None, *, embed: bool) -> bytes:
    authorities = _common.unlock(_common.open_keystore(), passphrase_file)
    return authorities.sign(document, now=_common.now(), embed_certificate=embed)


def _finish(kind: Kind, goal: Path, signed: bytes, *, force: bool) -> None:
    write(goal, signed, force=force)
    _common.open_keystore().record(kind.value, str(goal), signed, _common.now())
    _common.emit({"signed": str(goal), "bytes": len(signed)}, [f"{goal}  ({len(signed)} bytes)"])
