"""The files for all participants that another machine wrote: a change of this one begins with them.

So nothing is signed, compared or decided here by an older governance or list. They come from the
ledger's database, by the SHA-256 in their line, and the CAs must have signed them.
"""

from pathlib import Path

from pqsec_pki._files import exists
from pqsec_pki.credentials import only_list
from pqsec_pki.errors import KeystoreError, PqsecError
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._ledger import Ledger
from pqsec_pki.keystore._settings import set_names
from pqsec_pki.keystore._shared_files import LedgerFile, shared_elsewhere
from pqsec_pki.keystore._transaction import Transaction
from pqsec_pki.keystore.participant import load_first_certificate
from pqsec_pki.smime import verify

WAYS_OUT = {
    "crl": "restore it from a backup, or issue the next one: `pqsec ca crl`",
    "governance": "restore it from a backup, or sign the one that is to apply: `pqsec apply`, or"
    " `pqsec sign-governance` with its file",
}
"""By the kind of a file's line."""
XML = {layout.PERMISSIONS: layout.PERMISSIONS_XML, layout.GOVERNANCE: layout.GOVERNANCE_XML}
"""The file beside a signed document, with the document alone."""


def newer_elsewhere(transaction: Transaction) -> dict[LedgerFile, bytes]:
    """The governance and the list of each set, if another machine wrote newer ones.

    Those of all sets or of none: not if the database does not keep one of them, and then
    `current_files` refuses to use the older file. KeystoreError as below.
    """
    if transaction.database is None:
        return {}
    root, wanted = Path(transaction.root.path), list[LedgerFile]()
    with Ledger(transaction.database) as ledger:
        for name in set_names(root):
            wanted += shared_elsewhere(root / layout.in_set(name, ""), ledger.of(name))
    kept = transaction.kept(wanted)
    lost = {each.kind for each in wanted if each not in kept}
    return {each: data for each, data in kept.items() if each.kind not in lost}


def stage(transaction: Transaction, files: dict[LedgerFile, bytes]) -> None:
    """Stage these files, and what belongs to them; KeystoreError if a CA here did not sign one."""
    for each, data in files.items():
        part = transaction.of(each.set_name)
        folder = Path(transaction.root.path) / layout.in_set(each.set_name, "")
        staged = part.folder(each.folder, private=False)
        staged.public(each.file, data)
        if each.file == layout.CA_LIST:
            _refuse_foreign_list(folder, data)
            for place, target in layout.missing_list_links(folder):
                part.link(place, target)
        else:
            staged.public(XML[each.file], signed_document(folder, each.folder, data))


def refuse_older_files(transaction: Transaction) -> None:
    """KeystoreError for an older governance or list, to which new enclaves would link.

    Not if the change puts another one in its place, or signs nothing for participants.
    """
    if not any(each.kind in {"participant", "permissions"} for each in transaction.entries):
        return
    for name in set_names(Path(transaction.root.path)):
        with transaction.opened_ledger(name) as ledger:
            _refuse_older_files(transaction, ledger)


def _refuse_older_files(transaction: Transaction, ledger: Ledger) -> None:
    """As above, of the set that the ledger answers about."""
    folder = Path(transaction.root.path) / layout.in_set(ledger.set_name, "")
    for each in shared_elsewhere(folder, ledger):
        path = folder / each.folder / each.file
        place = layout.in_set(ledger.set_name, each.folder)
        if exists(path) and not transaction.stages(place, each.file):
            line = ledger.line_of((each.kind,), each.sha256)
            raise KeystoreError(
                f"{path} is an older one: line {line} of the ledger has the newest",
                hint=WAYS_OUT[each.kind],
            )


def signed_document(set_folder: Path, folder: str, signed: bytes) -> bytes:
    """The document in a signed file of another machine; KeystoreError if the CA did not sign it.

    The CA is that of the set in `set_folder`.
    """
    public = set_folder / layout.PUBLIC
    second = public / layout.PERMISSIONS_ALT_CA
    counter = load_first_certificate(second) if exists(second) else None
    ca = load_first_certificate(public / layout.PERMISSIONS_CA)
    try:
        found = verify(signed, ca, alternative_ca=counter, pinned=bool(counter)).document
    except PqsecError as error:
        raise _refused(folder, error) from None
    return found.replace(b"\r\n", b"\n")  # S/MIME has other ends of lines than our files


def _refuse_foreign_list(set_folder: Path, data: bytes) -> None:
    try:
        ca = load_first_certificate(set_folder / layout.PUBLIC / layout.IDENTITY_CA)
        only_list(data, layout.CA_LIST).verify(ca)
    except PqsecError as error:
        raise _refused(layout.PUBLIC, error) from None


def _refused(folder: str, error: PqsecError) -> KeystoreError:
    return KeystoreError(f"{folder}: what another machine signed is refused: {error}")
