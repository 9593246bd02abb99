"""Files that machines with one ledger share: its database keeps those that its lines are about.

They are found by the SHA-256 in their line, so what is not the file of that line is not used. Keys
have no line, and stay on their machine.
"""

import base64
import binascii
import hashlib
import stat
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import exists, read
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._folder import Folder
from pqsec_pki.keystore._ledger import Ledger

if TYPE_CHECKING:
    from pqsec_pki.keystore.keystore import Keystore

_KEPT = (layout.CERTIFICATE, layout.PERMISSIONS, layout.GOVERNANCE, layout.CA_LIST)


@dataclass(frozen=True, slots=True)
class LedgerFile:
    """A file of the keystore, as a line of the ledger has it."""

    folder: str
    """Relative to the keystore."""
    file: str
    sha256: str
    kind: str
    """The kind of the line."""
    name: str = ""
    """The participant's name; empty for shared files."""

    def is_newer(self, root: Path, numbers: Callable[[], Mapping[str, int]]) -> bool:
        """Whether the keystore at `root` lacks it, or has one of an earlier line.

        `numbers` are those of the lines of that kind, by SHA-256. A file without a line stays.
        """
        path = root / self.folder / self.file
        if not exists(path):
            return True
        here = digest_of(self.file, read(path)) or ""
        if here == self.sha256:
            return False
        lines = numbers()
        return here in lines and lines[here] < lines[self.sha256]

    def in_(self, contents: Mapping[str, bytes]) -> bytes | None:
        """Its content; None if it is not there, or is another file."""
        data = contents.get(self.sha256)
        return data if data and digest_of(self.file, data) == self.sha256 else None


def files_elsewhere(keystore: "Keystore", ledger: Ledger, names: Iterable[str]) -> list[LedgerFile]:
    """Shared files, and files of these participants, that another machine wrote since.

    Not of participants whose keys pqsec made: their files stay where their keys are.
    """
    if keystore.ledger_address is None:
        return []
    newest = [*_of_all(keystore, ledger), *(each for name in names for each in _of(ledger, name))]
    return [
        each for each in newest if each.is_newer(keystore.root, partial(ledger.numbers, each.kind))
    ]


def _of_all(keystore: "Keystore", ledger: Ledger) -> Iterator[LedgerFile]:
    for each in ledger.of_name("governance", "")[-1:]:
        yield LedgerFile(layout.ENCLAVES, layout.GOVERNANCE, each.sha256, each.kind)
    authority = keystore.identity_ca.fingerprint
    for each in [each for each in ledger.of_kind("crl") if each.issuer == authority][-1:]:
        yield LedgerFile(layout.PUBLIC, layout.CA_LIST, each.sha256, each.kind)


def _of(ledger: Ledger, name: str) -> Iterator[LedgerFile]:
    """Its certificate and permissions, if its keys came in a request."""
    lines = ledger.of_name("participant", name)
    keys = lines[-1].details.get("keys") if lines else None
    if not any("request" in each.details for each in lines if each.details.get("keys") == keys):
        return
    folder, signed = layout.enclave_folder(name), ledger.of_name("permissions", name)[-1:]
    yield LedgerFile(folder, layout.CERTIFICATE, lines[-1].sha256, "participant", name)
    for each in signed:
        yield LedgerFile(folder, layout.PERMISSIONS, each.sha256, each.kind, name)


def digest_of(file: str, data: bytes) -> str | None:
    """The SHA-256 by which the ledger knows the content of a file with that name."""
    if file == layout.CERTIFICATE:
        return pem_fingerprint(data)
    return hashlib.sha256(data).hexdigest()


@lru_cache(maxsize=16)  # those of the CAs are in every bundle
def pem_fingerprint(data: bytes) -> str | None:
    """SHA-256 of the DER of the first certificate in PEM `data`; None if it is not base64."""
    _, _, block = data.partition(b"-----BEGIN")
    body = block.partition(b"\n")[2].partition(b"-----END")[0]
    try:
        return hashlib.sha256(base64.b64decode(body)).hexdigest()
    except binascii.Error:
        return None


def recorded_files(
    made: Folder, folders: Collection[str], entries: Iterable[Entry]
) -> Iterator[tuple[str, bytes]]:
    """The files that are staged in these folders and that the lines are about."""
    wanted = {each.sha256 for each in entries}
    for folder in folders:
        with made.below(folder) as staged:
            own = [each for each in _KEPT if staged.kind(each) == stat.S_IFREG]
        for file in own:
            data = read(Path(f"{made.path}/{folder}/{file}"))
            if (sha256 := digest_of(file, data)) and sha256 in wanted:
                yield sha256, data
