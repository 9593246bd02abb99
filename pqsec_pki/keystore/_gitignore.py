"""The `.gitignore` of a keystore: secrets stay out of git, whoever adds all files.

Certificates and signed documents may go in. What git takes of the enclaves is listed, not what it
leaves out: so it takes no key, whatever its name is.
"""

from contextlib import suppress
from pathlib import Path

from pqsec_pki._files import read
from pqsec_pki.credentials import CERTIFICATE, ENCLAVES, PROOF, REQUEST, REVOCATION_LIST
from pqsec_pki.errors import MissingError
from pqsec_pki.keystore import layout

GITIGNORE = ".gitignore"
_FIRST = "# Written by pqsec: secrets stay out of git."
_SECRETS = ("*.key", "*.key.pem", layout.KEY, "*.token", "*.bundle", "*passphrase*", "*.pin")
"""Also what users put beside a keystore."""
_SHOWN = (CERTIFICATE, "*.cert.pem", REVOCATION_LIST, "*.xml", "*.p7s", REQUEST, PROOF)
"""What git takes of the enclaves."""
_IN_SETS = layout.in_set("*", "")
_KEYSTORE = (
    *(f"/{each}/" for each in (layout.PRIVATE, layout.JOURNAL, layout.PREPARED, ".draft-*")),
    f"/{_IN_SETS}{layout.PRIVATE}/",
    *(
        pattern
        for folder in (f"/{ENCLAVES}/**", f"/{_IN_SETS}{ENCLAVES}/**")
        for pattern in (folder, f"!{folder}/", *(f"!{folder}/{each}" for each in _SHOWN))
    ),
    *_SECRETS,
)


def keystore_ignored(root: Path) -> bytes:
    """The content for a keystore's `.gitignore`. FileError if what is there cannot be read."""
    return ignored_in(root, _KEYSTORE)


def secrets_ignored(folder: Path, *more: str) -> bytes:
    """The content for a folder with secrets and `more`, patterns; FileError as above."""
    return ignored_in(folder, (*more, *_SECRETS))


def ignored_in(folder: Path, patterns: tuple[str, ...]) -> bytes:
    """What is in the folder's `.gitignore`, and then the patterns: git uses the last that fits.

    A link is not followed, by git neither.
    """
    path, block = folder / GITIGNORE, "\n".join((_FIRST, *patterns, ""))
    before = b""
    with suppress(MissingError):
        before = b"" if path.is_symlink() else read(path)
    if block.encode() in before:
        return before
    return before + (b"\n" if before and not before.endswith(b"\n") else b"") + block.encode()
