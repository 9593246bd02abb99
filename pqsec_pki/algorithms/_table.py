"""A table of rows that are found by name."""

from collections.abc import Iterator, Sequence
from enum import StrEnum
from typing import Generic, Protocol, TypeVar

from pqsec_pki.errors import UnknownAlgorithmError


class Family(StrEnum):
    """What an algorithm's strength rests on."""

    CLASSICAL = "classical"
    PQ = "pq"
    HYBRID = "hybrid"


class Row(Protocol):
    """What a table needs of its rows."""

    @property
    def name(self) -> str: ...
    @property
    def aliases(self) -> tuple[str, ...]: ...
    @property
    def wire_name(self) -> str: ...


RowT = TypeVar("RowT", bound=Row)


class Table(Generic[RowT]):
    """Rows in the order written; each name and alias belongs to one of them."""

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
        """The row a user means by `name`, in any case, with or without `id-`.

        UnknownAlgorithmError, with the names there are, if it is none.
        """
        try:
            return self._by_name[name.lower().removeprefix("id-")]
        except KeyError:
            known = ", ".join(row.name for row in self)
            raise UnknownAlgorithmError(
                f"no {self._kind} named {name!r}", hint=f"known: {known}"
            ) from None

    def on_wire(self, wire_name: str) -> RowT:
        """The row a peer means by `wire_name`; UnknownAlgorithmError if it is none."""
        for row in self:
            if row.wire_name == wire_name:
                return row
        raise UnknownAlgorithmError(f"no {self._kind} called {wire_name!r} on the wire")
