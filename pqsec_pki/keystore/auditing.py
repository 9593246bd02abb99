"""Does the ledger still say what was written, and does it know what lies here?"""

import hashlib
from collections.abc import Iterator
from pathlib import Path

from pqsec_pki._files import disk_errors, exists, read
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import FileError, PqsecError, VerificationError, located
from pqsec_pki.keystore import _layout
from pqsec_pki.keystore._chain import START, Entry, Line, problems
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.overlap import trusted_last


def audit(keystore: Keystore, head: str | None = None) -> tuple[int, str]:
    """How many lines there are and the newest one's chain value, if nothing shows.

    The chain must hold from the first line on, every certificate, signed document and
    list in the keystore must have its line, the list the newest one, and `head`, as an
    earlier audit gave it, be in the chain. VerificationError lists everything that is wrong.

    Whoever may write the ledger can make a whole new one that holds: against that, keep
    the head elsewhere.
    """
    lines = keystore.lines()
    found = [*problems(lines), *_head_problems(lines, head), *_unknown(keystore, lines)]
    if found:
        raise VerificationError(
            *found, hint="compare it with a backup: whoever did it can write in the keystore"
        )
    return len(lines), lines[-1].chain if lines else START


def _head_problems(lines: list[Line], head: str | None) -> Iterator[str]:
    if head is not None and head.lower() not in {START, *(line.chain for line in lines)}:
        yield "the head is not in the ledger: lines up to it were removed or written anew"


def _unknown(keystore: Keystore, lines: list[Line]) -> Iterator[str]:
    """What lies in the keystore and was never entered, or whose line is missing."""
    entries = [line.entry for line in lines]
    known = {(each.kind, name, each.sha256) for each in entries for name in (each.name, None)}
    lists = [each.sha256 for each in entries if each.kind == "crl"]
    trusted = trusted_last(entries)
    with disk_errors(keystore.root):
        for path, kind, name in _issued(keystore):
            if not exists(path):
                continue
            try:
                hashes = _hashes(path)
            except FileError:
                raise  # what cannot be read is not known to be wrong
            except PqsecError as error:
                yield str(error)
                continue
            if any((kind, name, each) not in known for each in hashes):
                yield f"{path} is in no line of the ledger"
            elif len(hashes) > 1 and not (trusted and _is_file(trusted, path)):
                yield f"{path} holds {len(hashes)} certificates, and the ledger knows of one"
            elif kind == "crl" and hashes != [lists[-1]]:
                yield f"{path} is not the newest list in the ledger"


def _issued(keystore: Keystore) -> Iterator[tuple[Path, str, str | None]]:
    """Where it lies, and the kind and name of its line; no name where the file tells it."""
    public, enclaves = keystore.root / _layout.PUBLIC, keystore.root / _layout.ENCLAVES
    yield public / _layout.IDENTITY_CA, "identity-ca", None
    yield public / _layout.PERMISSIONS_CA, "permissions-ca", None
    yield public / _layout.PERMISSIONS_ALT_CA, "permissions-ca", None
    yield public / _layout.CA_LIST, "crl", None
    yield enclaves / _layout.GOVERNANCE, "governance", None
    for name in keystore.names():
        folder = keystore.root / _layout.enclave_folder(name)
        yield folder / _layout.CERTIFICATE, "participant", name
        yield folder / _layout.PERMISSIONS, "permissions", None


def _is_file(line: Entry, path: Path) -> bool:
    return hashlib.sha256(read(path)).hexdigest() == line.sha256


def _hashes(path: Path) -> list[str]:
    """As the ledger has them: of a certificate's DER, of any other file.

    Of all certificates in it: Fast DDS trusts whatever stands in a CA's file.
    """
    if path.name.endswith(_layout.CERTIFICATE):
        with located(path):
            return [each.fingerprint for each in Certificate.all_from_pem(read(path))]
    return [hashlib.sha256(read(path)).hexdigest()]
