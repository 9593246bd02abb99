"""Which signature keys and key agreements are measured together."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import (
    KEY_AGREEMENTS,
    PROFILES,
    SIGNATURES,
    Family,
    KeyAgreement,
    Profile,
    SignatureAlgorithm,
)
from pqsec_pki.handshake import WireVersion

_USUAL = {
    Family.CLASSICAL: "ecdh-p256",
    Family.HYBRID: "x25519mlkem768",
    Family.PQ: "mlkem768",
}
"""The key agreement of a key that is measured without one of its own."""


@dataclass(frozen=True, slots=True)
class HandshakeSuite:
    """What the CA and both participants sign with, and how they agree on a secret."""

    signature: SignatureAlgorithm
    agreement: KeyAgreement
    alternative: SignatureAlgorithm | None = None
    """The second key of certificates with two (X.509, 9.8)."""
    profile: str | None = None
    """The profile that has exactly these algorithms."""
    version: WireVersion = WireVersion.FIRST
    """The version of the messages."""

    def in_version(self, version: WireVersion) -> Self:
        """This suite with messages of `version`, if its key agreement has such messages."""
        return replace(self, version=version) if self.agreement.binds_transcript else self

    @property
    def keys(self) -> str:
        """The names of the keys, with + between two."""
        second = f"+{self.alternative.name}" if self.alternative else ""
        return f"{self.signature.name}{second}"

    def __str__(self) -> str:
        return f"{self.keys} with {self.agreement.name}"


def suites_of(
    profiles: Sequence[Profile] = (),
    signatures: Sequence[SignatureAlgorithm] = (),
    agreements: Sequence[KeyAgreement] = (),
) -> tuple[HandshakeSuite, ...]:
    """The keys of these profiles and these signatures, each with each of the key agreements.

    Without profiles and signatures, the keys of all profiles. Without key agreements, a profile
    with its own, and a signature with the usual one of its family.
    """
    if not (profiles or signatures):
        profiles = PROFILES
    chosen = (*map(_of_profile, profiles), *map(_of_signature, signatures))
    return tuple(dict.fromkeys(_with(chosen, agreements)))


def every_suite() -> tuple[HandshakeSuite, ...]:
    """Each signature with each key agreement."""
    pairs = product(SIGNATURES, KEY_AGREEMENTS)
    return tuple(HandshakeSuite(signature, agreement) for signature, agreement in pairs)


def _of_profile(profile: Profile) -> HandshakeSuite:
    return HandshakeSuite(
        profile.participant_key, profile.key_agreement, profile.alternative_key, profile.name
    )


def _of_signature(signature: SignatureAlgorithm) -> HandshakeSuite:
    return HandshakeSuite(signature, KEY_AGREEMENTS.named(_USUAL[signature.family]))


def _with(
    chosen: Sequence[HandshakeSuite], agreements: Sequence[KeyAgreement]
) -> Iterator[HandshakeSuite]:
    for suite in chosen:
        for agreement in agreements or (suite.agreement,):
            same = agreement is suite.agreement
            profile = suite.profile if same else None
            yield HandshakeSuite(suite.signature, agreement, suite.alternative, profile)
