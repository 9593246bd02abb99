"""--wire-version: the version of the handshake's messages, for the commands that run handshakes."""

from collections.abc import Callable

import click

from pqsec_pki.algorithms import KeyAgreement
from pqsec_pki.cli._settings import Command
from pqsec_pki.errors import UsageError
from pqsec_pki.handshake import WireVersion

NAME = "--wire-version"


def option(words: str, *, multiple: bool = False) -> Callable[[Command], Command]:
    """The option, as `wire_version`; `words` is its help."""
    first = str(WireVersion.FIRST.value)
    return click.option(
        NAME,
        type=click.Choice([str(each.value) for each in WireVersion]),
        multiple=multiple,
        default=(first,) if multiple else first,
        show_default=True,
        help=words,
    )


def version_of(value: str) -> WireVersion:
    """The version with that number."""
    return WireVersion(int(value))


def refuse_unknown(version: WireVersion, agreement: KeyAgreement, *, stock: bool) -> None:
    """UsageError if messages with `agreement`, or with a stock stack, have one version only."""
    if version is WireVersion.FIRST:
        return
    if stock:
        raise UsageError(
            f"{NAME} {version} is for pqsec peers: stacks' own plugins know version 1 only",
            hint=f"leave out --as, or {NAME}",
        )
    if not agreement.binds_transcript:
        raise UsageError(
            f"messages with {agreement.wire_name} have only version 1",
            hint=f"choose another key agreement (--kem), or leave out {NAME}",
        )
