"""An archive: files sent together, with a manifest of their hashes.

The manifest is not signed. It shows damage and mistakes; authenticity comes from the
signatures in the files.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import field
from datetime import UTC, datetime
from typing import Any, Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.enrolment import tarball
from pqsec_pki.errors import MalformedError, TooLargeError, VerificationError, other_format, shown

FORMAT = 1
MANIFEST = "manifest.json"
MAX_MANIFEST = 8 << 20
"""Bytes. The maximum number of files needs 3 MB; the parsed JSON takes many times more memory."""


@dataclass(frozen=True, slots=True)
class Archive:
    """Files by name, and the other values of the manifest (`about`)."""

    kind: str
    about: Mapping[str, Any]
    files: Mapping[str, bytes] = field(repr=False)

    def pack(self) -> bytes:
        """The archive as bytes; the same bytes for the same archive.

        TooLargeError for one that `unpack` would refuse.
        """
        hashes = {name: _sha256(data) for name, data in sorted(self.files.items())}
        manifest = {"format": FORMAT, "kind": self.kind, **self.about, "files": hashes}
        text = json.dumps(manifest, sort_keys=True) + "\n"  # `indent` takes ten times as long
        hint = "write several, each for fewer participants"
        TooLargeError.check("the manifest", len(text), MAX_MANIFEST, hint=hint)
        return tarball.pack({**self.files, MANIFEST: text.encode()})

    @classmethod
    def unpack(cls, data: bytes, kind: str) -> Self:
        """The archive in `data`, complete and undamaged.

        MalformedError if it is not an archive of that kind. VerificationError, with
        everything that is wrong, if its files do not match its manifest.
        """
        files = tarball.unpack(data)
        try:
            text = files.pop(MANIFEST)
            if len(text) > MAX_MANIFEST:
                raise MalformedError(f"the manifest is larger than {MAX_MANIFEST} bytes")
            manifest = json.loads(text)
            if manifest["format"] != FORMAT:
                raise other_format(MalformedError, manifest["format"], (FORMAT,))
            found, hashes = manifest["kind"], dict(manifest["files"])
        except (KeyError, ValueError, TypeError, RecursionError):
            raise MalformedError(f"not a {kind} of pqsec: it has no readable manifest") from None
        if found != kind:
            raise MalformedError(f"this is a {shown(str(found))}, not a {kind}")
        _check(files, hashes)
        about = {key: manifest[key] for key in manifest.keys() - {"format", "kind", "files"}}
        return cls(kind, about, files)

    def text(self, key: str) -> str:
        """The text under `key` in the manifest; MalformedError if it is not a text."""
        value = self.about.get(key)
        if not isinstance(value, str):
            raise MalformedError(f"the manifest lacks {key}")
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """The list of texts under `key`; MalformedError if it is not one."""
        value = self.about.get(key)
        if not (isinstance(value, list) and all(isinstance(each, str) for each in value)):
            raise MalformedError(f"the manifest lacks {key}")
        return tuple(value)

    def time(self, key: str) -> datetime:
        """The time under `key`, in UTC; MalformedError if it is not a time."""
        try:
            return datetime.fromisoformat(self.text(key)).astimezone(UTC)
        except (ValueError, OverflowError):
            raise MalformedError(f"the manifest lacks {key}") from None


def _check(files: Mapping[str, bytes], hashes: Mapping[Any, Any]) -> None:
    problems = [f"{shown(str(name))} is missing" for name in hashes if name not in files]
    for name, data in files.items():
        if name not in hashes:
            problems.append(f"{name} is not in the manifest")
        elif hashes[name] != _sha256(data):
            problems.append(f"{name} differs from the manifest (SHA-256)")
    if problems:
        raise VerificationError(*problems)


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
