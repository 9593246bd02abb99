"""Where the PIN of a token comes from: never from a URI, an argument or the ledger."""

from collections.abc import Callable
from pathlib import Path

from pqsec_pki._files import read
from pqsec_pki.errors import PassphraseError

Pin = Callable[[str], str]
"""Gives the PIN of the token with that label, or raises PassphraseError."""
MAX_FILE = 4096
"""Bytes."""


def no_pin(token: str) -> str:
    """For whoever can ask nobody: PassphraseError."""
    raise PassphraseError(
        f"the token '{token}' needs a PIN",
        hint="name a file with it in the key's URI: ?pin-source=file:/path",
    )


def pin_in(path: Path) -> str:
    """The PIN in the first line of a file; PassphraseError if there is none."""
    line = read(path, limit=MAX_FILE).split(b"\n", 1)[0].rstrip(b"\r")
    try:
        pin = line.decode()
    except UnicodeDecodeError:
        pin = ""
    if not pin:
        raise PassphraseError(f"{path}: the first line must be the PIN, in UTF-8")
    return pin
