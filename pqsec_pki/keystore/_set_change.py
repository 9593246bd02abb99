"""The part of a staged change that is about one set of credentials."""

from typing import TYPE_CHECKING

from pqsec_pki._dataclass import dataclass
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._chain import Entry

if TYPE_CHECKING:
    from pqsec_pki.keystore._transaction import StagedFolder, Transaction


@dataclass(frozen=True, slots=True)
class SetChange:
    """Stages what belongs to one set: its places are in the set's folder, its lines name the set.

    See `Transaction` for the rest of its methods and for their errors.
    """

    transaction: "Transaction"
    set_name: str

    @property
    def number(self) -> int:
        """The sequence number of what the change signs, the same in all sets."""
        return self.transaction.number

    def folder(self, target: str, *, private: bool) -> "StagedFolder":
        """Stage an empty folder that will become, or be merged into, `target`."""
        return self.transaction.folder(self._place(target), private=private)

    def link(self, place: str, target: str) -> None:
        """Record a symbolic link at `place`; its target is relative to its folder."""
        self.transaction.link(self._place(place), target)

    def remove(self, place: str) -> None:
        """Record that the file or link at `place`, if there is one, will be removed."""
        self.transaction.remove(self._place(place))

    def remove_empty(self, folder: str) -> None:
        """Record that the folder will be removed, unless something is still in it."""
        self.transaction.remove_empty(self._place(folder).rstrip("/"))

    def shred(self, place: str) -> None:
        """Overwrite the old content of the file at `place` after the change has replaced it."""
        self.transaction.shred(self._place(place))

    def record(self, *entries: Entry) -> None:
        """Add entries for the ledger; those of kinds that are of a set get its name."""
        self.transaction.record(*(each.in_set(self.set_name) for each in entries))

    def _place(self, place: str) -> str:
        return layout.in_set(self.set_name, place)
