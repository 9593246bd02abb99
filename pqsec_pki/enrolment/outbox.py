"""A folder with the current bundle of each robot, updated from the keystore."""

import os
from collections.abc import Iterable, Iterator
from datetime import datetime
from pathlib import Path

from pqsec_pki._files import read
from pqsec_pki._progress import counted
from pqsec_pki.enrolment.bundle import Bundle, bundle_path, save
from pqsec_pki.enrolment.tarball import MAX_ARCHIVE
from pqsec_pki.errors import ExistsError, PqsecError
from pqsec_pki.keystore import BundleNumbers, Keystore


def refresh(
    keystore: Keystore, names: Iterable[str], folder: Path, *, now: datetime
) -> Iterator[Path]:
    """Write the bundle of each participant into `folder`; returns those that it wrote.

    The bundles have no private keys. An older bundle for the same participant is replaced;
    ExistsError for anything else in its place. Errors as in `Bundle.of` and `save`.
    """
    wanted = list(names)
    with BundleNumbers.of(keystore) as numbers:
        for name in counted(wanted, len(wanted), "bundles"):
            goal = bundle_path(folder, name)
            bundle = Bundle.of(keystore, [name], now=now, keys=False, numbers=numbers)
            there = _bundle_at(goal, name)
            if there is None or there.sha256 != bundle.sha256:
                save(goal, bundle.to_bytes(), force=there is not None)
                yield goal


def _bundle_at(goal: Path, name: str) -> Bundle | None:
    if not os.path.lexists(goal):
        return None
    try:
        found = Bundle.from_bytes(read(goal, limit=MAX_ARCHIVE))
    except PqsecError:
        found = None
    if found is None or found.names != (name,):
        raise ExistsError(f"{goal} exists and is not a bundle for {name}", hint="move it away")
    return found
