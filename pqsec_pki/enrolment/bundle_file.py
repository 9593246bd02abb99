"""Bundles in files: sealed for their robot, or without private keys, or plain on request."""

from collections.abc import Sequence
from pathlib import Path

from pqsec_pki import _files
from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import SealingPublicKey
from pqsec_pki.enrolment.bundle import Bundle, save
from pqsec_pki.enrolment.sealed import seal
from pqsec_pki.errors import UsageError


@dataclass(frozen=True, slots=True)
class BundleFile:
    """A bundle, and the file for it."""

    bundle: Bundle
    path: Path
    recipient: SealingPublicKey | None = None
    """The key of the robot that alone can open the file."""
    plain_key: bool = False
    """Whether the file may have private keys without encryption."""

    @property
    def has_plain_keys(self) -> bool:
        """Whether every reader of the file can read private keys."""
        return self.bundle.has_keys and self.recipient is None

    def refuse_plain_keys(self) -> None:
        """UsageError if every reader could read private keys, and it may not have them."""
        if self.has_plain_keys and not self.plain_key:
            raise UsageError(
                f"the bundle has private keys of {', '.join(self.bundle.names)}",
                hint="encrypt it for its robot: `pqsec bundle NAME... --seal-for FILE`, where FILE"
                " is what `pqsec bundle-key` wrote there; or use --plain-key and protect it",
            )

    def write(self, *, force: bool = False) -> None:
        """Write the file; UsageError as of refuse_plain_keys, other errors as in `save`."""
        self.refuse_plain_keys()
        data = self.bundle.to_bytes()
        data = seal(data, self.recipient) if self.recipient else data
        save(self.path, data, private=self.bundle.has_keys, force=force)

    def to_json(self) -> dict[str, object]:
        """What is in the file, and the CAs by which a robot knows it."""
        return {
            "bundle": self.path,
            "names": self.bundle.names,
            "profiles": self.bundle.profiles,
            "number": self.bundle.number,
            "keys": self.bundle.has_keys,
            "sealed": self.recipient is not None,
            "ca_sha256": self.bundle.fingerprints,
        }


def write_bundles(files: Sequence[BundleFile], *, force: bool = False) -> None:
    """Write all, or none if one would be refused or, unless `force`, a file exists.

    TooLargeError for a bundle that no robot could read.
    """
    for each in files:
        each.refuse_plain_keys()
        each.bundle.refuse_large()
        if not force:
            _files.refuse_existing(each.path)
    for each in files:
        each.write(force=force)
