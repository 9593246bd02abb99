"""Issuing to robots: their requests are certified, and each robot gets a bundle."""

from collections.abc import Iterable, Sequence
from datetime import datetime
from pathlib import Path

from pqsec_pki import _files
from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import SealingPublicKey
from pqsec_pki.enrolment.bundle import Bundle, bundle_path
from pqsec_pki.enrolment.bundle_file import BundleFile
from pqsec_pki.errors import FileError, TooLargeError, UsageError
from pqsec_pki.keystore import Authorities, BundleNumbers, Keystore
from pqsec_pki.lifecycle import Issued, ParticipantSpec, issue


@dataclass(frozen=True, slots=True)
class IssuedBundle:
    """What was issued to one participant, and the bundle for its robot."""

    issued: Issued
    path: Path

    @property
    def row(self) -> tuple[str, str, str]:
        """Name, end and place."""
        name, end, _ = self.issued.row
        return name, end, str(self.path)

    def to_json(self) -> dict[str, object]:
        """The participant for --json."""
        return {**self.issued.to_json(), "bundle": self.path}


def issue_with_bundles(  # noqa: PLR0913 -- the choices are the user's, and by name
    keystore: Keystore,
    authorities: Authorities,
    specs: Sequence[ParticipantSpec],
    folder: Path,
    *,
    now: datetime,
    recipient: SealingPublicKey | None = None,
    force: bool = False,
    after_revocation: bool = False,
    compromised_keys: bool = False,
) -> list[IssuedBundle]:
    """Issue all participants in `specs`, and write a bundle for each into `folder`.

    The specs have the keys of requests (`validate_csrs`); without them `recipient` is needed,
    whose robot alone can open the bundles. Nothing is issued if a bundle's file exists, unless
    `force`: ExistsError. Other errors as in `issue`, `Bundle.of` and `save`; after an error of a
    bundle the participants are issued, and the hint says how to write the bundle.
    """
    if recipient is None and any(spec.keys is None for spec in specs):
        raise UsageError("a bundle with private keys needs the key of its robot")
    paths = bundle_paths([spec.name for spec in specs], folder, force=force)
    issued = issue(
        keystore,
        authorities,
        specs,
        now=now,
        force=force,
        after_revocation=after_revocation,
        compromised_keys=compromised_keys,
    )
    with BundleNumbers.of(keystore) as numbers:
        for each, path in zip(issued, paths, strict=True):
            bundle = Bundle.of(keystore, [each.name], now=now, numbers=numbers)
            try:
                BundleFile(bundle, path, recipient).write(force=force)
            except (FileError, TooLargeError) as error:
                name = each.name
                error.hint = f"{name} is issued: write its bundle with `pqsec bundle {name}`"
                raise
    return [IssuedBundle(each, path) for each, path in zip(issued, paths, strict=True)]


def bundle_paths(names: Iterable[str], folder: Path, *, force: bool = False) -> list[Path]:
    """The path of each name's bundle. ExistsError if a file exists, unless `force`."""
    paths = [bundle_path(folder, name) for name in names]
    if not force:
        for path in paths:
            _files.refuse_existing(path)
    return paths
