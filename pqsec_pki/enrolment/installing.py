"""Install a bundle on its robot, completely or not at all."""

from collections.abc import Collection
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from shlex import quote

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import read
from pqsec_pki.algorithms import SealingPrivateKey
from pqsec_pki.enrolment._installed_trust import raised, refuse_fewer_sets, trust_state
from pqsec_pki.enrolment._next_installation import NextInstallation
from pqsec_pki.enrolment.added_sets import with_added_sets
from pqsec_pki.enrolment.bundle import Bundle
from pqsec_pki.enrolment.credential_store import (
    CURRENT,
    CredentialStore,
    InstalledCredentials,
    changing,
)
from pqsec_pki.enrolment.pins import Pins
from pqsec_pki.enrolment.requesting import SEALING_KEY
from pqsec_pki.enrolment.robot_clock import future_problems, verification_time
from pqsec_pki.enrolment.sealed import is_sealed, open_sealed
from pqsec_pki.enrolment.tarball import MAX_ARCHIVE
from pqsec_pki.enrolment.trust import Marks, TrustState
from pqsec_pki.enrolment.verification import VerifiedBundle, verify_bundle
from pqsec_pki.errors import (
    KeystoreError,
    UsageError,
    VerificationError,
    located,
)
from pqsec_pki.problems import Problem
from pqsec_pki.tokens import Pin, stored_pin

MAX_FILE = MAX_ARCHIVE + (64 << 10)
"""Bytes: more than an archive, because sealing adds to it."""


@dataclass(frozen=True, slots=True)
class Installed:
    """The result of an installation."""

    names: tuple[str, ...]
    not_after: datetime
    """The time at which the first of its certificates expires."""
    current: Path
    """The link to the current installation."""
    already: bool
    """Whether the same files were installed already, so only the receipt was written again."""
    bundle: int | None
    """The bundle's number, if it has one."""
    receipt: Path
    """The receipt, which shows the machine with the CAs what is installed."""
    profiles: tuple[str, ...] = ()
    """The profile of each set of credentials, the first one first."""
    future: tuple[Problem, ...] = ()
    """What is of the future by the clock of this robot, which is wrong, or the CA's was."""

    def to_json(self) -> dict[str, object]:
        """The result for --json."""
        return {
            "installed": self.names,
            "current": self.current,
            "not_after": self.not_after,
            "already": self.already,
            "bundle": self.bundle,
            "profiles": self.profiles,
            "receipt": self.receipt,
            "future": list(map(str, self.future)),
        }


def install(  # noqa: PLR0913 -- the choices are the user's, and by name
    source: Path | bytes,
    root: Path,
    pins: Pins | None = None,
    *,
    now: datetime,
    trust_first: bool = False,
    older: bool = False,
    proofs: bool = False,
    alone: bool = False,
    agreed: Collection[str] | None = None,
    pin: Pin = stored_pin,
) -> Installed:
    """Install a bundle, from a file or as its content, into the robot's folder `root`.

    Its CAs must be those of `pins`, each in its role; without `pins`, those trusted here, and those
    of sets of credentials for which they vouch. All sets that are installed must be in it. On a
    first installation `trust_first` trusts the CAs in the bundle. `older` accepts documents older
    than those installed before. Other installed participants stay, with the bundle's revocation
    list, unless `alone`. With `proofs` this bundle, and all later ones, must prove that the ledger
    has their documents. `agreed` are the participants that `alone` may remove, as of
    `removed_alone`; None for any. `pin` is asked for the PIN of a token.

    The files are verified, and written again from the verified values. VerificationError lists
    everything that is wrong with the bundle; KeystoreError if `alone` would remove more than was
    `agreed`. After an error nothing has changed.
    """
    data = read(source, limit=MAX_FILE) if isinstance(source, Path) else source
    where = source if isinstance(source, Path) else "the bundle"
    with changing(root) as store, located(where):
        store.refuse_without_links()
        bundle = Bundle.from_bytes(_opened(data, root))
        before = store.current
        if alone and agreed is not None:
            _refuse_unasked(before, bundle, agreed)
        state = trust_state(store, before, needed=not (pins and older))
        if state:
            refuse_fewer_sets(bundle.further, state)
        trusted = _pins(state, pins, bundle, trust_first=trust_first)
        proofs = proofs or bool(state and state.proofs)
        found = _verified(bundle, trusted, before, now, proofs=proofs)
        newer = replace(raised(state, found.credentials, trusted, found.heads), proofs=proofs)
        if not older:
            _refuse_older(found, newer, state, _instead(state, trusted, root))
        made = NextInstallation.of(bundle, found, store, before=before, alone=alone, pin=pin)
        already = made.put(store, newer, now)
        store.tidy(bundle.names)  # also removes what a killed installation left
        return _result(found, store, bundle, already=already, now=now)


