"""The trust state of a robot, which stays when one set of credentials replaces another.

Pins are the CAs that the robot trusts, each with its role. Marks are the newest revocation list
number, signing times and certificates that were ever installed here. They never decrease, so no
older bundle restores withdrawn rights or accepts a revoked peer, not even after a rollback.
"""

import hashlib
import json
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import field
from datetime import UTC, datetime
from typing import Any, Self, TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki.credentials import (
    CA_FILES,
    CERTIFICATE,
    GOVERNANCE,
    IDENTITY_CA,
    PERMISSIONS,
    PERMISSIONS_ALT_CA,
    PERMISSIONS_CA,
    REVOCATION_LIST,
    Credentials,
    TrustAnchors,
)
from pqsec_pki.errors import KeystoreError, UsageError, other_format, shown
from pqsec_pki.keystore import CurrentFiles, Keystore
from pqsec_pki.problems import Code, Problem

FORMAT = 1
ROLES = {
    "identity": IDENTITY_CA,
    "permissions": PERMISSIONS_CA,
    "countersigner": PERMISSIONS_ALT_CA,
}
"""The role of a CA, as written on the command line, and the file that contains it."""

Pins: TypeAlias = Mapping[str, frozenset[str]]
"""SHA-256 fingerprints of CA certificates, hex, by the file that contains them."""

_PIN = re.compile(rf"({'|'.join(ROLES)}):([0-9a-f]{{64}})")
_WORDS = {GOVERNANCE: "the governance is", PERMISSIONS: "the permissions are"}
_NEVER = datetime.min.replace(tzinfo=UTC)


def pins_of(texts: Iterable[str]) -> Pins:
    """Pins as written on the command line: identity:0ab1..., colons are optional.

    UsageError for anything else: without roles, one CA could act as another.
    """
    found: dict[str, set[str]] = {}
    for text in texts:
        role, _, digits = text.lower().partition(":")
        match = _PIN.fullmatch(f"{role}:{digits.replace(':', '')}")
        if not match:
            raise UsageError(
                f"'{shown(text)}' is not a role and a SHA-256 fingerprint",
                hint=f"write {', '.join(f'{each}:SHA256' for each in ROLES)};"
                " `pqsec ca show --pins` on the CA machine prints them",
            )
        found.setdefault(ROLES[match[1]], set()).add(match[2])
    return {file: frozenset(pins) for file, pins in found.items()}


def pins_in_use(keystore: Keystore) -> Pins:
    """The CAs that the robots of `keystore` trust; in an overlap, both identity CAs.

    Errors as of `CurrentFiles.shared`: who pins others would trust them.
    """
    with CurrentFiles.of(keystore) as current:
        return pins_in(current.anchors)


def pin_texts(pins: Pins) -> list[str]:
    """The pins as `pins_of` reads them, and `pqsec install` after --ca-fingerprint."""
    return [f"{role}:{each}" for role, file in ROLES.items() for each in sorted(pins.get(file, ()))]


def pin_problems(found: Pins, trusted: Pins) -> Iterator[Problem]:
    """CAs `found` in a role for which they are not trusted, and trusted CAs that are missing."""
    for role, file in ROLES.items():
        there, due = found.get(file, frozenset()), trusted.get(file, frozenset())
        for each in sorted(there - due):
            words = f"the {role} CA is not trusted in this role: SHA-256 {each}"
            yield Problem(words, Code.CA_UNKNOWN, file)
        for each in sorted(due - there):
            words = f"the {role} CA that is trusted is missing: SHA-256 {each}"
            yield Problem(words, Code.CA_MISSING, file)


