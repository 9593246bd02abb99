"""The key of somebody who proposes or approves: in a file, or in a token."""

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pqsec_pki.cli import _passphrases, _settings
from pqsec_pki.errors import UsageError, VerificationError, located

if TYPE_CHECKING:
    from pqsec_pki.algorithms import PrivateKey
    from pqsec_pki.approvals import ApprovalPolicy

VARIABLE = "PQSEC_KEY_PASSPHRASE_FILE"
_URI = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:")


def passphrase_option(command: _settings.Command) -> _settings.Command:
    """Add --key-passphrase-file to a command with --key."""
    add = click.option(
        "--key-passphrase-file",
        type=_settings.FILE,
        envvar=VARIABLE,
        help="Read the passphrase of that key from the first line of this file.",
    )
    return add(command)


def key_at(place: str, passphrase_file: Path | None) -> "PrivateKey":
    """The private key in the file `place`, or with that URI."""
    from pqsec_pki._files import read  # noqa: PLC0415 -- not for --help
    from pqsec_pki.algorithms import is_encrypted, load_private_key  # noqa: PLC0415
    from pqsec_pki.tokens import find_key, is_reference, uri_in  # noqa: PLC0415

    if _URI.match(place):
        return find_key(place, _passphrases.pin)
    if not place:
        raise UsageError("the path of the key is empty")
    path = Path(place)
    data = read(path)
    with located(path):
        if is_reference(data):
            return find_key(uri_in(data), _passphrases.pin)
        secret = _passphrase(passphrase_file) if is_encrypted(data) else None
        return load_private_key(data, secret)


def _passphrase(file: Path | None) -> bytes:
    if file:
        return _passphrases.first_line(file)
    if not sys.stdin.isatty():
        raise UsageError(
            "the key is encrypted, and there is no terminal to ask for the passphrase",
            hint=f"use --key-passphrase-file FILE, or set {VARIABLE}",
        )
    return _passphrases.asked("Passphrase of your key")


def name_in(policy: "ApprovalPolicy | None", key: "PrivateKey") -> str:
    """The approver whose key it is, empty without a policy; VerificationError for another key."""
    if policy is None:
        return ""
    if name := policy.name_of(key.public_key):
        return name
    raise VerificationError(
        f"this {key.algorithm.name} key is of none of the approvers: {', '.join(policy.approvers)}",
        hint="an approved plan can add it to `approvals` in the domain file",
    )
