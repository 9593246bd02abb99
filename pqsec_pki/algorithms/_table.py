"""A table of rows that are found by name."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Generic, Protocol, TypeVar

from pqsec_pki.errors import UnknownAlgorithmError


class Family(StrEnum):
    """The kind of problem that an algorithm's security is based on."""

    CLASSICAL = "classical"
    PQ = "pq"
    HYBRID = "hybrid"


@dataclass(frozen=True, slots=True, kw_only=True)
class Registered:
    """An algorithm in public registries, for inventories such as CycloneDX."""

    oid: str | None = None
    """The OID of signatures, or of the key agreement; None if it has none."""
    family: str | None = None
    """The family in CycloneDX's registry of cryptography; None for a combination."""
    parameter_set: str | None = None
    """Such as 65 for ML-DSA-65, or 2048 for RSA with a modulus of 2048 bits."""
    curve: str | None = None
    """The elliptic curve, as in that registry."""
    classical_level: int
    """Bits of security without a quantum computer: NIST SP 800-57 part 1, table 2, where a size
    between two rows counts as the smaller; for ML-DSA and ML-KEM, the AES key of their category."""


class AlgorithmRow(Protocol):
    """The attributes of rows that a table needs."""

    @property
    def name(self) -> str: ...
    @property
    def aliases(self) -> tuple[str, ...]: ...
    @property
    def wire_name(self) -> str: ...


RowT = TypeVar("RowT", bound=AlgorithmRow)


class AlgorithmTable(Generic[RowT]):
    """Rows in the given order; each name and alias belongs to one row."""

    def __init__(self, kind: str, rows: Sequence[RowT]) -> None:
        self._kind = kind
        self._rows = tuple(rows)
        self._by_name = {name: row for row in rows for name in (row.name, *row.aliases)}
        if len(self._by_name) != sum(1 + len(row.aliases) for row in rows):
            raise AssertionError(f"two rows of {kind} share a name")

    def __iter__(self) -> Iterator[RowT]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)

    def named(self, name: str) -> RowT:
        """The row with the name `name`, in any case, with or without `id-`.

        UnknownAlgorithmError, with the known names, if there is none.
        """
        try:
            return self._by_name[name.lower().removeprefix("id-")]
        except KeyError:
            known = ", ".join(row.name for row in self)
            raise UnknownAlgorithmError(
                f"no {self._kind} named {name!r}", hint=f"known: {known}"
            ) from None

    def on_wire(self, wire_name: str) -> RowT:
        """The row with that `wire_name`; UnknownAlgorithmError if there is none."""
        for row in self:
            if row.wire_name == wire_name:
                return row
        raise UnknownAlgorithmError(f"no {self._kind} called {wire_name!r} on the wire")
