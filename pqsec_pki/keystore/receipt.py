"""A receipt: what is installed of one participant, as its robot says. Its signature is not here.

A robot numbers its receipts. Its clock is only told: it orders nothing
(docs/explanation/adr/0035-robots-order-by-numbers.md).

The ledger has the receipts that were imported. The room `enrolment` makes, signs and verifies them.
"""

import hashlib
import json
import re
from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import Any, Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.certificates import Certificate
from pqsec_pki.credentials import FILES, KEYS
from pqsec_pki.errors import MalformedError, PqsecError, shown
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore.bundle_numbers import MAX_NUMBER, bundle_number

RECEIPT = "receipt"
"""The kind of the ledger's lines, and of the file."""
FORMAT = 2
PUBLIC_FILES = tuple(file for file in FILES if file not in KEYS)
MAX_STATEMENT = 16 << 10
"""Bytes; the seven files of an enclave in one set take less than one thousand."""
_STATEMENT = "statement"
_CERTIFICATE = "certificate"
_IN_SET = re.compile(rf"{layout.SETS}/[a-z0-9-]{{1,64}}/([^/]+)")
_SHA256 = re.compile("[0-9a-f]{64}")
_STORE = re.compile("[0-9a-f]{32}")
_VERSION = re.compile(r"[0-9A-Za-z.+_-]{1,64}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Receipt:
    """The installed files of one participant."""

    participant: str
    store: str
    """The identifier of the credential store that made it: 16 random bytes, in hex."""
    number: int
    """How many receipts that store has made, with this one: it orders the receipts of a store."""
    bundle: int | None
    """The number of the bundle that it came from, as its manifest says. Nothing signs that."""
    files: Mapping[str, str]
    """SHA-256 of each file, in hex, by its name, as of `layout.in_set`: that of a further set is
    sets/hybrid/cert.pem. Never of a private key."""
    installed_at: datetime
    made_at: datetime
    """The times of the installation and of the receipt, by the robot's clock, which may be wrong.
    """
    pqsec: str
    """The version that made it."""

    @classmethod
    def of(cls, entry: Entry) -> Self:
        """The receipt in a ledger entry; KeystoreError if that is damaged."""
        try:
            return cls.from_json(str(entry.details.get(_STATEMENT)).encode())
        except MalformedError:
            raise entry.damaged() from None

    @staticmethod
    def certificate_number(entry: Entry) -> int:
        """The sequence number of the certificate that signed the receipt in a ledger entry.

        0 if it had none; KeystoreError if the entry is damaged.
        """
        text = entry.details.get(_CERTIFICATE, "")
        if not (text.isascii() and text.isdecimal()):
            raise entry.damaged()
        return int(text)

    def entry(self, certificate: Certificate, now: datetime) -> Entry:
        """The ledger entry of this receipt, which the holder of `certificate` signed."""
        details = {
            "bundle": str(self.bundle or ""),
            "installed": self.installed_at.isoformat(),
            _CERTIFICATE: str(certificate.number or 0),
            _STATEMENT: self.to_json().decode(),
        }
        serial = certificate.serial_number
        return Entry.of(RECEIPT, self.participant, self.sha256, now, serial=serial, details=details)

    def to_json(self) -> bytes:
        """The statement; the same bytes for the same receipt."""
        value = {
            "format": FORMAT,
            "kind": RECEIPT,
            "participant": self.participant,
            "store": self.store,
            "number": self.number,
            "bundle": self.bundle,
            "files": self.files,
            "installed_at": self.installed_at.isoformat(),
            "made_at": self.made_at.isoformat(),
            "pqsec": self.pqsec,
        }
        return json.dumps(value, indent=2, sort_keys=True).encode() + b"\n"

    @classmethod
    def from_json(cls, data: bytes) -> Self:
        """The receipt in `data`, with any line ends; MalformedError if it is not exactly one."""
        text = data.replace(b"\r\n", b"\n")
        try:
            if len(text) > MAX_STATEMENT:
                raise MalformedError(f"larger than {MAX_STATEMENT} bytes")
            value: dict[str, Any] = json.loads(text)
            if value["kind"] != RECEIPT or value["format"] != FORMAT:
                raise MalformedError("made by another version of pqsec")
            found = cls(
                participant=layout.enclave_name(_text(value["participant"])),
                store=_matching(_STORE, value["store"]),
                number=_number(value["number"]),
                bundle=bundle_number(value["bundle"]),
                files={
                    _file_name(name): _matching(_SHA256, each)
                    for name, each in value["files"].items()
                },
                installed_at=_time(value["installed_at"]),
                made_at=_time(value["made_at"]),
                pqsec=_matching(_VERSION, value["pqsec"]),
            )
            if found.to_json() != text:
                raise MalformedError("not in the form that pqsec writes")
        except (
            *(ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError),
            PqsecError,
        ) as error:
            raise MalformedError(f"not a receipt of pqsec: {shown(str(error))}") from error
        return found

    @property
    def further(self) -> tuple[str, ...]:
        """The further sets of credentials of which it names files, sorted."""
        return tuple(sorted({each.split("/")[1] for each in self.files if "/" in each}))

    @property
    def sha256(self) -> str:
        """SHA-256 of the statement, in hex; it does not depend on the signatures."""
        return hashlib.sha256(self.to_json()).hexdigest()


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError(f"a {type(value).__name__} in place of a text")
    return value


def _file_name(value: object) -> str:
    name = _text(value)
    match = _IN_SET.fullmatch(name)
    if (match[1] if match else name) not in PUBLIC_FILES:
        raise ValueError(f"{shown(name)} is not one of {', '.join(PUBLIC_FILES)}")
    return name


def _matching(pattern: re.Pattern[str], value: object) -> str:
    if not pattern.fullmatch(_text(value)):
        raise ValueError(f"{shown(_text(value))} does not match {pattern.pattern}")
    return _text(value)


def _number(value: object) -> int:
    if type(value) is not int or not 0 < value <= MAX_NUMBER:
        raise ValueError("the number of a receipt is not 1 to 2^63 - 1")
    return value


def _time(value: object) -> datetime:
    found = datetime.fromisoformat(_text(value))
    if found.utcoffset() != timedelta(0):  # it is shown, and compared, as UTC
        raise ValueError("a time that is not in UTC")
    return found
