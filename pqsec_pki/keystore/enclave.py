"""An enclave's files, as bytes: what a participant's process reads, to be handed on whole."""

from pathlib import Path

from pqsec_pki._files import disk_errors, read
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import _layout
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.participant import refuse_unknown

CERTIFICATE, KEY, ALT_KEY = _layout.CERTIFICATE, _layout.KEY, _layout.ALT_KEY
PERMISSIONS, GOVERNANCE = _layout.PERMISSIONS, _layout.GOVERNANCE
IDENTITY_CA, PERMISSIONS_CA = _layout.IDENTITY_CA, _layout.PERMISSIONS_CA
PERMISSIONS_ALT_CA, LIST = _layout.PERMISSIONS_ALT_CA, _layout.LIST

KEYS = _layout.KEYS
"""The private ones; 0600 wherever they lie."""
NEEDED = (CERTIFICATE, PERMISSIONS, GOVERNANCE, IDENTITY_CA, PERMISSIONS_CA)
FILES = (*NEEDED, PERMISSIONS_ALT_CA, LIST, *KEYS)
"""All that an enclave may hold and a stack reads; never a CA's key."""


def enclave_files(keystore: Keystore, name: str) -> dict[str, bytes]:
    """The files of the participant called `name`, links followed, by their names in FILES.

    Those that are not NEEDED may be missing. KeystoreError if there is no such
    participant, or it lacks one that is.
    """
    regular = _layout.enclave_name(name)
    refuse_unknown(keystore.root, regular)
    folder = keystore.root / _layout.enclave_folder(regular)
    with disk_errors(folder):
        there = [each for each in FILES if _is_there(folder / each)]
    missing = [each for each in NEEDED if each not in there]
    if missing:
        raise KeystoreError(f"{folder} lacks {', '.join(missing)}")
    return {each: read(folder / each) for each in there}


def regular_name(text: str) -> str:
    """`text` as participants are named: /fleet/robot1. UsageError if it cannot be one."""
    return _layout.enclave_name(text)


def _is_there(path: Path) -> bool:
    if path.is_symlink() and not path.exists():
        raise KeystoreError(f"{path} leads nowhere", hint=f"restore {path.readlink()}")
    return path.exists()
