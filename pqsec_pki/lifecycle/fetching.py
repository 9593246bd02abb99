"""Gets the files of participants that another machine with the same ledger wrote.

Its database keeps them. The governance and the list are there already: each change gets them first.
"""

from collections.abc import Iterable, Mapping
from itertools import groupby
from operator import attrgetter

from pqsec_pki._dataclass import dataclass
from pqsec_pki.keystore import (
    Authorities,
    Keystore,
    SetChange,
    change,
    files_elsewhere,
    layout,
    signed_document,
)
from pqsec_pki.lifecycle.issuing import clear_keys, shared_files


def fetch_files(keystore: Keystore, authorities: Authorities, names: Iterable[str]) -> None:
    """Get the files of these participants, and what each change gets.

    A participant comes whole, in all sets, or not at all: the database has not what an older pqsec
    issued.
    KeystoreError for a document that the CA here did not sign.
    """
    with change(keystore.root, authorities) as transaction:
        with keystore.open_ledger() as ledger:
            wanted = [each for each in files_elsewhere(keystore, ledger, names) if each.name]
        kept = transaction.kept(wanted)
        lost = {each.name for each in wanted if each not in kept}
        for view, cas in zip(keystore.sets, authorities.sets, strict=True):
            fetching = _Fetching(view, cas, transaction.of(view.set_name))
            own = [each for each in wanted if each.set_name == view.set_name]
            for name, group in groupby(own, attrgetter("name")):
                if name not in lost:
                    fetching.stage(name, {each.file: kept[each] for each in group})


@dataclass(frozen=True, slots=True)
class _Fetching:
    """Gets files of one set."""

    keystore: Keystore
    authorities: Authorities
    part: SetChange

    def stage(self, name: str, files: Mapping[str, bytes]) -> None:
        """Stage these files of a participant, and what belongs to them."""
        folder = layout.enclave_folder(name)
        staged = self.part.folder(folder, private=True)
        for file, data in files.items():
            staged.public(file, data)
            if file == layout.PERMISSIONS:
                document = signed_document(self.keystore.folder, folder, data)
                staged.public(layout.PERMISSIONS_XML, document)
        if layout.CERTIFICATE in files:
            shared = shared_files(self.keystore, self.authorities)
            for link, target in layout.shared_links(name, shared).items():
                staged.link(link, target)
            clear_keys(self.part, folder)
