"""Finds the topics of a keystore that only one side may use."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from pqsec_pki.access import Alone, open_rights, rights_of, without_counterpart
from pqsec_pki.credentials import ENCLAVES
from pqsec_pki.lint.document import PermissionsFile

if TYPE_CHECKING:
    from pqsec_pki.lint.subjects import EnclaveFolder, Inventory


def one_sided(inventory: "Inventory") -> Iterator[tuple[PermissionsFile, Alone]]:
    """The rights without a counterpart in their keystore, each with its document.

    None of a keystore with a single participant, or with anything that cannot be read: that may
    be the other side.
    """
    keystores: dict[Path, list[EnclaveFolder]] = {}
    for enclave in inventory.enclaves:
        if ENCLAVES in enclave.folder.parts:
            keystores.setdefault(_enclaves_of(enclave.folder), []).append(enclave)
    for folder, enclaves in keystores.items():
        unread = (each.path for each in inventory.files if each.unreadable)
        if len(enclaves) > 1 and not any(folder in path.parents for path in unread):
            yield from _in_keystore(enclaves)


def _in_keystore(
    enclaves: Iterable["EnclaveFolder"],
) -> Iterator[tuple[PermissionsFile, Alone]]:
    documents: dict[str, PermissionsFile] = {}
    known, governed = [], set[Path]()
    for enclave in enclaves:
        permissions, governance = enclave.permissions(), enclave.governance()
        if not (permissions and permissions.permissions and governance and governance.governance):
            return
        documents[enclave.name] = permissions
        known.append(rights_of(enclave.name, permissions.grants))
        if governance.path not in governed:  # enclaves share it
            governed.add(governance.path)
            known.append(open_rights(governance.governance))
    rights = [right for each in known for right in each]
    asked = (right for right in rights if right.owner in documents)
    for found in dict.fromkeys(without_counterpart(asked, rights)):
        yield documents[found.right.owner], found


def _enclaves_of(folder: Path) -> Path:
    parts = folder.parts
    return Path(*parts[: len(parts) - parts[::-1].index(ENCLAVES)])
