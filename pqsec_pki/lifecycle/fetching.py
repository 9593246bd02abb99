"""Gets the files that another machine with the same ledger wrote, as its database keeps them."""

from collections.abc import Iterable, Mapping
from itertools import groupby
from operator import attrgetter

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import KeystoreError, PqsecError
from pqsec_pki.keystore import (
    Authorities,
    Keystore,
    Transaction,
    change,
    files_elsewhere,
    layout,
)
from pqsec_pki.lifecycle.issuing import clear_keys, shared_files
from pqsec_pki.lifecycle.revoking import missing_list_links
from pqsec_pki.smime import verify

_DOCUMENTS = {
    layout.PERMISSIONS: layout.PERMISSIONS_XML,
    layout.GOVERNANCE: layout.GOVERNANCE_XML,
}
"""The files beside signed ones, with the document alone."""


def fetch_files(keystore: Keystore, authorities: Authorities, names: Iterable[str]) -> None:
    """Get the governance, the revocation list, and the files of these participants.

    A participant comes whole or not at all: the database has not what an older pqsec issued.
    KeystoreError for a document that the CA here did not sign.
    """
    with change(keystore.root, authorities) as transaction:
        with keystore.open_ledger() as ledger:
            wanted = files_elsewhere(keystore, ledger, names)
        kept = transaction.kept(wanted)
        fetching = _Fetching(keystore, authorities, transaction)
        for folder, group in groupby(wanted, attrgetter("folder")):
            files = list(group)
            if all(each in kept for each in files):
                fetching.stage(folder, files[0].name, {each.file: kept[each] for each in files})


@dataclass(frozen=True, slots=True)
class _Fetching:
    keystore: Keystore
    authorities: Authorities
    transaction: Transaction

    def stage(self, folder: str, name: str, files: Mapping[str, bytes]) -> None:
        """Stage these files, and what belongs to them."""
        staged = self.transaction.folder(folder, private=bool(name))
        for file, data in files.items():
            staged.public(file, data)
            if file in _DOCUMENTS:
                staged.public(_DOCUMENTS[file], self._document(folder, data))
        if layout.CERTIFICATE in files:
            shared = shared_files(self.keystore, self.authorities)
            for link, target in layout.shared_links(name, shared).items():
                staged.link(link, target)
            clear_keys(self.transaction, folder)
        if layout.CA_LIST in files:
            for place, target in missing_list_links(self.keystore):
                self.transaction.link(place, target)

    def _document(self, folder: str, signed: bytes) -> bytes:
        second = self.keystore.countersigner
        try:
            found = verify(
                signed, self.keystore.permissions_ca, alternative_ca=second, pinned=bool(second)
            )
        except PqsecError as error:
            words = f"{folder}: what another machine signed is refused: {error}"
            raise KeystoreError(words) from None
        return found.document
