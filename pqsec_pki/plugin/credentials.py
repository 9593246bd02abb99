"""Reads a participant's configuration: properties of its QoS, and the files that they name.

Names and forms are Cyclone DDS's (dds_security_api_defs.h), whose configuration file has them
as elements. Cyclone DDS has no properties for some files, which are read from beside others:
`alt.key.pem` beside `key.pem`, `permissions_ca.alt.cert.pem` beside `permissions_ca.cert.pem`,
and `pqsec.toml` beside the identity certificate.
"""

import stat
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import field
from pathlib import Path
from typing import TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import MAX_FILE, disk_errors, exists, read
from pqsec_pki.algorithms import PrivateKey
from pqsec_pki.certificates import Certificate, RevocationList
from pqsec_pki.credentials import certificates_in, only_certificate, only_list
from pqsec_pki.errors import FileError, MalformedError, UsageError, located
from pqsec_pki.plugin.property_names import understood
from pqsec_pki.tokens import SCHEME, KeyUri, key_in, reference_to

PRIVATE_KEY = "dds.sec.auth.private_key"
PASSWORD = "dds.sec.auth.password"  # noqa: S105 -- a property's name
MAX_TRUSTED = 64
"""Certificates in a folder of trusted CAs."""
_CONTROL = set(map(chr, range(32)))

FileState: TypeAlias = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Source:
    """The value of a property: a file, or the octets themselves."""

    name: str
    path: Path | None
    data: bytes | None = field(default=None, repr=False)

    def read(self) -> bytes:
        """FileError if it is a file that cannot be read."""
        return octets_of(self.path) if self.path else self.data or b""

    def beside(self, name: str) -> Path | None:
        """The file of that name in its folder, if it is a file and has such a neighbour.

        FileError if the system does not say.
        """
        found = self.path.with_name(name) if self.path else None
        return found if found and exists(found) else None

    @property
    def where(self) -> str:
        """The path or name, for messages."""
        return str(self.path) if self.path else self.name


class Properties:
    """The properties of a participant, and the folder that relative paths are relative to."""

    def __init__(self, pairs: Iterable[tuple[str, str]], folder: str) -> None:
        """UsageError for an unknown security property."""
        self._values = {name: value.strip(" \t") for name, value in understood(pairs).items()}
        self._folder = Path(folder)

    def optional(self, name: str) -> str:
        """Its value; empty if it is not set."""
        return self._values.get(name, "")

    def source(self, name: str) -> Source:
        """The source that the property names; UsageError if it is not set, or has another form."""
        value = self.optional(name)
        kind, colon, rest = value.partition(":")
        if not value:
            raise UsageError(f"{name} is not configured")
        if kind == "data" and rest.startswith(","):
            return Source(name, None, rest[1:].encode(errors="surrogateescape"))
        if kind == "file" and colon and not _CONTROL & set(rest):
            return Source(name, self._folder / rest.removeprefix("//"))
        if kind == SCHEME and name == PRIVATE_KEY:
            return Source(name, None, reference_to(str(KeyUri.parse(value))))
        raise UsageError(  # the message does not quote it: it may be a key
            f"{name} is neither file: and a path nor data:,",
            hint="only a private key may be in a PKCS#11 token",
        )

    def folder(self, name: str) -> Path | None:
        """The folder that the property names; None if it is not set."""
        value = self.optional(name)
        return self._folder / value.removeprefix("file:").removeprefix("//") if value else None


def octets_of(path: Path, *, limit: int = MAX_FILE) -> bytes:
    """The content of the file; FileError if it cannot be read, or is not a regular file.

    Reading a pipe or a terminal may block, and would block all connections.
    """
    with suppress(OSError, ValueError):  # `read` has a message for it
        kind = path.stat().st_mode
        if not (stat.S_ISREG(kind) or stat.S_ISDIR(kind)):
            raise FileError(f"{path} is not a file")
    return read(path, limit=limit)


def certificate_at(source: Source) -> Certificate:
    """The one certificate in it. MalformedError if there is none or several, or FileError."""
    return only_certificate(source.read(), source.where)


def certificates_at(source: Source) -> tuple[Certificate, ...]:
    """All certificates in it; the same errors."""
    return certificates_in(source.read(), source.where)


def key_at(source: Source, password: str) -> PrivateKey:
    """The private key in it, or in the token that it refers to.

    MalformedError, FileError or PassphraseError; for a token errors as of `find_key`.
    """
    secret = password.encode(errors="surrogateescape") if password else None
    with located(source.where):
        return key_in(source.read(), secret)


def revocation_list_at(source: Source) -> RevocationList:
    """The revocation list in it. MalformedError or FileError."""
    return only_list(source.read(), source.where)


def state_of(source: Source | None) -> FileState:
    """(device, inode, time of change, size) of the file; empty if there is no file."""
    if source is None or source.path is None:
        return ()
    try:
        found = source.path.stat()
    except (OSError, ValueError):
        return ()
    return found.st_dev, found.st_ino, found.st_mtime_ns, found.st_size


def certificates_below(folder: Path) -> tuple[Certificate, ...]:
    """The certificates in the files of a folder; other files are ignored.

    MalformedError for a file with several; FileError if the folder cannot be read or has too
    many files.
    """
    try:
        with disk_errors(folder):
            paths = sorted(path for path in folder.iterdir() if path.is_file())
    except ValueError as error:  # a path with a NUL
        raise FileError(f"{folder}: {error}") from error
    if len(paths) > MAX_TRUSTED:
        raise FileError(f"{folder}: more than {MAX_TRUSTED} files")
    return tuple(found for path in paths if (found := _certificate_below(path)))


def _certificate_below(path: Path) -> Certificate | None:
    data = octets_of(path)
    try:
        certificates_in(data, str(path))
    except MalformedError:
        return None
    return only_certificate(data, str(path))
