"""Cryptographic assets while they are collected: each once, with all its places."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import field
from typing import Any

from cyclonedx.model.bom_ref import BomRef
from cyclonedx.model.crypto import CryptoProperties

from pqsec_pki._dataclass import dataclass


@dataclass(slots=True, kw_only=True)
class Asset:
    """One component of a bill."""

    ref: str
    name: str
    crypto: CryptoProperties
    needs: tuple[str, ...] = ()
    """The refs of what it depends on."""
    sha256: str | None = None
    """In hex, of its DER."""
    details: tuple[tuple[str, str], ...] = ()
    """Properties below `pqsec:`, for what CycloneDX has no field for."""
    added: Mapping[str, Any] = field(default_factory=dict)
    """Fields of CycloneDX 1.7 that its library does not have, for the properties of the kind."""
    places: set[str] = field(default_factory=set)
    """Paths of files, relative to what the user named."""


class Assets:
    """Assets by their refs."""

    def __init__(self) -> None:
        self._found: dict[str, Asset] = {}

    def __iter__(self) -> Iterator[Asset]:
        return (self._found[ref] for ref in sorted(self._found))

    def add(self, asset: Asset, *places: str) -> str:
        """Add `asset`, or only `places` if it is known; its ref."""
        self._found.setdefault(asset.ref, asset).places.update(places)
        return asset.ref

    @property
    def counts(self) -> dict[str, int]:
        """Number of assets by assetType, in alphabetical order."""
        kinds = (each.crypto.asset_type.value for each in self if each.crypto.asset_type)
        return dict(sorted(Counter(kinds).items()))


def bom_ref(ref: str | None) -> BomRef | None:
    """`ref` as a value of the library."""
    return None if ref is None else BomRef(ref)


def bom_refs(refs: Iterable[str]) -> list[BomRef]:
    """`refs` as values of the library."""
    return [BomRef(ref) for ref in refs]
