"""Installing a bundle on its robot, and going back: all of it or nothing."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from pqsec_pki._files import read
from pqsec_pki.algorithms import SealingPrivateKey
from pqsec_pki.enrolment.archive import MAX_ARCHIVE
from pqsec_pki.enrolment.bundle import CAS, Bundle
from pqsec_pki.enrolment.place import CURRENT, InstalledSet, Place, changing
from pqsec_pki.enrolment.request import SEALING_KEY
from pqsec_pki.enrolment.sealed import is_sealed, open_sealed
from pqsec_pki.enrolment.verification import Credentials, keys_of, older_parts, pin, verify_bundle
from pqsec_pki.errors import (
    KeystoreError,
    PqsecError,
    UsageError,
    VerificationError,
    located,
)
from pqsec_pki.keystore.enclave import KEYS, LIST, NEEDED

MAX_FILE = MAX_ARCHIVE + (64 << 10)
"""Bytes: sealing adds to the archive."""


@dataclass(frozen=True, slots=True)
class Installed:
    """What was installed, or is again what it was."""

    names: tuple[str, ...]
    not_after: datetime
    """When the first of its certificates ends."""
    current: Path
    """The link that leads to it."""
    already: bool
    """Whether the very same is installed, and nothing was done."""


def install(  # noqa: PLR0913 -- the choices are the user's, and by name
    path: Path,
    root: Path,
    fingerprints: Collection[str],
    *,
    now: datetime,
    trust_first: bool = False,
    older: bool = False,
    alone: bool = False,
) -> Installed:
    """Let the robot's folder `root` hold what is in the bundle in file `path`.

    Its CAs must be those of `fingerprints`; without any, those of what is installed. On a
    first installation `trust_first` takes whatever CAs the bundle has. `older` also takes
    what is older than what is installed. Other participants that are installed stay, with
    the bundle's revocation list, unless it shall be there `alone`.

    VerificationError lists everything that is wrong with the bundle; then, as with any
    error, nothing has changed.
    """
    data = read(path, limit=MAX_FILE)
    with changing(root) as place, located(path):
        bundle = Bundle.from_bytes(_opened(data, root))
        before = place.current
        pins = _pins(before, fingerprints, bundle, trust_first=trust_first)
        credentials = _verified(bundle, pins, now)
        if before and not older:
            _refuse_older(credentials, before)
        keys = {each.name: _keys(each, bundle, place) for each in credentials}
        others = {} if alone else _others(before, bundle)
        wanted = {name: {**files, **keys[name]} for name, files in bundle.enclaves.items()}
        wanted = dict(sorted({**others, **wanted}.items()))
        already = before is not None and before.enclaves == wanted
        if not already:
            place.put(wanted, now)
        place.tidy(keys)  # also what a killed installation left
        return _told(credentials, place, already=already)


def rollback(root: Path) -> InstalledSet:
    """Let the set before the current one be current again.

    KeystoreError if there is none.
    """
    with changing(root) as place:
        current = place.current
        if current is None:
            raise KeystoreError(f"nothing is installed in {root}")
        if current.previous is None or not (current.path.parent / current.previous).is_dir():
            raise KeystoreError(f"{root} keeps nothing from before {current.at:%Y-%m-%d %H:%M} UTC")
        earlier = place.set_named(current.previous)
        place.point_to(current.previous)
        return earlier


def _opened(data: bytes, root: Path) -> bytes:
    if not is_sealed(data):
        return data
    key = root / SEALING_KEY
    if not key.exists():
        raise KeystoreError(
            "the bundle is sealed, and there is no key here to open it",
            hint=f"`pqsec bundle-key --dir {root}` makes one; the bundle must be sealed for it",
        )
    with located(key):
        opener = SealingPrivateKey.from_pem(read(key))
    return open_sealed(data, opener)


def _pins(
    before: InstalledSet | None,
    fingerprints: Collection[str],
    bundle: Bundle,
    *,
    trust_first: bool,
) -> tuple[str, ...]:
    """Which CAs are believed in."""
    if fingerprints:
        return tuple(map(pin, fingerprints))
    if before:
        installed = Bundle(before.at, before.enclaves)
        _refuse_other_roles(bundle, installed)
        return installed.fingerprints
    if trust_first:
        return bundle.fingerprints
    raise UsageError(
        "nothing is installed yet, so nothing tells which CAs to trust",
        hint="name each: --ca-fingerprint SHA256; `pqsec ca show`, where they are, prints them",
    )


def _verified(bundle: Bundle, pins: Collection[str], now: datetime) -> tuple[Credentials, ...]:
    try:
        return verify_bundle(bundle, pins, now=now)
    except VerificationError as error:
        error.hint = error.hint or (
            "`pqsec bundle`, where the CAs are, makes another; for what has ended, `pqsec renew`"
            " comes first"
        )
        raise


def _refuse_other_roles(bundle: Bundle, installed: Bundle) -> None:
    """A CA that is trusted to sign one thing is not trusted with another."""
    problems = [
        f"a CA that is trusted stands as {file}, and stood elsewhere: SHA-256 {each}"
        for file in CAS
        for each in bundle.roles[file]
        if each in installed.fingerprints and each not in installed.roles[file]
    ]
    if problems:
        raise VerificationError(
            *problems, hint="if that is meant, name each CA anew: --ca-fingerprint SHA256"
        )


def _refuse_older(credentials: Collection[Credentials], before: InstalledSet) -> None:
    """Nobody gets old rights back, or revoked peers in again, by sending an old bundle."""
    installed = _installed(before)
    problems = [
        problem for new in credentials for old in installed for problem in older_parts(new, old)
    ]
    if problems:
        raise VerificationError(
            *dict.fromkeys(problems), hint="if that is meant: --older, or `pqsec rollback`"
        )


def _installed(before: InstalledSet) -> list[Credentials]:
    """What is installed, read; an error says how to do without."""
    try:
        with located(before.path):
            for name, files in before.enclaves.items():
                missing = [each for each in NEEDED if each not in files]
                if missing:
                    raise KeystoreError(f"{name} lacks {', '.join(missing)}")
            return [Credentials.of(name, files) for name, files in before.enclaves.items()]
    except PqsecError as error:
        error.hint = "with --older the bundle is not compared with what is installed"
        raise


def _others(before: InstalledSet | None, bundle: Bundle) -> dict[str, dict[str, bytes]]:
    """What else is installed, of the same CAs; VerificationError for what is of others."""
    there = before.enclaves if before else {}
    others = {name: dict(files) for name, files in there.items() if name not in bundle.names}
    if before and others and not _same_authorities(Bundle(before.at, others), bundle):
        raise VerificationError(
            f"also installed: {', '.join(others)}, which are not of the bundle's CAs",
            hint="`pqsec bundle` makes one for all of them; or --only lets them go",
        )
    for revoked in (files[LIST] for files in bundle.enclaves.values() if LIST in files):
        for files in others.values():
            files[LIST] = revoked
    return others


def _same_authorities(one: Bundle, other: Bundle) -> bool:
    """In the same places; not, if that of one cannot be read."""
    try:
        return one.roles == other.roles
    except PqsecError:
        return False


def _keys(credentials: Credentials, bundle: Bundle, place: Place) -> Mapping[str, bytes]:
    """The private keys: from the bundle, or made or installed here before."""
    name = credentials.name
    inside = {key: data for key, data in bundle.enclaves[name].items() if key in KEYS}
    return keys_of(credentials, [inside] if inside else place.keys(name))


def _told(credentials: Collection[Credentials], place: Place, *, already: bool) -> Installed:
    return Installed(
        names=tuple(each.name for each in credentials),
        not_after=min(each.certificate.not_after for each in credentials),
        current=place.root / CURRENT,
        already=already,
    )
