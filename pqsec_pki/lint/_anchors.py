"""The CAs of enclaves, read once for all enclaves with the same files."""

from collections.abc import Mapping
from dataclasses import replace

from pqsec_pki.credentials import (
    IDENTITY_CA,
    PERMISSIONS_ALT_CA,
    PERMISSIONS_CA,
    REVOCATION_LIST,
    TrustAnchors,
)
from pqsec_pki.errors import PqsecError

_FILES = (IDENTITY_CA, PERMISSIONS_CA, PERMISSIONS_ALT_CA, REVOCATION_LIST)


class SharedAnchors:
    """Reads anchors. Enclaves with the same CAs get the same value, which remembers all that it
    verified: so each document is verified once, whichever rules ask.
    """

    def __init__(self, known: TrustAnchors | None = None) -> None:
        self._known = known
        self._read: dict[tuple[bytes | None, ...], TrustAnchors | None] = {}

    def of(self, files: Mapping[str, bytes]) -> TrustAnchors | None:
        """The CAs in the files by their roles; None if one is missing or cannot be read."""
        key = tuple(files.get(name) for name in _FILES)
        if key not in self._read:
            self._read[key] = self._anchors(files)
        return self._read[key]

    def _anchors(self, files: Mapping[str, bytes]) -> TrustAnchors | None:
        try:
            found = TrustAnchors.of(files)
        except (KeyError, PqsecError):  # KeyError: a file is missing
            return None
        if self._known and found.content == self._known.content:
            return self._known
        return replace(found, remembers_all=True)
