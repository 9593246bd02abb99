"""Shared by the commands that make bundles: reading requests, writing and sealing bundles."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import click

from pqsec_pki import _files
from pqsec_pki.algorithms import Profile, SealingPublicKey
from pqsec_pki.certificates import CertificateRequest
from pqsec_pki.cli import _settings
from pqsec_pki.enrolment import Bundle, flat_name, save, seal, validate_csrs
from pqsec_pki.errors import UsageError, located
from pqsec_pki.lifecycle import ParticipantSpec, PublicKeys

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


def load_requests(paths: Sequence[Path]) -> list[CertificateRequest]:
    """The requests in these PEM files. Errors name the file."""
    found = []
    for path in paths:
        with located(path):
            found.append(CertificateRequest.from_pem(_files.read(path)))
    return found


def read_requests(
    paths: Sequence[Path], profile: Profile, names: Collection[str], patterns: Collection[str]
) -> dict[str, PublicKeys]:
    """The keys to certify, by name; empty without files. Errors if a request is not allowed."""
    if not paths:
        return {}
    return validate_csrs(load_requests(paths), profile, names=names, patterns=patterns)


def with_keys(spec: ParticipantSpec, asked: Mapping[str, PublicKeys]) -> ParticipantSpec:
    """The spec with the keys of its request, if there is one."""
    return replace(spec, keys=asked.get(spec.name))


def goals(names: Collection[str], folder: Path | None, *, force: bool) -> dict[str, Path]:
    """The path of each name's bundle. ExistsError if a file exists, unless `force`."""
    found = {name: (folder or Path()) / f"{flat_name(name)}.bundle" for name in names}
    if not force:
        for goal in found.values():
            _files.refuse_existing(goal)
    return found


def recipient(path: Path | None) -> SealingPublicKey | None:
    """The public key to encrypt a bundle for, or None."""
    if path is None:
        return None
    with located(path):
        return SealingPublicKey.from_pem(_files.read(path))


def write(
    bundle: Bundle,
    goal: Path,
    sealed_for: SealingPublicKey | None,
    *,
    force: bool,
    plain_key: bool = False,
) -> None:
    """Write the bundle. UsageError if it has unencrypted keys and `plain_key` is not set."""
    if bundle.has_keys and not (sealed_for or plain_key):
        raise UsageError(
            f"the bundle has private keys of {', '.join(bundle.names)}",
            hint="encrypt it for its robot: --seal-for FILE; or use --plain-key and protect it",
        )
    data = bundle.to_bytes()
    data = seal(data, sealed_for) if sealed_for else data
    save(goal, data, private=bundle.has_keys, force=force)
