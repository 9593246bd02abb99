"""A keystore that others made becomes one of pqsec's: nothing in its files is changed.

SROS2's, and one in its layout whose CAs and certificates OpenSSL made. What is added is
pqsec.json, the ledger and, where the enclaves have a revocation list of their own, a copy
of it in public/.
"""

import os
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from pqsec_pki._files import disk_errors, read
from pqsec_pki.algorithms import PROFILES, Profile, profile_named
from pqsec_pki.certificates import Certificate
from pqsec_pki.documents import DomainSet
from pqsec_pki.errors import (
    ExistsError,
    KeystoreError,
    MalformedError,
    PqsecError,
    UsageError,
    located,
)
from pqsec_pki.keystore import _journal, _layout
from pqsec_pki.keystore._scan import KeystoreScan
from pqsec_pki.keystore._settings import settings_file
from pqsec_pki.keystore._transaction import Transaction
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.participant import load_certificate, load_first_certificate

_FOLDERS = (_layout.PUBLIC, _layout.PRIVATE, _layout.ENCLAVES)
_NEEDED = (
    f"{_layout.PUBLIC}/{_layout.IDENTITY_CA}",
    f"{_layout.PUBLIC}/{_layout.PERMISSIONS_CA}",
    f"{_layout.ENCLAVES}/{_layout.GOVERNANCE}",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Adopted:
    """What was found, and entered in the ledger."""

    keystore: Keystore
    participants: list[str]
    refused: dict[str, str]
    """Files, relative to the keystore, that are in no line of the ledger, and why."""
    one_ca: bool
    """Whether one key is identity CA and permissions CA (CVE-2023-24010)."""
    fitting: bool
    """Whether the profile is what the files were made with; else it holds for new ones."""


def adopt(root: Path, *, now: datetime) -> Adopted:
    """Make the folder `root` a keystore of pqsec's.

    ExistsError if it is one, KeystoreError if it lacks the CAs' certificates or the
    governance; what is wrong with a participant's files is told, and keeps them out of
    the ledger.
    """
    _refuse_unfit(root)
    with _journal.change(root) as transaction:
        _refuse_unfit(root)
        profile = _profile(root)
        keystore = Keystore(root, profile or profile_named("classical"), DomainSet.of(0))
        scan = KeystoreScan.of(keystore, now)
        scan.look()
        keystore = replace(keystore, domains=scan.domains)
        _stage(transaction, keystore, scan)
    return Adopted(
        keystore=keystore,
        participants=list(scan.participants.values()),
        refused=scan.refused,
        one_ca=scan.identity_ca.spki == scan.permissions_ca.spki,
        fitting=profile is not None,
    )


def _stage(transaction: Transaction, keystore: Keystore, scan: KeystoreScan) -> None:
    root = keystore.root
    settings = transaction.folder(".", private=False)
    settings.public(_layout.SETTINGS, settings_file(keystore.profile, keystore.domains))
    if not (root / _layout.PRIVATE).exists():
        transaction.folder(_layout.PRIVATE, private=True)
    public = transaction.folder(_layout.PUBLIC, private=False)
    if scan.list_file and not keystore.has_revocation_list:
        public.public(_layout.CA_LIST, read(scan.list_file))
    for staged, there in ((settings, root), (public, root / _layout.PUBLIC)):
        staged.set_mode(there.stat().st_mode & 0o777)  # so that it stays as it is
    transaction.record(*scan.entries)


def _refuse_unfit(root: Path) -> None:
    with disk_errors(root):
        if os.path.lexists(root / _layout.SETTINGS):
            raise ExistsError(f"{root} is a keystore of pqsec's already")
        missing = [name for name in _NEEDED if not (root / name).is_file()]
        links = [root / name for name in _FOLDERS if (root / name).is_symlink()]
    if missing:
        raise KeystoreError(
            f"{root} lacks {', '.join(missing)}",
            hint="put the files where SROS2 has them; docs/keystore.md shows its layout",
        )
    if links:
        raise KeystoreError(
            f"{links[0]} should be a folder, and is a link: nothing could be changed there later",
            hint="put the folder itself there",
        )


def _profile(root: Path) -> Profile | None:
    """One whose promises the CAs and the first participant keep; None if there is none.

    MalformedError, with the way out, for a CA that is no certificate in PEM.
    """
    public = root / _layout.PUBLIC
    try:
        identity = load_first_certificate(public / _layout.IDENTITY_CA)
        permissions = load_first_certificate(public / _layout.PERMISSIONS_CA)
    except MalformedError as error:
        error.hint = error.hint or "`openssl x509 -inform DER` makes PEM of DER"
        raise
    participant = _first_participant(root) or identity
    second = identity.alternative_key
    kinds: dict[str, str | None] = {
        "identity_key": _kind(identity, public / _layout.IDENTITY_CA),
        "permissions_key": _kind(permissions, public / _layout.PERMISSIONS_CA),
        "participant_key": participant.public_key.algorithm.name,
        "alternative_key": second.algorithm.name if second else None,
    }
    for profile in _nearest_first(identity):
        if (second is None) == (profile.alternative_key is None):
            with suppress(UsageError):
                return profile.changed(kinds)
    return None


def _nearest_first(ca: Certificate) -> list[Profile]:
    """Profiles with keys of the CA's family before others, which may promise less: composite
    keys keep what pq promises, and pq does not promise what hybrid does. Then classical first."""
    family = ca.public_key.algorithm.family
    near = [each for each in reversed(PROFILES) if each.identity_key.family == family]
    return near + [each for each in reversed(PROFILES) if each not in near]


def _first_participant(root: Path) -> Certificate | None:
    """The certificate of the first that can be read; the others are told of later."""
    for name in _layout.names_in(root):
        with suppress(PqsecError):
            found = load_certificate(root / _layout.enclave_folder(name) / _layout.CERTIFICATE)
            if found.public_key.algorithm.name:  # it is of a kind that is known
                return found
    return None


def _kind(ca: Certificate, path: Path) -> str:
    """The algorithm of its key; UnknownAlgorithmError, naming the file, for a strange one."""
    with located(path):
        return ca.public_key.algorithm.name
