"""What one set of credentials of a keystore lacks beside the first, or says otherwise.

Which sets a keystore has is in its settings and in its ledger, not in its folders. Signatures are
checked elsewhere: here, only what the sets have in common is compared.
"""

from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from pqsec_pki._files import exists, read
from pqsec_pki.errors import PqsecError, VerificationError
from pqsec_pki.keystore import layout
from pqsec_pki.keystore.compromised import all_hashes
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.overlap import Overlap
from pqsec_pki.keystore.participant import load_certificate
from pqsec_pki.problems import Code
from pqsec_pki.smime import document_in

Found = TypeVar("Found")
_OF_ALL = (
    f"{layout.PUBLIC}/{layout.IDENTITY_CA}",
    f"{layout.PUBLIC}/{layout.PERMISSIONS_CA}",
    f"{layout.ENCLAVES}/{layout.GOVERNANCE}",
)
_GOVERNANCE = f"{layout.ENCLAVES}/{layout.GOVERNANCE}"
_LIST = layout.LIST_TARGET[layout.LIST]


def faults_of_sets(
    keystore: Keystore, names: Collection[str] | None = None
) -> Iterator[tuple[Path, str]]:
    """The file, and what is wrong, for each thing that one set lacks or has otherwise.

    Of these participants [default: all], and of what all share. Nothing for a keystore with one
    set. What cannot be read is left to other checks.
    """
    first, *others = keystore.sets
    for each in others:
        there = sorted({*_names(first), *_names(each)}) if names is None else names
        yield from _missing(first, each, there)
        yield from _different(first, each, there)


def refuse_other_governance(keystore: Keystore) -> None:
    """VerificationError if the governance of another set says something else, or is missing.

    For questions that the documents of one set answer: they are true if all sets say the same.
    """
    for other in _others(keystore):
        _refuse_other(keystore, other, _GOVERNANCE)


def refuse_other_permissions(keystore: Keystore, name: str) -> None:
    """VerificationError if the participant's permissions in another set say something else, or are
    missing. A set in which it has no file says nothing: `pqsec check` finds that."""
    for other in _others(keystore):
        if other.has(name):
            place = f"{layout.enclave_folder(layout.enclave_name(name))}/{layout.PERMISSIONS}"
            _refuse_other(keystore, other, place)


def _others(keystore: Keystore) -> list[Keystore]:
    return [each for each in keystore.sets if each.set_name != keystore.set_name]


def _refuse_other(keystore: Keystore, other: Keystore, place: str) -> None:
    mine, theirs = keystore.folder / place, other.folder / place
    if not exists(theirs):
        words = f"{theirs} is missing"
    elif _document(mine) != _document(theirs):
        words = f"{theirs} says something else than {mine}"
    else:
        return
    raise VerificationError(
        f"{words}: the sets of credentials give different rights",
        code=Code.CONTENT_CHANGED,
        hint="`pqsec check` finds what differs; sign the document again: it is signed in all sets",
    )


def _missing(first: Keystore, other: Keystore, names: Iterable[str]) -> Iterator[tuple[Path, str]]:
    places = [*_OF_ALL]
    if not (_trusts_two(first) or _trusts_two(other)):
        places.append(_LIST)
    for name in names:
        folder = layout.enclave_folder(name)
        places += [f"{folder}/{each}" for each in (layout.CERTIFICATE, layout.PERMISSIONS)]
    for place in places:
        for one, beside in ((first, other), (other, first)):
            if not exists(one.folder / place) and exists(beside.folder / place):
                yield one.folder / place, f"is missing; {beside.folder} has it"


def _trusts_two(keystore: Keystore) -> bool:
    """Whether the set trusts two identity CAs: it has no revocation list, which covers one."""
    with suppress(PqsecError):
        return Overlap.of(keystore) is not None
    return False


def _names(keystore: Keystore) -> list[str]:
    """The participants; none without the folder of enclaves, which is a fault of its own."""
    return keystore.names() if exists(keystore.folder / layout.ENCLAVES) else []


def _different(
    first: Keystore, other: Keystore, names: Iterable[str]
) -> Iterator[tuple[Path, str]]:
    """Documents with other content, certificates with another subject, and keys of two sets."""
    yield from _unlike(first, other, _GOVERNANCE, _document, "says something else than")
    for name in names:
        folder = layout.enclave_folder(name)
        signed, certificate = f"{folder}/{layout.PERMISSIONS}", f"{folder}/{layout.CERTIFICATE}"
        yield from _unlike(first, other, signed, _document, "says something else than")
        yield from _unlike(first, other, certificate, _subject, "has another subject than")
        yield from _alike(first, other, certificate)


def _unlike(
    first: Keystore, other: Keystore, place: str, content: Callable[[Path], Found], words: str
) -> Iterator[tuple[Path, str]]:
    mine, theirs = first.folder / place, other.folder / place
    with suppress(PqsecError):
        if content(mine) != content(theirs):
            yield theirs, f"{words} {mine}"


def _alike(first: Keystore, other: Keystore, place: str) -> Iterator[tuple[Path, str]]:
    mine, theirs = first.folder / place, other.folder / place
    with suppress(PqsecError):
        if not _keys(mine).isdisjoint(_keys(theirs)):
            yield theirs, f"has the key of {mine}"


def _keys(path: Path) -> set[str]:
    """What two sets must not have in common, also where an algorithm is unknown."""
    certificate = load_certificate(path)
    found = {certificate.spki.hex()}
    with suppress(PqsecError):
        found.update(all_hashes(certificate.public_key, certificate.alternative_key))
    return found


def _document(path: Path) -> bytes:
    return document_in(read(path)).replace(b"\r\n", b"\n")


def _subject(path: Path) -> bytes:
    return load_certificate(path).subject_der
