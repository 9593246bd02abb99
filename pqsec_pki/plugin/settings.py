"""What a participant requires in handshakes: from its keys, or from `pqsec.toml`."""

from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import (
    KEY_AGREEMENTS,
    STOCK_AGREEMENTS,
    Family,
    KeyAgreement,
    usual_agreements,
)
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import PqsecError, UsageError, located
from pqsec_pki.handshake import PeerRequirements, WireVersion
from pqsec_pki.plugin.credentials import Source, octets_of

SETTINGS = "pqsec.toml"
STOCK, OURS = "stock", "pqsec"
MAX_SETTINGS = 4096
"""Octets."""
_FIRST = (WireVersion.FIRST,)
_NUMBERS = ([1], [1, 2], [2, 1], [2])
"""The values of wire_versions."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentSettings:
    """How an identity is used in handshakes. A peer cannot change it."""

    agreements: tuple[KeyAgreement, ...]
    """The key agreements that a peer may propose; we propose the first."""
    stock_peers: bool
    """Whether peers run the stack's own plugin: plain keys and key agreements are then accepted."""
    versions: tuple[WireVersion, ...] = _FIRST
    """The versions of messages that a peer may send, the one that we prefer first."""
    proofs: bool = False
    """Whether its own certificate and documents must be proven to be in the ledger."""

    @classmethod
    def of(cls, certificate: Certificate, source: Source) -> Self:
        """The settings in `pqsec.toml` beside the certificate, else those of its keys.

        UsageError for an invalid file.
        """
        stock, agreements, proofs = OURS, None, False
        versions: tuple[WireVersion, ...] = _FIRST
        if path := source.beside(SETTINGS):
            with located(path):
                data = octets_of(path, limit=MAX_SETTINGS)
                stock, agreements, versions, proofs = _parsed(data)
        if stock == STOCK:
            _refuse_without_plain_key(certificate)
        usual = STOCK_AGREEMENTS if stock == STOCK else _by_keys(certificate)
        return cls(
            agreements=agreements or usual,
            stock_peers=stock == STOCK,
            versions=versions,
            proofs=proofs,
        )

    def policy(self, certificate: Certificate) -> PeerRequirements:
        """The requirements on peers of the holder of `certificate`."""
        pairs = certificate.alternative_key is not None and not self.stock_peers
        return PeerRequirements(
            agreements=self.agreements, versions=self.versions, require_alternative=pairs
        )


def _by_keys(certificate: Certificate) -> tuple[KeyAgreement, ...]:
    second = certificate.alternative_key
    return usual_agreements(certificate.public_key.algorithm, second.algorithm if second else None)


def _refuse_without_plain_key(certificate: Certificate) -> None:
    row = certificate.public_key.algorithm
    if row.family is not Family.CLASSICAL:
        raise UsageError(
            f"a peer with the stack's own plugin accepts no {row.name} key",
            hint=f"leave peers out of {SETTINGS}, or issue identities of profile transition",
        )


def _parsed(
    text: bytes,
) -> tuple[str, tuple[KeyAgreement, ...] | None, tuple[WireVersion, ...], bool]:
    import tomllib  # noqa: PLC0415 -- few have such a file, and hosts wait for the agent's start

    try:
        found = tomllib.loads(text.decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"not TOML: {error}") from error
    unknown = sorted(set(found) - {"peers", "key_agreements", "wire_versions", "proofs"})
    peers, names = found.get("peers", OURS), found.get("key_agreements", [])
    numbers, proofs = found.get("wire_versions", [1]), found.get("proofs", False)
    # types first: a list is in no set, and True and 1.0 equal 1
    fits = isinstance(peers, str) and isinstance(names, list) and isinstance(numbers, list)
    fits = (
        fits
        and isinstance(proofs, bool)
        and all(type(each) is int for each in numbers)
        and numbers in _NUMBERS
    )
    if unknown or not fits or peers not in {OURS, STOCK}:
        raise UsageError(
            f"{unknown[0]} is not a setting" if unknown else "a setting has no such value",
            hint=f'peers = "{OURS}" or "{STOCK}"; key_agreements = ["x25519mlkem768"];'
            " wire_versions = [2, 1]; proofs = true",
        )
    try:
        agreements = tuple(KEY_AGREEMENTS.named(str(name).lower()) for name in names) or None
    except PqsecError as error:
        raise UsageError(str(error), hint=error.hint) from error
    return peers, agreements, tuple(map(WireVersion, numbers)), proofs
