"""The files that an installation makes the current ones."""

from collections.abc import Mapping
from datetime import datetime
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.credentials import KEYS, PROOF, REVOCATION_LIST, VerifiedCredentials
from pqsec_pki.enrolment.bundle import Bundle, Enclaves
from pqsec_pki.enrolment.credential_store import CredentialStore, InstalledCredentials
from pqsec_pki.enrolment.receipt import receipt_of
from pqsec_pki.enrolment.trust import TrustState
from pqsec_pki.enrolment.verification import VerifiedBundle, keys_of
from pqsec_pki.errors import PqsecError, VerificationError
from pqsec_pki.keystore import layout
from pqsec_pki.tokens import Pin


@dataclass(frozen=True, slots=True)
class NextInstallation:
    """What will be installed, and what is installed now."""

    before: InstalledCredentials | None
    sets: Mapping[str, Enclaves]
    """The enclaves of each set of credentials."""
    numbers: dict[str, int]
    pin: Pin

    @classmethod
    def of(  # noqa: PLR0913 -- by name
        cls,
        bundle: Bundle,
        found: VerifiedBundle,
        store: CredentialStore,
        *,
        before: InstalledCredentials | None,
        alone: bool,
        pin: Pin,
    ) -> Self:
        """The verified files and their private keys; with other participants, unless `alone`.

        VerificationError if others were issued by other CAs, or a private key is not there.
        """
        others = {} if alone else _others(before, bundle, found)
        sets = dict[str, Enclaves]()
        for place, verified in found.sets.items():
            keys = {each.name: _keys(place, each, bundle, store, pin) for each in verified}
            own = {name: {**each, **keys[name]} for name, each in found.files[place].items()}
            sets[place] = dict(sorted({**others.get(place, {}), **own}.items()))
        return cls(before, sets, _numbers(before, bundle, sets[layout.FIRST]), pin)

    def put(self, store: CredentialStore, trust: TrustState, now: datetime) -> bool:
        """Make it the current installation, with its receipt.

        Whether the same files were installed already: then only trust and receipt are written.
        """
        trust = trust.with_next_receipt()
        if self.before and _same(self.before.sets, self.sets):
            store.trust(trust)
            store.save_receipt(self._receipt(trust, self.before.at, now))
            return True
        receipt = self._receipt(trust, now, now)
        store.put(self.sets, trust, now, numbers=self.numbers, receipt=receipt)
        return False

    def _receipt(self, trust: TrustState, installed_at: datetime, now: datetime) -> bytes:
        return receipt_of(
            self.sets, self.numbers, trust, installed_at=installed_at, now=now, pin=self.pin
        )


def _same(before: Mapping[str, Enclaves], wanted: Mapping[str, Enclaves]) -> bool:
    """Whether the files of all sets are the same."""
    return before.keys() == wanted.keys() and all(
        _same_enclaves(before[place], wanted[place]) for place in wanted
    )


def _same_enclaves(before: Enclaves, wanted: Enclaves) -> bool:
    """Whether the files are the same; another proof of the same documents is as good."""
    if any(
        PROOF in wanted[name] and PROOF not in before[name] for name in wanted if name in before
    ):
        return False
    plain = [
        {name: {**files, PROOF: b""} for name, files in each.items()} for each in (before, wanted)
    ]
    return plain[0] == plain[1]


def _others(
    before: InstalledCredentials | None, bundle: Bundle, found: VerifiedBundle
) -> dict[str, dict[str, dict[str, bytes]]]:
    """The other installed participants, by set; VerificationError for those of other CAs, or that
    have not all sets of the bundle."""
    others = {
        place: {name: dict(files) for name, files in each.items() if name not in bundle.names}
        for place, each in (before.sets if before else {}).items()
    }
    if not before or not any(others.values()):
        return {}
    if not _same_authorities(before, others, bundle):
        names = ", ".join(sorted({name for each in others.values() for name in each}))
        raise VerificationError(
            f"also installed: {names}, which were not issued by the bundle's CAs",
            hint="create a bundle for all of them with `pqsec bundle`, or remove them with --only",
        )
    for place, enclaves in found.files.items():
        for files in enclaves.values():
            if REVOCATION_LIST in files:
                for each in others[place].values():
                    each[REVOCATION_LIST] = files[REVOCATION_LIST]
    return others


def _numbers(
    before: InstalledCredentials | None, bundle: Bundle, wanted: Mapping[str, object]
) -> dict[str, int]:
    """The number of the bundle from which each participant in `wanted` comes, if it has one."""
    kept = before.numbers if before else {}
    known = {name: bundle.number if name in bundle.names else kept.get(name) for name in wanted}
    return {name: number for name, number in known.items() if number is not None}


def _same_authorities(
    before: InstalledCredentials, others: Mapping[str, Enclaves], bundle: Bundle
) -> bool:
    """Whether each of `others` has the CAs of `bundle` in the same files, and is in each of its
    sets; False if one cannot be read."""
    names = others[layout.FIRST].keys()
    further = {place: each for place, each in others.items() if place != layout.FIRST}
    if any(each.keys() != names for each in further.values()):
        return False
    try:
        return Bundle(before.at, others[layout.FIRST], further=further).roles == bundle.roles
    except PqsecError:
        return False


def _keys(
    place: str, verified: VerifiedCredentials, bundle: Bundle, store: CredentialStore, pin: Pin
) -> Mapping[str, bytes]:
    """The private keys in a set: from the bundle, or created or installed here before."""
    name = verified.name
    inside = {key: data for key, data in bundle.sets[place][name].items() if key in KEYS}
    return keys_of(verified, [inside] if inside else store.keys(name, place), pin)
