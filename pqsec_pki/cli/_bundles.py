"""Shared by the commands that write bundles: options, and reading requests and keys."""

from collections.abc import Sequence
from pathlib import Path

import click

from pqsec_pki import _files
from pqsec_pki.algorithms import SealingPublicKey
from pqsec_pki.certificates import CertificateRequest
from pqsec_pki.cli import _settings
from pqsec_pki.errors import located

folder_option = click.option(
    "--bundles",
    "folder",
    type=_settings.FOLDER,
    metavar="DIR",
    help="Write bundles into DIR. [default: the current folder]",
)
seal_option = click.option(
    "--seal-for",
    type=_settings.FILE,
    metavar="FILE",
    help="Encrypt the bundle for one robot: FILE is its bundle.pub.pem, from `pqsec bundle-key`.",
)

compromised_option = click.option(
    "--reuse-compromised-key",
    "compromised_keys",
    is_flag=True,
    help="Also certify a key that was revoked as compromised. Anybody else who has the key can"
    " impersonate that participant.",
)


def load_requests(paths: Sequence[Path]) -> list[tuple[Path, CertificateRequest]]:
    """The requests in these PEM files, each of which may have several. Errors name the file."""
    found = []
    for path in paths:
        with located(path):
            found += [(path, each) for each in CertificateRequest.all_from_pem(_files.read(path))]
    return found


def recipient(path: Path | None) -> SealingPublicKey | None:
    """The public key to encrypt a bundle for, or None."""
    if path is None:
        return None
    with located(path):
        return SealingPublicKey.from_pem(_files.read(path))
