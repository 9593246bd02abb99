"""What a participant requires in handshakes: from its keys, or from `pqsec.toml`."""

from collections.abc import Callable, Mapping
from dataclasses import field
from typing import Any, Self

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
from pqsec_pki.handshake import PeerRequirements, WireVersion, stock_name
from pqsec_pki.plugin.credentials import Source, octets_of

SETTINGS = "pqsec.toml"
STOCK, OURS = "stock", "pqsec"
MAX_SETTINGS = 64 << 10
"""Octets: enough for the names of 1000 participants."""
HERE = "."
"""The folder of the set that is in the folder of pqsec.toml."""
_FIRST = (WireVersion.FIRST,)
_NUMBERS = ([1], [1, 2], [2, 1], [2])
"""The values of wire_versions."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SettingsFile:
    """What `pqsec.toml` says; the defaults are those without it."""

    peers: str = OURS
    """Of a participant with one set: whether peers run the stack's own plugin."""
    agreements: tuple[KeyAgreement, ...] | None = None
    """Key agreements in place of those of the keys."""
    versions: tuple[WireVersion, ...] = _FIRST
    proofs: bool = False
    stock: tuple[str, ...] = ()
    """Names and patterns of participants that may be met with the first set."""
    sets: Mapping[str, str] = field(default_factory=dict)
    """Profile -> folder of each set that must be there, that of stock stacks first and the
    strongest last; HERE for this folder. Empty: one set, that of the certificate."""

    @classmethod
    def beside(cls, source: Source) -> Self:
        """The file beside the certificate; UsageError if it is invalid."""
        path = source.beside(SETTINGS)
        if path is None:
            return cls()
        with located(path):
            return cls.parsed(octets_of(path, limit=MAX_SETTINGS))

    @classmethod
    def parsed(cls, text: bytes) -> Self:
        """The settings in TOML; UsageError for anything else."""
        import tomllib  # noqa: PLC0415 -- few have such a file, and hosts wait for the agent's start

        try:
            found = tomllib.loads(text.decode())
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise UsageError(f"not TOML: {error}") from error
        unknown = sorted(set(found) - set(_FITS))
        if unknown or not all(_FITS[name](value) for name, value in found.items()):
            words = f"{unknown[0]} is not a setting" if unknown else "a setting has no such value"
            raise UsageError(words, hint=_VALUES)
        _refuse_combinations(found)
        try:
            names = found.get("key_agreements", [])
            rows = tuple(KEY_AGREEMENTS.named(str(name).lower()) for name in names)
            stock = tuple(map(stock_name, found.get("stock", [])))
        except PqsecError as error:
            raise UsageError(str(error), hint=error.hint) from error
        return cls(
            peers=found.get("peers", OURS),
            agreements=rows or None,
            versions=tuple(map(WireVersion, found.get("wire_versions", [1]))),
            proofs=found.get("proofs", False),
            stock=stock,
            sets=found.get("sets", {}),
        )

    @property
    def text(self) -> str:
        """The file, in TOML: a setting that has its default is left out."""
        import json  # noqa: PLC0415 -- for an export only; its strings are TOML's basic strings

        found: dict[str, Any] = {}
        if self.sets:
            found["stock"] = list(self.stock)
        elif self.peers != OURS:
            found["peers"] = self.peers
        if self.agreements:
            found["key_agreements"] = [each.name for each in self.agreements]
        if self.versions != _FIRST:
            found["wire_versions"] = list(map(int, self.versions))
        if self.proofs:
            found["proofs"] = True
        lines = [f"{name} = {json.dumps(value)}" for name, value in found.items()]
        lines += ["[sets]"] if self.sets else []
        lines += [f"{name} = {json.dumps(folder)}" for name, folder in self.sets.items()]
        return "\n".join([*lines, ""])


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
    def of(cls, certificate: Certificate, file: SettingsFile) -> Self:
        """The settings of the only set, or of the strongest, in `file`, else those of its keys.

        UsageError for stock peers if its keys are not for them.
        """
        stock = file.peers == STOCK
        if stock:
            _refuse_without_plain_key(certificate)
        usual = STOCK_AGREEMENTS if stock else _by_keys(certificate)
        return cls(
            agreements=file.agreements or usual,
            stock_peers=stock,
            versions=file.versions,
            proofs=file.proofs,
        )

    @classmethod
    def of_weaker(cls, certificate: Certificate, file: SettingsFile) -> Self:
        """The settings of a set that is not the strongest: what `file` chooses is not for it."""
        plain = certificate.public_key.algorithm.family is Family.CLASSICAL
        agreements = STOCK_AGREEMENTS if plain else _by_keys(certificate)
        return cls(agreements=agreements, stock_peers=False, proofs=file.proofs)

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


_VALUES = (
    f'stock = ["/name", "/fleet/*"]; peers = "{OURS}" or "{STOCK}"; key_agreements ='
    ' ["x25519mlkem768"]; wire_versions = [2, 1]; proofs = true; a table sets, as'
    " `pqsec export --plugin` writes it"
)


def _are_texts(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(each, str) and each for each in value)


def _are_sets(value: Any) -> bool:
    """Of at least two sets, one of them here."""
    folders = list(value.values()) if isinstance(value, dict) else []
    return len(folders) > 1 and _are_texts(folders) and folders.count(HERE) == 1


# types first: a list is in no set, and True and 1.0 equal 1
_FITS: Mapping[str, Callable[[Any], bool]] = {
    "peers": lambda value: isinstance(value, str) and value in {OURS, STOCK},
    "key_agreements": lambda value: isinstance(value, list),
    "wire_versions": lambda value: (
        isinstance(value, list) and all(type(each) is int for each in value) and value in _NUMBERS
    ),
    "proofs": lambda value: isinstance(value, bool),
    "stock": _are_texts,
    "sets": _are_sets,
}
"""Setting -> whether a value fits."""


def _refuse_combinations(found: Mapping[str, Any]) -> None:
    if "stock" in found and "sets" not in found:
        raise UsageError(
            "stock is for a participant with several sets, and there is no table sets",
            hint="name the sets of credentials in a table sets",
        )
    if "peers" in found and "sets" in found:
        raise UsageError(
            "peers is about everybody, and is for a participant with one set of credentials",
            hint='name those that may be met with the first set: stock = ["/name"]',
        )