@dataclass(frozen=True, slots=True, kw_only=True)
class Marks:
    """The newest documents that were ever installed."""

    lists: Mapping[str, int] = field(default_factory=dict)
    """CRL numbers, by SHA-256 of the identity CA's key (SPKI), hex."""
    signed: Mapping[str, datetime] = field(default_factory=dict)
    """Signing times of documents, by name: 'governance.p7s', 'permissions.p7s /talker'."""
    issued: Mapping[str, datetime] = field(default_factory=dict)
    """Start of validity of certificates, by participant."""

    @classmethod
    def of(cls, credentials: Credentials) -> Self:
        """The marks of a participant's credentials; VerificationError for an invalid signature."""
        anchors, name = credentials.anchors, credentials.name
        governance = anchors.signatures(credentials.governance)[0].signed_at
        permissions = anchors.signatures(credentials.permissions)[0].signed_at
        revocation_list = anchors.revocation_list
        number = -1 if revocation_list is None else (revocation_list.number or 0)
        return cls(
            lists={} if revocation_list is None else {_key_of(credentials): number},
            signed={
                GOVERNANCE: governance or _NEVER,
                f"{PERMISSIONS} {name}": permissions or _NEVER,
            },
            issued={name: credentials.certificate.not_before},
        )

    def raised_by(self, other: "Marks") -> "Marks":
        """The newer value of both, for each mark."""
        return Marks(
            lists=_highest(self.lists, other.lists),
            signed=_highest(self.signed, other.signed),
            issued=_highest(self.issued, other.issued),
        )

    def problems(self, credentials: Credentials) -> Iterator[Problem]:
        """Files of `credentials`, whose signatures are valid, that are older than the marks."""
        new, name = Marks.of(credentials), credentials.name
        for who, when in new.issued.items():
            if when < self.issued.get(who, _NEVER):
                yield _older(name, CERTIFICATE, "the certificate is")
        key = _key_of(credentials)
        if key not in new.lists:
            # With two trusted identity CAs, in a rollover, there is no list
            # (docs/how-to/rollover.md).
            if key in self.lists and not credentials.anchors.in_overlap:
                words = "the revocation list is missing, but one was installed before"
                yield Problem(words, Code.LIST_MISSING, f"{name}: {REVOCATION_LIST}")
        elif new.lists.get(key, -1) < self.lists.get(key, -1):
            yield _older(name, REVOCATION_LIST, "the revocation list is")
        for file, when in new.signed.items():
            if when < self.signed.get(file, _NEVER):
                document = file.split()[0]
                yield _older(name, document, _WORDS[document])


@dataclass(frozen=True, slots=True, kw_only=True)
class TrustState:
    """Pins and marks of one robot, and what it demands."""

    pins: Pins
    marks: Marks
    proofs: bool = False
    """Whether each bundle must prove that the ledger has its documents."""

    @classmethod
    def from_json(cls, data: bytes) -> Self:
        """The trust state in `data`; KeystoreError if it is damaged, or of another version."""
        try:
            value: dict[str, Any] = json.loads(data)
            if value["format"] != FORMAT:
                other = other_format(KeystoreError, value["format"], (FORMAT,))
                raise KeystoreError(other.words)  # the way out is that of a damaged one
            marks = value["marks"]
            return cls(
                pins={
                    file: frozenset(map(str, value["pins"][role]))
                    for role, file in ROLES.items()
                    if role in value["pins"]
                },
                marks=Marks(
                    lists={str(key): int(number) for key, number in marks["lists"].items()},
                    signed=_times(marks["signed"]),
                    issued=_times(marks["issued"]),
                ),
                proofs=value.get("proofs", False) is True,
            )
        except (
            *(ValueError, KeyError, TypeError),
            *(AttributeError, OverflowError, RecursionError),
        ) as error:
            raise KeystoreError(f"cannot be read: {shown(str(error))}") from error

    def to_json(self) -> bytes:
        """The state as JSON; the same bytes for the same state."""
        value = {
            "format": FORMAT,
            "pins": {
                role: sorted(self.pins[file]) for role, file in ROLES.items() if file in self.pins
            },
            "marks": {
                "lists": self.marks.lists,
                "signed": {key: each.isoformat() for key, each in self.marks.signed.items()},
                "issued": {key: each.isoformat() for key, each in self.marks.issued.items()},
            },
        }
        if self.proofs:
            value["proofs"] = True
        return json.dumps(value, indent=2, sort_keys=True).encode() + b"\n"

    def after(self, credentials: Collection[Credentials], pins: Pins) -> "TrustState":
        """The state after the installation of `credentials`, with the CAs `pins`."""
        marks = self.marks
        for each in credentials:
            marks = marks.raised_by(Marks.of(each))
        return TrustState(pins=pins, marks=marks, proofs=self.proofs)


def pins_in(*anchors: TrustAnchors) -> Pins:
    """The fingerprints of all CAs in `anchors`, by their roles."""
    found: dict[str, set[str]] = {}
    for each in anchors:
        for file, authorities in each.roles.items():
            found.setdefault(file, set()).update(ca.fingerprint for ca in authorities)
    return {file: frozenset(found[file]) for file in CA_FILES if found.get(file)}


def _key_of(credentials: Credentials) -> str:
    return hashlib.sha256(credentials.anchors.identity_ca.spki).hexdigest()


def _older(name: str, file: str, what: str) -> Problem:
    return Problem(f"{what} older than one installed before", Code.OLDER, f"{name}: {file}")


def _highest(one: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    return {key: max(each[key] for each in (one, other) if key in each) for key in {**one, **other}}


def _times(value: Mapping[str, str]) -> dict[str, datetime]:
    found = {str(key): datetime.fromisoformat(each) for key, each in value.items()}
    if any(each.tzinfo is None for each in found.values()):
        raise ValueError("a time without a time zone")
    return found