def require_trust(root: Path, pins: Pins | None = None) -> None:
    """UsageError if neither `pins` nor what is installed in `root` says which CAs to trust."""
    with changing(root) as store:
        if not (pins or trust_state(store, store.current, needed=True)):
            raise _no_cas()


def removed_alone(path: Path, root: Path) -> tuple[str, ...]:
    """The participants, sorted, that `install` of the bundle in file `path` `alone` would remove.

    Errors as of `install` for a file that is not a bundle; its content is not verified.
    """
    data = read(path, limit=MAX_FILE)
    with changing(root) as store, located(path):
        names = Bundle.from_bytes(_opened(data, root)).names
        return _besides(store.current, names)


def _besides(before: InstalledCredentials | None, names: Collection[str]) -> tuple[str, ...]:
    """The installed participants, sorted, apart from `names`."""
    return tuple(sorted((before.enclaves if before else {}).keys() - set(names)))


def _refuse_unasked(
    before: InstalledCredentials | None, bundle: Bundle, agreed: Collection[str]
) -> None:
    """KeystoreError if others would be removed: they were installed since the question."""
    others = [each for each in _besides(before, bundle.names) if each not in agreed]
    if others:
        raise KeystoreError(
            f"installed in the meantime: {', '.join(others)}, which would be removed too",
            hint="run the command again",
        )


def _opened(data: bytes, root: Path) -> bytes:
    if not is_sealed(data):
        return data
    key = root / SEALING_KEY
    if not key.exists():
        raise KeystoreError(
            "the bundle is sealed, and this robot has no key to open it",
            hint=f"`pqsec bundle-key --dir {quote(str(root))}` creates one; the bundle must be"
            " sealed for it",
        )
    with located(key):
        opener = SealingPrivateKey.from_pem(read(key))
    return open_sealed(data, opener)


def _pins(
    state: TrustState | None, pins: Pins | None, bundle: Bundle, *, trust_first: bool
) -> Pins:
    """The CAs that are trusted, with their roles; errors as of `with_added_sets`."""
    if pins:
        return pins
    if state:
        return with_added_sets(bundle, state.pins)
    if trust_first:
        return bundle.roles
    raise _no_cas()


def _no_cas() -> UsageError:
    return UsageError(
        "nothing is installed yet, so no CAs are trusted",
        hint="name each: --ca-fingerprint ROLE:SHA256; `pqsec ca show --pins` on the CA machine"
        " prints them",
    )


def _verified(
    bundle: Bundle, pins: Pins, before: InstalledCredentials | None, now: datetime, *, proofs: bool
) -> VerifiedBundle:
    at = verification_time(bundle.credentials, before, now)
    try:
        return verify_bundle(bundle, pins, now=at, proof_demanded=proofs)
    except VerificationError as error:
        error.hint = error.hint or (
            "`pqsec bundle` on the CA machine creates a new bundle; if anything expired, run"
            " `pqsec renew` first"
        )
        raise


def _instead(before: TrustState | None, pins: Pins, root: Path) -> str:
    """What to do with older credentials: those of other CAs may be another domain's."""
    trusted = frozenset[str]().union(*(before.pins if before else pins).values())
    if trusted.isdisjoint(frozenset[str]().union(*pins.values())):
        return f"{root} has credentials of other CAs: name another --dir for another domain"
    return "--older installs it anyway"


def _refuse_older(
    found: VerifiedBundle, newer: TrustState, state: TrustState | None, hint: str
) -> None:
    """VerificationError for a bundle older than `newer`: protection against rollback.

    An old bundle could restore withdrawn rights or accept revoked peers, as could an older file
    in one enclave of a new bundle, and a copy of the ledger. `newer` is the state after its
    installation, `state` the one before.
    """
    problems = [problem for each in found.credentials for problem in newer.marks.problems(each)]
    seen = state.marks if state else Marks()
    for each in found.credentials:
        if each.name in found.heads:
            problems += seen.head_problems(each, found.heads[each.name])
    if problems:
        raise VerificationError(*dict.fromkeys(problems), hint=hint)


def _result(
    found: VerifiedBundle,
    store: CredentialStore,
    bundle: Bundle,
    *,
    already: bool,
    now: datetime,
) -> Installed:
    future = (problem for each in found.credentials for problem in future_problems(each, now))
    return Installed(
        names=bundle.names,
        not_after=min(each.certificate.not_after for each in found.verified),
        current=store.root / CURRENT,
        already=already,
        bundle=bundle.number,
        receipt=store.receipt,
        profiles=bundle.profiles,
        future=tuple(dict.fromkeys(future)),
    )
