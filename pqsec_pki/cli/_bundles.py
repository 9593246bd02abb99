"""What the commands that make bundles share: requests in, bundles out, sealed or not."""

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
from pqsec_pki.keystore import ParticipantSpec, PublicKeys

folder_option = click.option(
    "--bundles",
    "folder",
    type=_settings.FOLDER,
    metavar="DIR",
    help="Where bundles are written. [default: here]",
)
seal_option = click.option(
    "--seal-for",
    type=_settings.FILE,
    metavar="FILE",
    help="Let only this robot open the bundle: its bundle.pub.pem, of `pqsec bundle-key`.",
)

compromised_option = click.option(
    "--reuse-compromised-key",
    "compromised_keys",
    is_flag=True,
    help="Also certify a key that was revoked as compromised: whoever else has it can pass for"
    " that participant.",
)


def load_requests(paths: Sequence[Path]) -> list[CertificateRequest]:
    """The requests in these files, in PEM; errors name the file."""
    found = []
    for path in paths:
        with located(path):
            found.append(CertificateRequest.from_pem(_files.read(path)))
    return found


def read_requests(
    paths: Sequence[Path], profile: Profile, names: Collection[str], patterns: Collection[str]
) -> dict[str, PublicKeys]:
    """The keys to be certified, by name, if all requests may be answered; none without files."""
    if not paths:
        return {}
    return validate_csrs(load_requests(paths), profile, names=names, patterns=patterns)


def with_keys(spec: ParticipantSpec, asked: Mapping[str, PublicKeys]) -> ParticipantSpec:
    """The wish, for the keys of its request if there is one."""
    return replace(spec, keys=asked.get(spec.name))


def goals(names: Collection[str], folder: Path | None, *, force: bool) -> dict[str, Path]:
    """Where each name's bundle goes; ExistsError if something is there, unless `force`."""
    found = {name: (folder or Path()) / f"{flat_name(name)}.bundle" for name in names}
    if not force:
        for goal in found.values():
            _files.refuse_existing(goal)
    return found


def recipient(path: Path | None) -> SealingPublicKey | None:
    """Whom to seal for, if a file was named."""
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
    """Write the bundle; UsageError if it holds keys in the clear, and nobody said so."""
    if bundle.has_keys and not (sealed_for or plain_key):
        raise UsageError(
            f"the bundle holds private keys of {', '.join(bundle.names)}",
            hint="seal it for its robot: --seal-for FILE; or say --plain-key, and guard it",
        )
    data = bundle.to_bytes()
    data = seal(data, sealed_for) if sealed_for else data
    save(goal, data, private=bundle.has_keys, force=force)
