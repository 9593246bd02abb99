"""The private key in a file, cached: several rules need it, and loading takes a millisecond."""

from dataclasses import dataclass
from weakref import WeakKeyDictionary

from pqsec_pki.algorithms import is_encrypted, load_private_key
from pqsec_pki.errors import PqsecError, UnknownAlgorithmError
from pqsec_pki.lint.file import File


@dataclass(frozen=True, slots=True)
class Held:
    """What is known of a private key without its passphrase. The key itself is not kept."""

    spki: bytes | None = None
    """DER SubjectPublicKeyInfo of its public key; None if it cannot be loaded here."""
    reason: str | None = None
    """Why it cannot be read, if the reason is not a missing passphrase."""


_HELD: WeakKeyDictionary[File, Held] = WeakKeyDictionary()
"""An entry is removed together with its file."""


def held(file: File) -> Held:
    """The private key in `file`."""
    found = _HELD.get(file)
    if found is None:
        found = _HELD[file] = _load(file)
    return found


def _load(file: File) -> Held:
    if file.unreadable or is_encrypted(file.data):
        return Held()
    try:
        return Held(load_private_key(file.data).public_key.spki)
    except UnknownAlgorithmError:
        return Held()  # stacks accept some kinds that pqsec does not
    except PqsecError as error:
        return Held(reason=str(error))
