"""Profiles: algorithms that are used together, under one name that the user chooses.

A profile has promised properties; each is a check that a modified profile must still pass.
"""

from collections.abc import Callable
from dataclasses import field, replace
from typing import Any, Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms._agreement import KeyAgreement
from pqsec_pki.algorithms._row import SignatureAlgorithm
from pqsec_pki.algorithms._table import Family
from pqsec_pki.algorithms.key_agreement import KEY_AGREEMENTS
from pqsec_pki.algorithms.signature import EVERYWHERE, SIGNATURES
from pqsec_pki.errors import MalformedError, UnknownAlgorithmError, UsageError

STOCK_AGREEMENT = KEY_AGREEMENTS.named("ecdh-p256")
"""The key agreement with a stock peer, if the profile allows one."""
STOCK_AGREEMENTS = (STOCK_AGREEMENT, KEY_AGREEMENTS.named("dh-modp-2048-256"))
"""All that DDS-Security 1.1 has."""


@dataclass(frozen=True, slots=True)
class Promise:
    """A promised property of a profile, and its check."""

    text: str
    kept: "Callable[[Profile], bool]" = field(repr=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Profile:
    """Algorithms for the CAs, the participants and the handshake that fit together."""

    name: str
    summary: str
    identity_key: SignatureAlgorithm
    permissions_key: SignatureAlgorithm
    participant_key: SignatureAlgorithm
    alternative_key: SignatureAlgorithm | None
    """The second key of CA and participant certificates, and of the countersigner."""
    key_agreement: KeyAgreement
    promises: tuple[Promise, ...] = field(repr=False)

    def __post_init__(self) -> None:
        broken = [promise.text for promise in self.promises if not promise.kept(self)]
        if broken:
            raise UsageError(
                f"this combination breaks what profile {self.name} promises: {'; '.join(broken)}",
                hint="choose another profile (`pqsec profiles`) or leave that option out",
            )

    @property
    def runs_in_stock(self) -> bool:
        """Whether unmodified DDS stacks can use credentials of this profile."""
        return _stock(self)

    @property
    def runs_in(self) -> str:
        """The stock stacks that support it, in words."""
        if not self.runs_in_stock:
            return "no stock stack today"
        if self.alternative_key:  # its handshake messages are larger than the limit
            return (
                "all stock stacks but Fast DDS 2.14.4, 3.0.2, 3.1.1 to 3.1.3 and 3.2.0 to 3.2.2"
                " (8192-byte limit)"
            )
        return "all stock stacks"

    @property
    def level(self) -> int:
        """NIST security category of the weakest part against a quantum computer; 0 means none."""
        return min(self.signature_level, self.key_agreement.level)

    @property
    def signature_level(self) -> int:
        """The category of the signatures of certificates and documents."""
        if self.alternative_key:
            return self.alternative_key.level
        return min(row.level for row in self.signature_keys)

    @property
    def participant_level(self) -> int:
        """The category of the strongest key of a participant's certificate."""
        second = self.alternative_key
        return max(self.participant_key.level, second.level if second else 0)

    @property
    def signature_keys(self) -> tuple[SignatureAlgorithm, ...]:
        """The algorithms of the CAs' and participants' main keys."""
        return (self.identity_key, self.permissions_key, self.participant_key)

    def changed(self, choices: dict[str, str | None]) -> Self:
        """This profile with other algorithms, by field and name; None leaves a field.

        UsageError if a promised property is lost, UnknownAlgorithmError for an unknown name.
        """
        rows: dict[str, Any] = {
            key: _row(key, name) for key, name in choices.items() if name is not None
        }
        return replace(self, **rows) if rows else self

    def to_names(self) -> dict[str, str | None]:
        """The names of the profile and its algorithms, for the keystore."""
        names: dict[str, str | None] = {"profile": self.name}
        for key in _CHOICES:
            row = getattr(self, key)
            names[key] = row.name if row else None
        return names

    def to_json(self) -> dict[str, object]:
        """The profile for --json."""
        return self.to_names() | {
            "summary": self.summary,
            "promises": [promise.text for promise in self.promises],
            "level": self.level,
            "runs_in_stock_stacks": self.runs_in_stock,
            "runs_in": self.runs_in,
            "default": self is DEFAULT_PROFILE,
        }

    @classmethod
    def from_names(cls, names: dict[str, str | None]) -> "Profile":
        """The inverse of to_names; MalformedError if `names` are not from to_names."""
        try:
            chosen = profile_named(str(names["profile"]))
            return chosen.changed({key: names[key] for key in _CHOICES})
        except (KeyError, TypeError, AttributeError, UsageError) as error:
            raise MalformedError(f"not a profile that pqsec wrote: {error}") from None


_CHOICES = (
    "identity_key",
    "permissions_key",
    "participant_key",
    "alternative_key",
    "key_agreement",
)


def profile_named(name: str) -> Profile:
    """The profile called `name`; UnknownAlgorithmError, with the known ones, if there is none."""
    for profile in PROFILES:
        if profile.name == name.lower():
            return profile
    known = ", ".join(profile.name for profile in PROFILES)
    raise UnknownAlgorithmError(f"no profile named {name!r}", hint=f"known: {known}")


def usual_agreements(
    key: SignatureAlgorithm, alternative: SignatureAlgorithm | None
) -> tuple[KeyAgreement, ...]:
    """The key agreements of participants with such keys, the preferred first.

    That of the profile with such keys; for other keys, one of their kind.
    """
    if key.family is Family.CLASSICAL and alternative is None:
        return STOCK_AGREEMENTS
    for profile in PROFILES:
        if profile.participant_key is key and profile.alternative_key is alternative:
            return (profile.key_agreement,)
    return (DEFAULT_PROFILE.key_agreement,)


def _row(key: str, name: str) -> SignatureAlgorithm | KeyAgreement:
    return KEY_AGREEMENTS.named(name) if key == "key_agreement" else SIGNATURES.named(name)


def _families(profile: Profile) -> set[Family]:
    return {profile.key_agreement.family, *(row.family for row in profile.signature_keys)}


def _stock(profile: Profile) -> bool:
    # The permissions CA may be any RSA or ECDSA key; identities only P-256 and RSA-2048.
    return profile.permissions_key.family is Family.CLASSICAL and all(
        row.runs_in == EVERYWHERE for row in (profile.identity_key, profile.participant_key)
    )


_RUNS_IN_STOCK = Promise("runs in stock stacks unchanged (P-256 or RSA-2048 identities)", _stock)
_PQ_BESIDE = Promise(
    "every certificate and document also carries an ML-DSA signature",
    lambda p: p.alternative_key is not None and p.alternative_key.family is Family.PQ,
)
_NO_SECOND_KEY = Promise("has no alternative key", lambda p: p.alternative_key is None)
_PQ_AGREEMENT = Promise(
    "recorded traffic between pqsec peers stays secret from a quantum computer",
    lambda p: p.key_agreement.level > 0,
)
_QUANTUM_SAFE = Promise(
    "every signature and key agreement withstands a quantum computer",
    lambda p: Family.CLASSICAL not in _families(p),
)
_ALL_HYBRID = Promise(
    "every signature and key agreement is secure while either half is",
    lambda p: _families(p) == {Family.HYBRID},
)
_CNSA2 = Promise(
    "CNSA 2.0: ML-DSA-87 and ML-KEM-1024 only",
    lambda p: (
        all(row.name == "ml-dsa-87" for row in p.signature_keys)
        and p.key_agreement.name == "mlkem1024"
    ),
)
_CLASSICAL_AGREEMENT = Promise(
    "the key agreement is one that stock stacks run",
    lambda p: p.key_agreement.name in {"ecdh-p256", "dh-modp-2048-256"},
)


def _profile(
    name: str,
    summary: str,
    key: str,
    *promises: Promise,
    agreement: str,
    alternative: str | None = None,
) -> Profile:
    row = SIGNATURES.named(key)
    return Profile(
        name=name,
        summary=summary,
        identity_key=row,
        permissions_key=row,
        participant_key=row,
        alternative_key=SIGNATURES.named(alternative) if alternative else None,
        key_agreement=KEY_AGREEMENTS.named(agreement),
        promises=promises,
    )


PROFILES = (
    _profile(
        "transition",
        "runs in stock stacks, with ML-DSA signatures as well",
        "ecdsa-p256",
        _RUNS_IN_STOCK,
        _PQ_BESIDE,
        _PQ_AGREEMENT,
        alternative="ml-dsa-65",
        agreement="x25519mlkem768",
    ),
    _profile(
        "hybrid",
        "composite keys: secure while either algorithm is",
        "mldsa65-ecdsa-p256-sha512",
        _ALL_HYBRID,
        _NO_SECOND_KEY,
        agreement="x25519mlkem768",
    ),
    _profile(
        "pq",
        "post-quantum only",
        "ml-dsa-65",
        _QUANTUM_SAFE,
        _NO_SECOND_KEY,
        agreement="mlkem768",
    ),
    _profile(
        "cnsa2",
        "post-quantum only, at the level that CNSA 2.0 requires",
        "ml-dsa-87",
        _CNSA2,
        _NO_SECOND_KEY,
        agreement="mlkem1024",
    ),
    _profile(
        "classical",
        "classical only, as every stack supports it",
        "ecdsa-p256",
        _RUNS_IN_STOCK,
        _NO_SECOND_KEY,
        _CLASSICAL_AGREEMENT,
        agreement="ecdh-p256",
    ),
)
DEFAULT_PROFILE = PROFILES[0]
