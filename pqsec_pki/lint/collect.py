"""From paths to an inventory: finds every file, reads it once and determines what it is."""

import re
from collections.abc import Iterable, Iterator, Mapping
from datetime import datetime
from pathlib import Path

from pqsec_pki.credentials import ENCLAVES, TrustAnchors
from pqsec_pki.errors import FileError, UsageError
from pqsec_pki.lint._anchors import SharedAnchors
from pqsec_pki.lint._search import Search
from pqsec_pki.lint.document import Document, Documents, same_lines
from pqsec_pki.lint.file import File
from pqsec_pki.lint.profile import profile_file_of
from pqsec_pki.lint.subjects import CertificateFile, Compare, EnclaveFolder, Inventory
from pqsec_pki.stacks import Stack

_DOCUMENT = re.compile(r".*\.(p7s|smime)|(governance|permissions)\.xml", re.IGNORECASE)


def take_inventory(
    paths: Iterable[Path],
    *,
    now: datetime,
    anchors: TrustAnchors | None = None,
    proofs: bool = False,
    compare: Compare | None = None,
) -> Inventory:
    """The inventory of these files and folders; links to files are followed.

    Enclaves with the CAs in `anchors` use this value, with what it verified before. With `proofs`,
    each must have one that the ledger has its documents; UsageError for a keystore, which has none.
    `compare` compares enclaves with what was seen there before.

    FileError if a path does not exist or cannot be read, or if there is nothing or too much to
    check.
    """
    search = Search(now, proofs)
    named = list(paths)
    for path in named:
        search.add(path)
    if proofs and (search.keystore or search.interrupted_change):
        raise UsageError(
            "--proofs is for a robot's folder: a keystore has no proofs, only bundles have them",
            hint="`pqsec log --verify` verifies the keystore's ledger",
        )
    files = tuple(search.files.values())
    if not files and not search.enclaves:
        where = ", ".join(map(str, named))
        raise FileError(
            f"{where}: nothing to check",
            hint="name a keystore, or files: .pem, .p7s and .xml",
        )
    documents_of = Documents()
    all_xml = [documents_of.of(file) for file in files if _is_document(file, search)]
    profiles = {each.path: found for each in all_xml if (found := profile_file_of(each))}
    documents = tuple(
        each for each in all_xml if not (each.path in profiles or _is_configuration(each))
    )
    certificates = tuple(CertificateFile(file) for file in files if "CERTIFICATE" in file.labels)
    subjects: dict[File, Document | CertificateFile] = {each.file: each for each in certificates}
    subjects |= {each.file: each for each in documents}
    by_path = {each.path: each for each in documents}
    return Inventory(
        path=named[0],
        files=files,
        folders=search.folders,
        documents=tuple(each for each in documents if not _is_copy(each, by_path)),
        profiles=tuple(profiles.values()),
        certificates=certificates,
        enclaves=tuple(_enclaves(search, subjects, SharedAnchors(anchors), compare)),
        keystore=search.keystore,
        interrupted_change=search.interrupted_change,
        missing_parts=search.missing_parts,
        now=now,
    )


def _is_document(file: File, search: Search) -> bool:
    if file.unreadable:
        return False
    if file.looks_like_document or _DOCUMENT.fullmatch(file.path.name):
        return True
    return not file.labels and file.path in search.named  # the user named it as a document


def _is_configuration(document: Document) -> bool:
    """Whether it is a configuration of Cyclone DDS, as `export` writes: its root has that name.

    A file with the name of a document must be one.
    """
    root, name = document.root, document.path.name
    is_of_stack = root is not None and root.tag.rpartition("}")[2].lower() == Stack.CYCLONEDDS
    return is_of_stack and not _DOCUMENT.fullmatch(name)


def _is_copy(document: Document, by_path: Mapping[Path, Document]) -> bool:
    """Whether it is the signed form of an XML file next to it, with the same text.

    Findings are then reported for the XML file, where they can be fixed.
    """
    if not document.file.is_signed or document.xml is None:
        return False
    beside = by_path.get(document.path.with_suffix(".xml"))
    return beside is not None and same_lines(document.xml, beside.xml or b"")


def _enclaves(
    search: Search,
    subjects: Mapping[File, Document | CertificateFile],
    anchors: SharedAnchors,
    compare: Compare | None,
) -> Iterator[EnclaveFolder]:
    for folder, names in search.enclaves.items():
        files = {name: search.files[key] for name, key in names.items() if key in search.files}
        broken = tuple(name for name, key in names.items() if key is None)
        yield EnclaveFolder(
            folder=folder,
            name=_name(folder),
            files=files,
            broken_links=broken,
            now=search.now,
            proof_demanded=search.proofs,
            compare=compare,
            subjects={name: subjects[each] for name, each in files.items() if each in subjects},
            shared_anchors=anchors,
        )


def _name(folder: Path) -> str:
    parts = folder.parts
    if ENCLAVES in parts:
        place = len(parts) - 1 - parts[::-1].index(ENCLAVES)
        return "/" + "/".join(parts[place + 1 :])
    return "/" + folder.name
