"""Refuse a keystore that another user could change, or put another in the place of."""

import os
from collections.abc import Iterator
from pathlib import Path

from pqsec_pki._places import refuse_outsiders
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._folder import OTHERS
from pqsec_pki.keystore._settings import set_names

_BESIDE = (
    layout.ENCLAVES,
    *(f"{layout.ENCLAVES}/{each}" for each in (layout.GOVERNANCE, layout.GOVERNANCE_XML)),
)


def refuse_open_keystore(root: Path) -> None:
    """KeystoreError if another user could change the keystore at `root`, or a folder above it.

    That is all which commands use for every participant: it costs the same for any number. The
    folder of a participant is looked at when it is changed.
    """
    refuse_open_root(root)
    refuse_outsiders(_in(root), OTHERS, roots=True, error=KeystoreError)


def refuse_open_root(root: Path) -> None:
    """KeystoreError if another user could change the folder `root` or its settings."""
    refuse_outsiders((root,), OTHERS, error=KeystoreError)
    refuse_outsiders((root / layout.SETTINGS,), OTHERS, roots=True, error=KeystoreError)


def _in(root: Path) -> Iterator[Path]:
    yield root / layout.GROUPS
    for name in set_names(root):
        folder = root / layout.in_set(name, "")
        if folder != root:
            yield from (folder.parent, folder)
        yield from (folder / each for each in _BESIDE)
        for public in (layout.PUBLIC, layout.PRIVATE):
            for above, _, files in os.walk(folder / public):
                yield Path(above)
                yield from (Path(above, each) for each in files)
