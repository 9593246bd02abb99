"""Whose private key is in a file: several rules ask, and to open one takes a millisecond."""

from dataclasses import dataclass
from weakref import WeakKeyDictionary

from pqsec_pki.algorithms import is_encrypted, load_private_key
from pqsec_pki.errors import PqsecError, UnknownAlgorithmError
from pqsec_pki.lint.file import File


@dataclass(frozen=True, slots=True)
class Held:
    """What can be told of a private key without its passphrase. Nothing of it is kept."""

    spki: bytes | None = None
    """DER SubjectPublicKeyInfo of its public half; None if it cannot be opened here."""
    reason: str | None = None
    """Why it cannot be read, where that is not for want of a passphrase."""


_HELD: WeakKeyDictionary[File, Held] = WeakKeyDictionary()
"""Forgotten with the file."""


def held(file: File) -> Held:
    """The private key in `file`."""
    found = _HELD.get(file)
    if found is None:
        found = _HELD[file] = _opened(file)
    return found


def _opened(file: File) -> Held:
    if file.unreadable or is_encrypted(file.data):
        return Held()
    try:
        return Held(load_private_key(file.data).public_key.spki)
    except UnknownAlgorithmError:
        return Held()  # stacks take some kinds that pqsec does not
    except PqsecError as error:
        return Held(reason=str(error))
