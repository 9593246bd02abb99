"""Makes a keystore of another tool a pqsec keystore, without changing its files.

It may be SROS2's, or have SROS2's layout with CAs and certificates made by OpenSSL. pqsec.json
and the ledger are added and, if the enclaves have a revocation list, a copy of it in public/.
"""

import os
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from shlex import quote

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors, read, refuse_without_links
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
from pqsec_pki.keystore import (
    GITIGNORE,
    Keystore,
    Transaction,
    change,
    keystore_ignored,
    layout,
    load_certificate,
    load_first_certificate,
    resume,
    settings_file,
)
from pqsec_pki.lifecycle._scan import KeystoreScan

_FOLDERS = (layout.PUBLIC, layout.PRIVATE, layout.ENCLAVES)
_NEEDED = (
    f"{layout.PUBLIC}/{layout.IDENTITY_CA}",
    f"{layout.PUBLIC}/{layout.PERMISSIONS_CA}",
    f"{layout.ENCLAVES}/{layout.GOVERNANCE}",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Adopted:
    """The adopted keystore, and what was entered in the ledger."""

    keystore: Keystore
    participants: list[str]
    refused: dict[str, str]
    """Files, relative to the keystore, that are not in the ledger, and why."""
    one_ca: bool
    """Whether the identity CA and the permissions CA have the same key (CVE-2023-24010)."""
    fitting: bool
    """Whether the files follow the profile; if not, the profile applies to new files only."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Adoptable:
    """A keystore of another tool, before it is adopted."""

    keystore: Keystore
    """Reads the files; the folder has no pqsec.json and no ledger."""
    participants: frozenset[str]
    """Participants with a certificate of the identity CA."""
    revoked: frozenset[str]
    refused: dict[str, str]
    """See `Adopted`."""
    fitting: bool
    """See `Adopted`."""


def adoptable(root: Path, *, now: datetime) -> Adoptable:
    """What `adopt` would find in the folder `root`; writes nothing. Errors as of `adopt`."""
    _refuse_unfit(root)
    keystore, scan, fitting = _scanned(root, now)
    return Adoptable(
        keystore=keystore,
        participants=frozenset(scan.participants.values()),
        revoked=frozenset(each.name for each in scan.entries if each.kind == "revocation"),
        refused=scan.refused,
        fitting=fitting,
    )


def adopt(root: Path, *, gitignore: bool = False, now: datetime) -> Adopted:
    """Make the folder `root` a pqsec keystore; with `gitignore` as `Keystore.create`.

    If an earlier call was killed or met a full disk after its commit, this finishes it.
    ExistsError if it is one, KeystoreError if it lacks the CAs' certificates or the
    governance. A participant's faulty files are reported in `refused`, and not entered in the
    ledger.
    """
    if resume(root):
        return _resumed(root, now)
    _refuse_unfit(root)
    refuse_without_links(root, "a keystore", hard=True)
    with change(root) as transaction:
        _refuse_unfit(root)
        keystore, scan, fitting = _scanned(root, now)
        _stage(transaction, keystore, scan, gitignore=gitignore)
    return _adopted(keystore, scan, fitting=fitting)


def _resumed(root: Path, now: datetime) -> Adopted:
    """What a killed `adopt` adopted, after its change was finished."""
    _, scan, fitting = _scanned(root, now)
    return _adopted(Keystore.open(root, to_change=True), scan, fitting=fitting)


def _adopted(keystore: Keystore, scan: KeystoreScan, *, fitting: bool) -> Adopted:
    return Adopted(
        keystore=keystore,
        participants=list(scan.participants.values()),
        refused=scan.refused,
        one_ca=scan.identity_ca.spki == scan.permissions_ca.spki,
        fitting=fitting,
    )


def _scanned(root: Path, now: datetime) -> tuple[Keystore, KeystoreScan, bool]:
    """The keystore, its content, and whether the content follows the keystore's profile."""
    profile = _profile(root)
    keystore = Keystore(root, (profile or profile_named("classical"),), DomainSet.of(0))
    scan = KeystoreScan.of(keystore, now)
    scan.run()
    return replace(keystore, domains=scan.domains), scan, profile is not None


def _stage(
    transaction: Transaction, keystore: Keystore, scan: KeystoreScan, *, gitignore: bool
) -> None:
    root = keystore.root
    settings = transaction.folder(".", private=False)
    settings.public(layout.SETTINGS, settings_file(keystore.profiles, keystore.domains))
    if gitignore:
        settings.public(GITIGNORE, keystore_ignored(root))
    if not (root / layout.PRIVATE).exists():
        transaction.folder(layout.PRIVATE, private=True)
    public = transaction.folder(layout.PUBLIC, private=False)
    if scan.list_file and not keystore.has_revocation_list:
        public.public(layout.CA_LIST, read(scan.list_file))
    for staged, there in ((settings, root), (public, root / layout.PUBLIC)):
        staged.set_mode(there.stat().st_mode & 0o777)  # keep the folder's mode
    for head in (layout.TREE_HEAD, layout.TREE):  # of a ledger that was lost
        transaction.remove(f"{layout.PUBLIC}/{head}")
    transaction.record(*scan.entries)


def _refuse_unfit(root: Path) -> None:
    with disk_errors(root):
        if os.path.lexists(root / layout.SETTINGS):
            raise ExistsError(
                f"{root} is a pqsec keystore already",
                hint=f"`pqsec -k {quote(str(root))} status` shows what is in it",
            )
        missing = [name for name in _NEEDED if not (root / name).is_file()]
        links = [root / name for name in _FOLDERS if (root / name).is_symlink()]
        has_sets = os.path.lexists(root / layout.SETS)
    if has_sets:
        raise KeystoreError(
            f"{root / layout.SETS} has further sets of credentials, which would be left behind",
            hint=f"restore {layout.SETTINGS} from a backup, or move that folder away",
        )
    if missing:
        raise KeystoreError(
            f"{root} lacks {', '.join(missing)}",
            hint="put the files where SROS2 has them; docs/reference/keystore.md shows its layout",
        )
    if links:
        raise KeystoreError(
            f"{links[0]} should be a folder, and is a link: pqsec could not change it later",
            hint="replace the link with the folder itself",
        )


def _profile(root: Path) -> Profile | None:
    """A profile that the CAs and the first participant comply with; None if there is none.

    MalformedError, with a hint, for a CA that is not a certificate in PEM.
    """
    public = root / layout.PUBLIC
    try:
        identity = load_first_certificate(public / layout.IDENTITY_CA)
        permissions = load_first_certificate(public / layout.PERMISSIONS_CA)
    except MalformedError as error:
        error.hint = error.hint or "`openssl x509 -inform DER` converts DER to PEM"
        raise
    participant = _first_participant(root) or identity
    second = identity.alternative_key
    kinds: dict[str, str | None] = {
        "identity_key": _kind(identity, public / layout.IDENTITY_CA),
        "permissions_key": _kind(permissions, public / layout.PERMISSIONS_CA),
        "participant_key": participant.public_key.algorithm.name,
        "alternative_key": second.algorithm.name if second else None,
    }
    for profile in _nearest_first(identity):
        if (second is None) == (profile.alternative_key is None):
            with suppress(UsageError):
                return profile.changed(kinds)
    return None


def _nearest_first(ca: Certificate) -> list[Profile]:
    """Profiles with keys of the CA's family first: others may demand less. Composite keys also
    satisfy pq, but pq does not demand what hybrid does. Then classical first."""
    family = ca.public_key.algorithm.family
    near = [each for each in reversed(PROFILES) if each.identity_key.family == family]
    return near + [each for each in reversed(PROFILES) if each not in near]


def _first_participant(root: Path) -> Certificate | None:
    """The first participant certificate that can be read; faulty ones are reported later."""
    for name in layout.names_in(root):
        with suppress(PqsecError):
            found = load_certificate(root / layout.enclave_folder(name) / layout.CERTIFICATE)
            if found.public_key.algorithm.name:  # raises for an unknown algorithm
                return found
    return None


def _kind(ca: Certificate, path: Path) -> str:
    """The algorithm of the CA's key; UnknownAlgorithmError names the file."""
    with located(path):
        return ca.public_key.algorithm.name
