"""The chain of the ledger: each line has a hash of its content and of the line before.

An edited, removed or moved line breaks the chain. Missing newest lines do not: they show
only against a head that was noted elsewhere, or as files of the keystore without a line.
"""

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import field, replace
from datetime import datetime
from functools import lru_cache
from typing import Self, TypeVar

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import KeystoreError, shown

Value = TypeVar("Value")

START = "0" * 64
"""The chain value before the first line."""
SET = "set"
"""The detail with the name of the set of credentials; lines of the first set have none."""
SET_END = "set-end"
"""The kind of the line with which a set of credentials ends."""
OF_A_SET = frozenset(
    {
        SET_END,
        *("identity-ca", "permissions-ca", "trust", "trust-end", "participant", "permissions"),
        *("governance", "crl", "revocation", "compromise"),
    }
)
"""The kinds of lines about one set; all others are about the whole keystore."""
_LINE = json.JSONEncoder(separators=(",", ":"))
_DETAILS = json.JSONEncoder(sort_keys=True, separators=(",", ":"))


@dataclass(frozen=True, slots=True)
class Entry:
    """One thing that was issued, signed or revoked: when, what, its name and its SHA-256."""

    at: str
    """ISO 8601, UTC."""
    kind: str
    """docs/reference/keystore.md lists the kinds."""
    name: str
    serial: str | None
    """A certificate's serial number in hex; None for documents."""
    sha256: str
    """Of a certificate's DER; or of the file of a signed document, of a revocation list, or of
    the trusted identity CAs (overlap.py)."""
    not_after: str | None
    """ISO 8601, UTC. The end of a certificate; of a revocation list, its nextUpdate."""
    issuer: str | None = None
    """SHA-256 of the CA's certificate; of participants, revocations and revocation lists."""
    details: dict[str, str] = field(default_factory=dict)
    """By the kind of line: profile and domains of a participant, reason of a revocation, number of
    a revocation list."""
    operator: str | None = None
    """Who ran the command: PQSEC_OPERATOR, or the system's name of the user; None in lines of
    format 1."""

    @classmethod
    def of(  # noqa: PLR0913 -- the fields of the line, the rarer ones by name
        cls,
        kind: str,
        name: str,
        sha256: str,
        now: datetime,
        *,
        serial: int | None = None,
        not_after: datetime | None = None,
        issuer: str | None = None,
        details: Mapping[str, str] | None = None,
    ) -> Self:
        """The entry of what is done `now`."""
        return cls(
            at=now.isoformat(timespec="seconds"),
            kind=kind,
            name=name,
            serial=None if serial is None else f"{serial:x}",
            sha256=sha256,
            not_after=not_after.isoformat() if not_after else None,
            issuer=issuer,
            details=dict(details or {}),
        )

    def in_set(self, name: str) -> Self:
        """This entry, about that set of credentials if its kind is about one."""
        if not name or self.kind not in OF_A_SET:
            return self
        return replace(self, details={**self.details, SET: name})

    @property
    def set_name(self) -> str:
        """The set of credentials that it is about; empty for the first one, or for none."""
        return self.details.get(SET, "")

    @property
    def made_at(self) -> datetime:
        """`at`, as a time. KeystoreError (as for the next three) if the line is damaged."""
        return self._read(time_in, self.at)

    @property
    def ends(self) -> datetime:
        """`not_after`, as a time."""
        return self._read(time_in, self.not_after)

    @property
    def serial_number(self) -> int:
        """`serial`, as a number."""
        return self._read(_hexadecimal, self.serial)

    @property
    def list_number(self) -> int:
        """A revocation list's number."""
        return self._read(int, self.details.get("number"))

    def _read(self, reader: Callable[[str], Value], text: str | None) -> Value:
        try:
            return reader(text or "")
        except (ValueError, TypeError):
            raise self.damaged() from None

    def damaged(self, why: str = "") -> KeystoreError:
        """The error for this line if it cannot be read."""
        return damaged_line(self.kind, self.name, why)


def damaged_line(kind: str, name: str, why: str = "") -> KeystoreError:
    """The error for a line that cannot be read."""
    line = f"{kind} {shown(name)}".rstrip()
    return KeystoreError(
        f"the ledger's line on {line} is damaged{f' ({why})' if why else ''}",
        hint="`pqsec log --verify` shows which lines were altered",
    )


@lru_cache(maxsize=1024)  # one batch shares its times
def time_in(text: str) -> datetime:
    """The time in a line; ValueError if it is not one, or has no zone."""
    found = datetime.fromisoformat(text)
    if found.tzinfo is None:
        raise ValueError("without a zone")
    return found


def _hexadecimal(text: str) -> int:
    return int(text, 16)


@dataclass(frozen=True, slots=True)
class Line:
    """An entry with its number and its chain value."""

    number: int
    """The line number, from 1, without gaps."""
    entry: Entry
    chain: str
    """SHA-256, in hex, over the previous chain value and this line."""

    def to_json(self) -> dict[str, object]:
        """The line for --json."""
        entry = self.entry
        return {
            "number": self.number,
            "at": entry.at,
            "operator": entry.operator,
            "kind": entry.kind,
            "name": entry.name,
            "serial": entry.serial,
            "issuer": entry.issuer,
            "sha256": entry.sha256,
            "not_after": entry.not_after,
            "details": entry.details,
            "chain": self.chain,
        }


def link(before: str, number: int, entry: Entry) -> str:
    """The chain value of `entry` as line `number`; `before` is the previous line's value."""
    content = [
        *(before, number, entry.at, entry.operator, entry.kind, entry.name, entry.serial),
        *(entry.issuer, entry.sha256, entry.not_after, details_text(entry)),
    ]
    return hashlib.sha256(_LINE.encode(content).encode()).hexdigest()


def details_text(entry: Entry) -> str:
    """The details as stored: JSON with sorted keys and without blanks."""
    return _DETAILS.encode(entry.details)


def problems(lines: Iterable[Line]) -> Iterator[str]:
    """The breaks in the chain: missing, altered and replaced lines."""
    before, last = START, 0
    for line in lines:
        gap = line.number - last - 1
        if gap > 0:
            yield f"{_numbered(last + 1, line.number - 1)} missing"
        # After a gap the previous chain value is unknown.
        elif line.chain != link(before, line.number, line.entry):
            yield f"line {line.number} was altered or replaced"
        before, last = line.chain, line.number


def _numbered(first: int, last: int) -> str:
    return f"line {first} is" if first == last else f"lines {first} to {last} are"
