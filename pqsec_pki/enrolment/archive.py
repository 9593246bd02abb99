"""A parcel: files that travel together, and a manifest that says what each must be.

The manifest is not signed. It shows damage and mistakes; whom to believe, the
signatures inside the files say.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Self

from pqsec_pki.enrolment import tarball
from pqsec_pki.errors import MalformedError, VerificationError, shown

FORMAT = 1
MANIFEST = "manifest.json"
MAX_MANIFEST = 8 << 20
"""Bytes: as many files as an archive may have need 3 MB. Parsed, it takes many times more."""


@dataclass(frozen=True, slots=True)
class Archive:
    """Files by name, and what the manifest says beside their hashes."""

    kind: str
    about: Mapping[str, Any]
    files: Mapping[str, bytes] = field(repr=False)

    def pack(self) -> bytes:
        """One file; the same for the same parcel."""
        hashes = {name: _sha256(data) for name, data in sorted(self.files.items())}
        manifest = {"format": FORMAT, "kind": self.kind, **self.about, "files": hashes}
        text = json.dumps(manifest, indent=2, sort_keys=True) + "\n"
        return tarball.pack({**self.files, MANIFEST: text.encode()})

    @classmethod
    def unpack(cls, data: bytes, kind: str) -> Self:
        """The parcel in `data`, complete and undamaged.

        MalformedError if it is none of that kind, VerificationError, with all that is
        wrong, if its files are not those of its manifest.
        """
        files = tarball.unpack(data)
        try:
            text = files.pop(MANIFEST)
            if len(text) > MAX_MANIFEST:
                raise MalformedError(f"a manifest of more than {MAX_MANIFEST} bytes")
            manifest = json.loads(text)
            if manifest["format"] != FORMAT:
                raise MalformedError("made by another version of pqsec")
            found, hashes = manifest["kind"], dict(manifest["files"])
        except (KeyError, ValueError, TypeError, RecursionError):
            raise MalformedError(f"not a {kind} of pqsec: no manifest that can be read") from None
        if found != kind:
            raise MalformedError(f"a {shown(str(found))}, not a {kind}")
        _check(files, hashes)
        about = {key: manifest[key] for key in manifest.keys() - {"format", "kind", "files"}}
        return cls(kind, about, files)

    def text(self, key: str) -> str:
        """What the manifest says under `key`; MalformedError if that is no text."""
        value = self.about.get(key)
        if not isinstance(value, str):
            raise MalformedError(f"the manifest does not say {key}")
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """The same for a list of texts."""
        value = self.about.get(key)
        if not (isinstance(value, list) and all(isinstance(each, str) for each in value)):
            raise MalformedError(f"the manifest does not say {key}")
        return tuple(value)

    def time(self, key: str) -> datetime:
        """The same for a time, in UTC."""
        try:
            return datetime.fromisoformat(self.text(key)).astimezone(UTC)
        except (ValueError, OverflowError):
            raise MalformedError(f"the manifest does not say {key}") from None


def _check(files: Mapping[str, bytes], hashes: Mapping[Any, Any]) -> None:
    problems = [f"{shown(str(name))} is missing" for name in hashes if name not in files]
    for name, data in files.items():
        if name not in hashes:
            problems.append(f"{name} is not in the manifest")
        elif hashes[name] != _sha256(data):
            problems.append(f"{name} is not what the manifest says (SHA-256)")
    if problems:
        raise VerificationError(*problems)


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
