"""A table of rows that are found by name."""

import warnings
from collections.abc import Iterator, Sequence
from enum import StrEnum
from typing import Any, Generic, Protocol, TypeVar

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import ForeignAlgorithmWarning, ForeignPackageError, UnknownAlgorithmError


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
    def to_json(self) -> dict[str, object]: ...


RowT = TypeVar("RowT", bound=AlgorithmRow)


class AlgorithmTable(Generic[RowT]):
    """Rows in the given order; each name and alias belongs to one row.

    Experimental rows, and those of other packages, are found by name; iteration leaves them out.
    """

    def __init__(
        self,
        kind: str,
        rows: Sequence[RowT],
        experimental: Sequence[RowT] = (),
        foreign: tuple[str, type[Any]] | None = None,
    ) -> None:
        """`foreign` is the entry point group of other packages' rows, and their class."""
        self._kind = kind
        self._foreign = foreign
        self.added: dict[str, tuple[RowT, str]] = {}
        """The loaded rows of other packages by name, and the package with its version."""
        self._rows = tuple(rows)
        self.experimental = tuple(experimental)
        every = (*rows, *experimental)
        self._by_name = {name: row for row in every for name in (row.name, *row.aliases)}
        if len(self._by_name) != sum(1 + len(row.aliases) for row in every):
            raise AssertionError(f"two rows of {kind} share a name")

    def __iter__(self) -> Iterator[RowT]:
        return iter(self._rows)

    def every(self) -> Iterator[RowT]:
        """All rows: also the experimental ones, and those of other packages that are loaded."""
        yield from (*self._rows, *self.experimental)
        yield from (row for row, _ in tuple(self.added.values()))  # a thread may add one meanwhile

    def to_json(self) -> list[dict[str, object]]:
        """Each row of `every`, whether it is experimental, and its package if not pqsec."""
        return [
            row.to_json()
            | {
                "experimental": row in self.experimental,
                "package": self.added[row.name][1] if row.name in self.added else None,
            }
            for row in self.every()
        ]

    def __len__(self) -> int:
        return len(self._rows)

    def named(self, name: str) -> RowT:
        """The row with the name `name`, in any case, with or without `id-`.

        UnknownAlgorithmError, with the known names, if there is none.
        """
        wanted = name.lower().removeprefix("id-")
        if row := self._by_name.get(wanted) or self._of_another_package(wanted):
            return row
        known = ", ".join(row.name for row in self)
        raise UnknownAlgorithmError(f"no {self._kind} named {name!r}", hint=f"known: {known}")

    def load_foreign(self) -> list[ForeignPackageError]:
        """Load the rows of all other packages into `added`; the errors of those that cannot be."""
        from pqsec_pki import _packages  # noqa: PLC0415 -- few ask for such rows

        errors = []
        group, _ = self._foreign or ("", None)
        try:
            entries = _packages.offered(group)
        except ForeignPackageError as error:
            return [error]
        for name in dict.fromkeys(entry.name.lower() for entry in entries):
            try:
                self._of_another_package(name)
            except ForeignPackageError as error:
                errors.append(error)
        return errors

    def _of_another_package(self, name: str) -> RowT | None:
        """The row of an installed package; None if none offers it."""
        if name in self.added:
            return self.added[name][0]
        if not self._foreign:
            return None
        from pqsec_pki import _packages  # noqa: PLC0415 -- few ask for such rows
        from pqsec_pki.algorithms import _foreign  # noqa: PLC0415 -- likewise

        group, row_type = self._foreign
        entries = _packages.offered(group, name)
        if not entries:
            return None
        entry = _packages.the_only(entries, self._kind)
        package = _packages.package_of(entry)
        # Another thread may have loaded it in this moment.
        others = (each for each in self.every() if each.name != name)
        row: RowT = _foreign.load(entry, row_type, others)
        row, _ = self.added.setdefault(name, (row, package))
        warnings.warn(
            f"the {self._kind} {name} is code of the package {package}, not of pqsec:"
            " pqsec has not checked that it is secure",
            ForeignAlgorithmWarning,
            stacklevel=3,
        )
        return row

    def on_wire(self, wire_name: str) -> RowT:
        """The row with that `wire_name`; UnknownAlgorithmError if there is none."""
        for row in self.every():
            if row.wire_name == wire_name:
                return row
        raise UnknownAlgorithmError(f"no {self._kind} called {wire_name!r} on the wire")
