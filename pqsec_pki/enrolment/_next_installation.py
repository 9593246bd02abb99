"""The files that an installation makes the current ones."""

from collections.abc import Mapping
from datetime import datetime
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.credentials import KEYS, PROOF, REVOCATION_LIST, VerifiedCredentials
from pqsec_pki.enrolment.bundle import Bundle
from pqsec_pki.enrolment.credential_store import CredentialStore, Enclaves, Installation
from pqsec_pki.enrolment.receipt import receipt_of
from pqsec_pki.enrolment.trust import TrustState
from pqsec_pki.enrolment.verification import VerifiedBundle, keys_of
from pqsec_pki.errors import PqsecError, VerificationError
from pqsec_pki.tokens import Pin


@dataclass(frozen=True, slots=True)
class NextInstallation:
    """What will be installed, and what is installed now."""

    before: Installation | None
    enclaves: dict[str, dict[str, bytes]]
    numbers: dict[str, int]
    pin: Pin

    @classmethod
    def of(  # noqa: PLR0913 -- by name
        cls,
        bundle: Bundle,
        found: VerifiedBundle,
        store: CredentialStore,
        *,
        before: Installation | None,
        alone: bool,
        pin: Pin,
    ) -> Self:
        """The verified files and their private keys; with other participants, unless `alone`.

        VerificationError if others were issued by other CAs, or a private key is not there.
        """
        keys = {each.name: _keys(each, bundle, store, pin) for each in found.verified}
        others = {} if alone else _others(before, bundle, found)
        wanted = {name: {**files, **keys[name]} for name, files in found.files.items()}
        wanted = dict(sorted({**others, **wanted}.items()))
        return cls(before, wanted, _numbers(before, bundle, wanted), pin)

    def put(self, store: CredentialStore, trust: TrustState, now: datetime) -> bool:
        """Make it the current installation, with its receipt.

        Whether the same files were installed already: then only trust and receipt are written.
        """
        trust = trust.with_next_receipt()
        if self.before and _same(self.before.enclaves, self.enclaves):
            store.trust(trust)
            store.save_receipt(self._receipt(trust, self.before.at, now))
            return True
        receipt = self._receipt(trust, now, now)
        store.put(self.enclaves, trust, now, numbers=self.numbers, receipt=receipt)
        return False

    def _receipt(self, trust: TrustState, installed_at: datetime, now: datetime) -> bytes:
        return receipt_of(
            self.enclaves, self.numbers, trust, installed_at=installed_at, now=now, pin=self.pin
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


def _others(
    before: Installation | None, bundle: Bundle, found: VerifiedBundle
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
    before: Installation | None, bundle: Bundle, wanted: Mapping[str, object]
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
