"""Install a bundle on its robot, or roll back, completely or not at all."""

from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import read
from pqsec_pki.algorithms import SealingPrivateKey
from pqsec_pki.credentials import (
    KEYS,
    PROOF,
    REVOCATION_LIST,
    Credentials,
    VerifiedCredentials,
    missing_proof,
)
from pqsec_pki.enrolment.bundle import Bundle
from pqsec_pki.enrolment.credential_store import (
    CURRENT,
    CredentialStore,
    Enclaves,
    InstalledSet,
    changing,
)
from pqsec_pki.enrolment.receipt import receipt_of
from pqsec_pki.enrolment.requesting import SEALING_KEY
from pqsec_pki.enrolment.sealed import is_sealed, open_sealed
from pqsec_pki.enrolment.tarball import MAX_ARCHIVE
from pqsec_pki.enrolment.trust import Marks, Pins, TrustState, pin_problems, pins_in
from pqsec_pki.enrolment.verification import VerifiedBundle, keys_of, verify_bundle
from pqsec_pki.errors import (
    KeystoreError,
    PqsecError,
    UsageError,
    VerificationError,
    located,
)
from pqsec_pki.tokens import Pin, stored_pin

MAX_FILE = MAX_ARCHIVE + (64 << 10)
"""Bytes: more than an archive, because sealing adds to it."""


@dataclass(frozen=True, slots=True)
class Installed:
    """The result of an installation."""

    names: tuple[str, ...]
    not_after: datetime
    """When the first of its certificates expires."""
    current: Path
    """The link to the current set."""
    already: bool
    """Whether the same files were installed already, so only the receipt was written again."""
    bundle: int | None
    """The bundle's number, if it has one."""
    receipt: Path
    """The receipt, which tells the machine with the CAs what is installed."""

    def to_json(self) -> dict[str, object]:
        """The result for --json."""
        return {
            "installed": self.names,
            "current": self.current,
            "not_after": self.not_after,
            "already": self.already,
            "bundle": self.bundle,
            "receipt": self.receipt,
        }


