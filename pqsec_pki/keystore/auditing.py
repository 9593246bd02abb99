"""Checks that the ledger is intact and has a line for each issued file of the keystore."""

import hashlib
from collections.abc import Iterator
from pathlib import Path

from pqsec_pki._files import disk_errors, read
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import (
    FileError,
    MissingError,
    PqsecError,
    VerificationError,
    located,
)
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._chain import START, Entry, Line, problems
from pqsec_pki.keystore.anchoring import head_problems, ledger_tree, read_anchors
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.overlap import trusted_last


def audit(
    keystore: Keystore, head: str | None = None, anchors: Path | None = None
) -> tuple[int, str]:
    """The number of lines and the newest chain value, if no problem is found.

    The chain must be complete from the first line. Every certificate, signed document and list
    in the keystore must have a line; the list must be the newest. `head`, from an earlier
    audit, must be in the chain, and the tree must have all signed heads: the newest one, and those
    in the folder `anchors`. VerificationError lists all problems.

    Someone who may write the ledger can replace it by another complete one: to detect that,
    keep heads elsewhere (anchoring.py).
    """
    keystore = keystore.as_found
    if anchors and not anchors.is_dir():
        raise FileError(f"{anchors} is not a folder", hint="`pqsec log --anchor` makes one")
    lines, there = keystore.lines(), read_anchors(anchors) if anchors else {}
    if anchors and not there:  # an empty or unmounted folder proves nothing
        raise FileError(
            f"{anchors} has no heads to compare with",
            hint="name the folder that has them; `pqsec log --anchor` writes the newest one",
        )
    broken = [*problems(lines), *_head_problems(lines, head)]
    found = [*broken, *_unknown(keystore, lines)]
    if there or not broken:  # a broken chain says more than the newest head
        found += head_problems(keystore, ledger_tree(keystore), there)
    if found:
        raise VerificationError(
            *found, hint="compare it with a backup: somebody with write access changed it"
        )
    return len(lines), lines[-1].chain if lines else START


def _head_problems(lines: list[Line], head: str | None) -> Iterator[str]:
    if head is not None and head.lower() not in {START, *(line.chain for line in lines)}:
        yield "the head is not in the ledger: lines up to it were removed or rewritten"


def _unknown(keystore: Keystore, lines: list[Line]) -> Iterator[str]:
    """The files of the keystore that have no line in the ledger, or a wrong one."""
    entries = [line.entry for line in lines]
    known = {(each.kind, name, each.sha256) for each in entries for name in (each.name, None)}
    lists = [each.sha256 for each in entries if each.kind == "crl"]
    trusted = trusted_last(entries)
    with disk_errors(keystore.root):
        for path, kind, name in _issued(keystore):
            try:
                hashes = _hashes(path)
            except MissingError:
                continue
            except FileError:
                raise  # an unreadable file may still be right
            except PqsecError as error:
                yield str(error)
                continue
            if any((kind, name, each) not in known for each in hashes):
                yield f"{path} is not in the ledger"
            elif len(hashes) > 1 and not (trusted and _is_file(trusted, path)):
                yield f"{path} has {len(hashes)} certificates, but the ledger has one"
            elif kind == "crl" and hashes != [lists[-1]]:
                yield f"{path} is not the newest list in the ledger"


def _issued(keystore: Keystore) -> Iterator[tuple[Path, str, str | None]]:
    """The path of each file, and the kind and name of its line; None if any name is right."""
    public, enclaves = keystore.root / layout.PUBLIC, keystore.root / layout.ENCLAVES
    yield public / layout.IDENTITY_CA, "identity-ca", None
    yield public / layout.PERMISSIONS_CA, "permissions-ca", None
    yield public / layout.PERMISSIONS_ALT_CA, "permissions-ca", None
    yield public / layout.CA_LIST, "crl", None
    yield enclaves / layout.GOVERNANCE, "governance", None
    for name in keystore.names():
        folder = keystore.root / layout.enclave_folder(name)
        yield folder / layout.CERTIFICATE, "participant", name
        yield folder / layout.PERMISSIONS, "permissions", None


def _is_file(line: Entry, path: Path) -> bool:
    return hashlib.sha256(read(path)).hexdigest() == line.sha256


def _hashes(path: Path) -> list[str]:
    """SHA-256 as in the ledger: of each certificate's DER, or of any other file.

    All certificates of a file count: Fast DDS trusts every certificate in a CA's file.
    """
    data = read(path)
    if path.name.endswith(layout.CERTIFICATE):
        with located(path):
            return [each.fingerprint for each in Certificate.all_from_pem(data)]
    return [hashlib.sha256(data).hexdigest()]
