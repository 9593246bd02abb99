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
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import exists, read
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._folder import Folder
from pqsec_pki.keystore._ledger import Ledger
from pqsec_pki.keystore._replaced_cas import identity_cas

if TYPE_CHECKING:
    from pqsec_pki.keystore.keystore import Keystore

_KEPT = (layout.CERTIFICATE, layout.PERMISSIONS, layout.GOVERNANCE, layout.CA_LIST)


@dataclass(frozen=True, slots=True)
class LedgerFile:
    """A file of the keystore, as a line of the ledger has it."""

    set_name: str
    """The set whose file it is."""
    folder: str
    """Relative to the folder of the set."""
    file: str
    sha256: str
    kind: str
    """The kind of the line."""
    name: str = ""
    """The participant's name; empty for shared files."""
    stays: bool = False
    """Whether it is used only where its keys are: pqsec made them on one machine."""

    @property
    def is_document(self) -> bool:
        """Whether it is a signed document."""
        return self.file in {layout.GOVERNANCE, layout.PERMISSIONS}

    def is_newer(self, set_folder: Path, numbers: Callable[[], Mapping[str, int]]) -> bool:
        """Whether the set in `set_folder` lacks it, or has one of an earlier line.

        `numbers` are those of the lines of that kind, by SHA-256. A file without a line stays.
        """
        path = set_folder / self.folder / self.file
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
    """Shared files, and files of these participants, that another machine wrote since, in all sets.

    Not of participants whose keys pqsec made: their files stay where their keys are.
    """
    if keystore.ledger_address is None:
        return []
    asked, found = list(names), list[LedgerFile]()
    for view in keystore.sets:
        own = ledger.of(view.set_name)
        theirs = [each for name in asked for each in newest_of(own, name) if not each.stays]
        found += _newer(view.folder, own, [*newest_of_all(own), *theirs])
    return found


def shared_elsewhere(set_folder: Path, ledger: Ledger) -> list[LedgerFile]:
    """The files for all participants of a set that another machine wrote since.

    `ledger` answers about that set.
    """
    return _newer(set_folder, ledger, newest_of_all(ledger))


def _newer(set_folder: Path, ledger: Ledger, newest: Iterable[LedgerFile]) -> list[LedgerFile]:
    return [
        each for each in newest if each.is_newer(set_folder, partial(ledger.numbers, each.kind))
    ]


def newest_of_all(ledger: Ledger) -> list[LedgerFile]:
    """The governance and, if the identity CA has one, its list."""
    return [each for each in (newest_governance(ledger), newest_list(ledger)) if each]


def newest_governance(ledger: Ledger) -> LedgerFile | None:
    """The governance that all participants share; None if the ledger has none."""
    named = ledger.of_name("governance", "") or ledger.of_kind("governance")
    by_hand = ledger.placed("governance").get(layout.ENCLAVES)
    return _newest_document(ledger, layout.ENCLAVES, layout.GOVERNANCE, [*named[-1:], by_hand])


def newest_list(ledger: Ledger) -> LedgerFile | None:
    """The list of the issuing identity CA; None without one.

    The begin of an overlap ends a list: no stack can use one beside two identity CAs.
    """
    issuing, begun = identity_cas(ledger)[:1], max(ledger.numbers("trust").values(), default=0)
    for each in [each for each in ledger.of_kind("crl") if each.issuer in issuing][-1:]:
        if ledger.line_of(("crl",), each.sha256) > begun:
            return LedgerFile(
                ledger.set_name, layout.PUBLIC, layout.CA_LIST, each.sha256, each.kind
            )
    return None


def newest_of(
    ledger: Ledger, name: str, placed: Mapping[str, Entry] | None = None
) -> Iterator[LedgerFile]:
    """A participant's certificate and permissions; nothing for a name without a certificate.

    `placed` are the permissions of all that were signed by hand, if they were asked for before.
    They stay where the keys are, unless these came in a request.
    """
    lines = ledger.of_name("participant", name)
    placed = ledger.placed("permissions") if placed is None else placed
    keys = lines[-1].details.get("keys") if lines else None
    asked = any("request" in each.details for each in lines if each.details.get("keys") == keys)
    folder = layout.enclave_folder(name)
    for each in lines[-1:]:
        yield LedgerFile(
            ledger.set_name,
            folder,
            layout.CERTIFICATE,
            each.sha256,
            "participant",
            name,
            stays=not asked,
        )
    named, by_hand = ledger.of_name("permissions", name), placed.get(folder)
    signed = [*named[-1:], by_hand] if lines else []
    found = _newest_document(ledger, folder, layout.PERMISSIONS, signed, name, stays=not asked)
    if found:
        yield found


def _newest_document(  # noqa: PLR0913, PLR0917 -- what a file of the ledger has
    ledger: Ledger,
    folder: str,
    file: str,
    lines: Iterable[Entry | None],
    name: str = "",
    stays: bool = False,  # noqa: FBT001, FBT002 -- likewise
) -> LedgerFile | None:
    there = [each for each in lines if each]
    numbered = [(ledger.line_of((each.kind,), each.sha256), each) for each in there]
    if not numbered:
        return None
    _, newest = max(numbered, key=itemgetter(0))
    return LedgerFile(ledger.set_name, folder, file, newest.sha256, newest.kind, name, stays)


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