def install(  # noqa: PLR0913 -- the choices are the user's, and by name
    path: Path,
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
    """Install the bundle in file `path` into the robot's folder `root`.

    Its CAs must be those of `pins`, each in its role; without `pins`, those trusted here.
    On a first installation `trust_first` trusts the CAs in the bundle. `older` accepts
    documents older than those installed before. Other installed participants stay, with the
    bundle's revocation list, unless `alone`. With `proofs` this bundle, and all later ones, must
    prove that the ledger has their documents. `agreed` are the participants that `alone` may
    remove, as `removed_alone` told them; None for any. `pin` is asked for the PIN of a token.

    The files are verified, and written again from the verified values. VerificationError lists
    everything that is wrong with the bundle; KeystoreError if `alone` would remove more than was
    `agreed`. After an error nothing has changed.
    """
    data = read(path, limit=MAX_FILE)
    with changing(root) as store, located(path):
        bundle = Bundle.from_bytes(_opened(data, root))
        before = store.current
        if alone and agreed is not None:
            _refuse_unasked(before, bundle, agreed)
        state = _trust_state(store, before, needed=not (pins and older))
        trusted = _pins(state, pins, bundle, trust_first=trust_first)
        proofs = proofs or bool(state and state.proofs)
        found = _verified(bundle, trusted, now, proofs=proofs)
        newer = replace(_raised(state, found.credentials, trusted), proofs=proofs)
        if not older:
            _refuse_older(found.credentials, newer)
        keys = {each.name: _keys(each, bundle, store, pin) for each in found.verified}
        others = {} if alone else _others(before, bundle, found)
        wanted = {name: {**files, **keys[name]} for name, files in found.files.items()}
        wanted = dict(sorted({**others, **wanted}.items()))
        numbers = _numbers(before, bundle, wanted)
        already = _NextSet(before, wanted, numbers, pin).put(store, newer, now)
        store.tidy(keys)  # also removes what a killed installation left
        return _result(found, store, bundle, already=already)


@dataclass(frozen=True, slots=True)
class _NextSet:
    """What is to be installed, and what is installed before."""

    before: InstalledSet | None
    enclaves: dict[str, dict[str, bytes]]
    numbers: dict[str, int]
    pin: Pin

    def put(self, store: CredentialStore, trust: TrustState, now: datetime) -> bool:
        """Make it the current set, with its receipt.

        Whether the same files were installed already: then only trust and receipt are written.
        """
        if self.before and _same(self.before.enclaves, self.enclaves):
            store.trust(trust)
            since = self.before.at
            store.save_receipt(self._receipt(since, now))
            return True
        receipt = self._receipt(now, now)
        store.put(self.enclaves, trust, now, numbers=self.numbers, receipt=receipt)
        return False

    def _receipt(self, installed_at: datetime, now: datetime) -> bytes:
        return receipt_of(
            self.enclaves, self.numbers, installed_at=installed_at, now=now, pin=self.pin
        )


def _same(before: Enclaves, wanted: Enclaves) -> bool:
    """Whether the files are the same; another proof of the same documents is as good."""
    if any(
        PROOF in wanted[name] and PROOF not in before[name] for name in wanted if name in before
    ):
        return False
    plain = [
        {name: {**files, PROOF: b""} for name, files in each.items()} for each in (before, wanted)
    ]
    return plain[0] == plain[1]


def removed_alone(path: Path, root: Path) -> tuple[str, ...]:
    """The participants, sorted, that `install` of the bundle in file `path` `alone` would remove.

    Errors as of `install` for a file that is not a bundle; its content is not verified.
    """
    data = read(path, limit=MAX_FILE)
    with changing(root) as store, located(path):
        names = Bundle.from_bytes(_opened(data, root)).names
        return _besides(store.current, names)


def _besides(before: InstalledSet | None, names: Collection[str]) -> tuple[str, ...]:
    """The installed participants, sorted, apart from `names`."""
    return tuple(sorted((before.enclaves if before else {}).keys() - set(names)))


def _refuse_unasked(before: InstalledSet | None, bundle: Bundle, agreed: Collection[str]) -> None:
    """KeystoreError if others would be removed: they were installed since the question."""
    others = [each for each in _besides(before, bundle.names) if each not in agreed]
    if others:
        raise KeystoreError(
            f"installed in the meantime: {', '.join(others)}, which would be removed too",
            hint="run the command again",
        )


def rollback(
    root: Path, *, now: datetime, older: bool = False, pin: Pin = stored_pin
) -> InstalledSet:
    """Make the set before the current one current again.

    KeystoreError if there is none, or it cannot be read. VerificationError if its CAs are not
    those trusted here, or if anything in it is older than the newest that was installed,
    unless `older`. The marks stay, so no older bundle can be installed afterwards either.
    """
    with changing(root) as store:
        current = store.current
        if current is None:
            raise KeystoreError(f"nothing is installed in {root}")
        if current.previous is None or not (current.path.parent / current.previous).is_dir():
            raise KeystoreError(f"{root} has no set from before {current.at:%Y-%m-%d %H:%M} UTC")
        earlier = store.set_named(current.previous)
        state = _trust_state(store, current, needed=not older)
        if state and not older:
            _refuse_rollback(earlier, state)
        else:
            seen = _installed(earlier)
            pins = pins_in(*(each.anchors for each in seen))
            if state is None:
                with suppress(PqsecError):  # an unreadable set raises no marks
                    seen += _installed(current)
            store.trust(_raised(state, seen, pins))
        receipt = receipt_of(
            earlier.enclaves, earlier.numbers, installed_at=earlier.at, now=now, pin=pin
        )
        store.point_to(current.previous, receipt)
        return earlier


def _opened(data: bytes, root: Path) -> bytes:
    if not is_sealed(data):
        return data
    key = root / SEALING_KEY
    if not key.exists():
        raise KeystoreError(
            "the bundle is sealed, and this robot has no key to open it",
            hint=f"`pqsec bundle-key --dir {root}` creates one; the bundle must be sealed for it",
        )
    with located(key):
        opener = SealingPrivateKey.from_pem(read(key))
    return open_sealed(data, opener)


def _trust_state(
    store: CredentialStore, before: InstalledSet | None, *, needed: bool
) -> TrustState | None:
    """The saved trust state, or, if an older pqsec installed the set, one derived from that set.

    None if nothing is installed, or if it cannot be read and is not `needed`.
    """
    try:
        state = store.trust_state
        if state or before is None:
            return state
        installed = _installed(before)
        pins = pins_in(*(each.anchors for each in installed))
        return _raised(None, installed, pins)
    except PqsecError as error:
        if not needed:
            return None
        error.hint = error.hint or (
            "--older, with --ca-fingerprint for each CA, ignores what was installed before"
        )
        raise


def _raised(
    state: TrustState | None, credentials: Collection[Credentials], pins: Pins
) -> TrustState:
    return (state or TrustState(pins=pins, marks=Marks())).after(credentials, pins)


def _pins(
    state: TrustState | None, pins: Pins | None, bundle: Bundle, *, trust_first: bool
) -> Pins:
    """The CAs that are trusted, with their roles."""
    if pins:
        return pins
    if state:
        return state.pins
    if trust_first:
        return bundle.roles
    raise UsageError(
        "nothing is installed yet, so no CAs are trusted",
        hint="name each: --ca-fingerprint ROLE:SHA256; `pqsec ca show --pins` on the CA machine"
        " prints them",
    )


def _verified(bundle: Bundle, pins: Pins, now: datetime, *, proofs: bool) -> VerifiedBundle:
    try:
        return verify_bundle(bundle, pins, now=now, proof_demanded=proofs)
    except VerificationError as error:
        error.hint = error.hint or (
            "`pqsec bundle` on the CA machine creates a new bundle; if anything expired, run"
            " `pqsec renew` first"
        )
        raise


def _refuse_older(credentials: Collection[Credentials], state: TrustState) -> None:
    """VerificationError for credentials older than `state`: protection against rollback.

    An old bundle could restore withdrawn rights or accept revoked peers, as could an older file
    in one enclave of a new bundle. `state` is the one after its installation.
    """
    problems = [problem for each in credentials for problem in state.marks.problems(each)]
    if problems:
        raise VerificationError(*dict.fromkeys(problems), hint="--older installs it anyway")


def _refuse_rollback(earlier: InstalledSet, state: TrustState) -> None:
    credentials = _installed(earlier)
    lacking = [name for name, files in earlier.enclaves.items() if PROOF not in files]
    problems = [missing_proof(name) for name in lacking if state.proofs]
    problems += list(pin_problems(pins_in(*(each.anchors for each in credentials)), state.pins))
    problems += [problem for each in credentials for problem in state.marks.problems(each)]
    if problems:
        raise VerificationError(
            *dict.fromkeys(problems), hint="`pqsec rollback --older` restores it anyway"
        )


def _installed(found: InstalledSet) -> list[Credentials]:
    """The installed credentials, read but not verified."""
    with located(found.path):
        return [
            Credentials.of(name, {file: each for file, each in files.items() if file not in KEYS})
            for name, files in found.enclaves.items()
        ]


def _others(
    before: InstalledSet | None, bundle: Bundle, found: VerifiedBundle
) -> dict[str, dict[str, bytes]]:
    """The other installed participants; VerificationError for those of other CAs."""
    there = before.enclaves if before else {}
    others = {name: dict(files) for name, files in there.items() if name not in bundle.names}
    if before and others and not _same_authorities(Bundle(before.at, others), bundle):
        raise VerificationError(
            f"also installed: {', '.join(others)}, which were not issued by the bundle's CAs",
            hint="create a bundle for all of them with `pqsec bundle`, or remove them with --only",
        )
    for files in found.files.values():
        if REVOCATION_LIST in files:
            for each in others.values():
                each[REVOCATION_LIST] = files[REVOCATION_LIST]
    return others


def _numbers(
    before: InstalledSet | None, bundle: Bundle, wanted: Mapping[str, object]
) -> dict[str, int]:
    """The number of the bundle from which each participant in `wanted` comes, if it has one."""
    kept = before.numbers if before else {}
    known = {name: bundle.number if name in bundle.names else kept.get(name) for name in wanted}
    return {name: number for name, number in known.items() if number is not None}


def _same_authorities(one: Bundle, other: Bundle) -> bool:
    """Whether both have the same CAs in the same files; False if one cannot be read."""
    try:
        return one.roles == other.roles
    except PqsecError:
        return False


def _keys(
    verified: VerifiedCredentials, bundle: Bundle, store: CredentialStore, pin: Pin
) -> Mapping[str, bytes]:
    """The private keys: from the bundle, or created or installed here before."""
    name = verified.name
    inside = {key: data for key, data in bundle.enclaves[name].items() if key in KEYS}
    return keys_of(verified, [inside] if inside else store.keys(name), pin)


def _result(
    found: VerifiedBundle, store: CredentialStore, bundle: Bundle, *, already: bool
) -> Installed:
    return Installed(
        names=tuple(each.name for each in found.verified),
        not_after=min(each.certificate.not_after for each in found.verified),
        current=store.root / CURRENT,
        already=already,
        bundle=bundle.number,
        receipt=store.receipt,
    )
