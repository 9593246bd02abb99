"""Gets the PIN of a token: never from a URI, an argument or the ledger."""

import os
from collections.abc import Callable
from pathlib import Path

from pqsec_pki._files import read
from pqsec_pki._places import refuse_obeyed
from pqsec_pki.errors import PassphraseError

Pin = Callable[[str], str]
"""Gives the PIN of the token with that label, or raises PassphraseError."""
VARIABLE = "PQSEC_PIN_FILE"
MAX_FILE = 4096
"""Bytes."""


def stored_pin(token: str) -> str:
    """The PIN in the file that PQSEC_PIN_FILE names, for processes without a terminal."""
    if file := os.environ.get(VARIABLE):
        return pin_in(Path(file))
    raise PassphraseError(
        f"the token '{token}' needs a PIN, and there is no terminal to ask for it",
        hint=f"name a file with it in {VARIABLE}, or in the key's URI: ?pin-source=file:/path",
    )


def pin_in(path: Path) -> str:
    """The PIN in the first line of a file.

    PassphraseError if there is none; FileError if another user could change it.
    """
    refuse_obeyed([path], "the PIN")
    line = read(path, limit=MAX_FILE).split(b"\n", 1)[0].rstrip(b"\r")
    try:
        pin = line.decode()
    except UnicodeDecodeError:
        pin = ""
    if not pin:
        raise PassphraseError(f"{path}: the first line must be the PIN, in UTF-8")
    return pin
