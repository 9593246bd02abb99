"""The trust state of a robot, which stays when one installation replaces another.

Pins are the CAs that the robot trusts, each with its role. Marks are the largest numbers of the
revocation list, the documents, the certificates and the ledger's head that were ever installed
here. They never decrease, so no older bundle restores withdrawn rights or accepts a revoked peer,
not even after a rollback. The state also counts the receipts that the robot made. No clock orders
anything (docs/explanation/adr/0035-robots-order-by-numbers.md).
"""

import hashlib
import json
import re
import secrets
from collections.abc import Collection, Iterator, Mapping
from dataclasses import field, replace
from typing import Any, Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.credentials import (
    CERTIFICATE,
    GOVERNANCE,
    PERMISSIONS,
    PROOF,
    REVOCATION_LIST,
    Credentials,
)
from pqsec_pki.enrolment.pins import Pins, file_of, role_of
from pqsec_pki.errors import KeystoreError, MalformedError, other_format, shown
from pqsec_pki.problems import Code, Problem
from pqsec_pki.transparency import HASH, TreeHead

FORMAT = 4
_STORE = re.compile("[0-9a-f]{32}")
_WORDS = {
    CERTIFICATE: "the certificate is",
    GOVERNANCE: "the governance is",
    PERMISSIONS: "the permissions are",
    REVOCATION_LIST: "the revocation list is",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Marks:
    """The largest numbers that were ever installed; no clock is asked.

    A number is of one keystore, so each is kept with the SHA-256, in hex, of the CA's key (SPKI).
    """

    lists: Mapping[str, int] = field(default_factory=dict)
    """CRL numbers, by identity CA."""
    numbers: Mapping[str, int] = field(default_factory=dict)
    """Sequence numbers of documents and certificates, by file, permissions CA and participant:
    'governance.p7s CA', 'permissions.p7s CA /talker'. What has no number counts as 0."""
    heads: Mapping[str, TreeHead] = field(default_factory=dict)
    """The ledger's head with the most lines, by permissions CA, ledger and participant."""

    @classmethod
    def of(cls, credentials: Credentials, head: TreeHead | None = None) -> Self:
        """The marks of a participant's credentials; VerificationError for an invalid signature.

        `head` is that of the proof that the ledger has them, which was verified.
        """
        anchors, ca = credentials.anchors, _permissions_key(credentials)
        found = {
            CERTIFICATE: credentials.certificate.number,
            GOVERNANCE: anchors.signatures(credentials.governance)[0].number,
            PERMISSIONS: anchors.signatures(credentials.permissions)[0].number,
        }
        list_, name = anchors.revocation_list, credentials.name
        return cls(
            lists={} if list_ is None else {_identity_key(credentials): list_.number or 0},
            numbers={_mark(file, ca, name): number or 0 for file, number in found.items()},
            heads={} if head is None else {_head_mark(ca, head, name): head},
        )

    def raised_by(self, other: "Marks") -> "Marks":
        """The larger value of both, for each mark; of two equal heads, that of these marks."""
        heads = {**self.heads}
        for key, head in other.heads.items():
            if key not in heads or heads[key].size < head.size:
                heads[key] = head
        return Marks(
            lists=_highest(self.lists, other.lists),
            numbers=_highest(self.numbers, other.numbers),
            heads=heads,
        )

    def problems(self, credentials: Credentials) -> Iterator[Problem]:
        """Files of `credentials`, whose signatures are valid, that are older than the marks."""
        new, name = Marks.of(credentials), credentials.name
        key = _identity_key(credentials)
        if key not in new.lists:
            # With two trusted identity CAs, in a rollover, there is no list
            # (docs/how-to/rollover.md).
            if key in self.lists and not credentials.anchors.in_overlap:
                words = "the revocation list is missing, but one was installed before"
                yield Problem(words, Code.LIST_MISSING, f"{name}: {REVOCATION_LIST}")
        elif new.lists[key] < self.lists.get(key, 0):
            yield _older(name, REVOCATION_LIST)
        for mark, number in new.numbers.items():
            if number < self.numbers.get(mark, 0):
                yield _older(name, mark.split()[0])

    def head_problems(self, credentials: Credentials, head: TreeHead) -> Iterator[Problem]:
        """Why `head`, of a proof for `credentials`, is not a later one of the ledger seen here.

        Bundles for several participants are installed in any order, so the number of lines is
        compared with that of the same participant.
        """
        ca, name = _permissions_key(credentials), credentials.name
        seen = {key: each for key, each in self.heads.items() if key.startswith(f"{ca} ")}
        ours = [each for each in seen.values() if each.origin == head.origin]
        own = seen.get(_head_mark(ca, head, name))
        if own and head.size < own.size:
            words = f"it is of an older ledger: of {head.size} lines, and {own.size} were seen here"
            yield Problem(words, Code.OLDER, PROOF).of(name)
        if any(each.size == head.size and each.root != head.root for each in ours):
            words = f"it is of another ledger: its {head.size} lines are not those seen here"
            yield Problem(words, Code.PROOF_BAD, PROOF).of(name)
        if seen and not ours:
            words = "it is of another ledger than the one seen here"
            yield Problem(words, Code.PROOF_BAD, PROOF).of(name)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrustState:
    """Pins and marks of one robot, and what it demands."""

    pins: Pins
    """The CAs of each set of credentials, and so which sets the robot needs."""
    marks: Marks
    store: str
    """Names this credential store in receipts: 16 random bytes, in hex."""
    receipts: int = 0
    """The number of the newest receipt made here. It never decreases."""
    proofs: bool = False
    """Whether each bundle must prove that the ledger has its documents."""

    @classmethod
    def of_new_store(cls, pins: Pins) -> Self:
        """The state of a store in which nothing was installed, with a name of its own."""
        return cls(pins=pins, marks=Marks(), store=secrets.token_hex(16))

    @classmethod
    def from_json(cls, data: bytes) -> Self:
        """The trust state in `data`; KeystoreError if it is damaged, or of another version."""
        try:
            value: dict[str, Any] = json.loads(data)
            if value["format"] != FORMAT:
                other = other_format(KeystoreError, value["format"], (FORMAT,))
                raise KeystoreError(other.words)  # the way out is that of a damaged one
            marks, receipts = value["marks"], value["receipts"]
            return cls(
                pins={
                    file_of(role): frozenset(map(str, pins)) for role, pins in value["pins"].items()
                },
                marks=Marks(
                    lists=_numbers(marks["lists"]),
                    numbers=_numbers(marks["numbers"]),
                    heads={str(key): _head(each) for key, each in marks["heads"].items()},
                ),
                store=_store(receipts["store"]),
                receipts=_numbers({"made": receipts["made"]})["made"],
                proofs=value.get("proofs", False) is True,
            )
        except (
            *(ValueError, KeyError, TypeError),
            *(AttributeError, OverflowError, RecursionError, MalformedError),
        ) as error:
            raise KeystoreError(f"cannot be read: {shown(str(error))}") from error

    def to_json(self) -> bytes:
        """The state as JSON; the same bytes for the same state."""
        value = {
            "format": FORMAT,
            "pins": {role_of(file): sorted(pins) for file, pins in self.pins.items()},
            "marks": {
                "lists": self.marks.lists,
                "numbers": self.marks.numbers,
                "heads": {
                    key: {"origin": each.origin, "size": each.size, "root": each.root.hex()}
                    for key, each in self.marks.heads.items()
                },
            },
            "receipts": {"store": self.store, "made": self.receipts},
        }
        if self.proofs:
            value["proofs"] = True
        return json.dumps(value, indent=2, sort_keys=True).encode() + b"\n"

    def after(
        self, credentials: Collection[Credentials], pins: Pins, heads: Mapping[str, TreeHead]
    ) -> "TrustState":
        """The state after the installation of `credentials`, with the CAs `pins`.

        `heads` are the heads of the ledger in their proofs, by participant.
        """
        marks = self.marks
        for each in credentials:
            marks = marks.raised_by(Marks.of(each, heads.get(each.name)))
        return replace(self, pins=pins, marks=marks)

    def with_next_receipt(self) -> "TrustState":
        """The state in which the store has made one more receipt."""
        return replace(self, receipts=self.receipts + 1)


def _identity_key(credentials: Credentials) -> str:
    return hashlib.sha256(credentials.anchors.identity_ca.spki).hexdigest()


def _permissions_key(credentials: Credentials) -> str:
    return hashlib.sha256(credentials.anchors.permissions_ca.spki).hexdigest()


def _mark(file: str, ca: str, name: str) -> str:
    """The key of a mark: all participants have the same governance."""
    return f"{file} {ca}" if file == GOVERNANCE else f"{file} {ca} {name}"


def _head_mark(ca: str, head: TreeHead, name: str) -> str:
    return f"{ca} {head.origin} {name}"


def _older(name: str, file: str) -> Problem:
    words = f"{_WORDS[file]} older than one installed before"
    return Problem(words, Code.OLDER, f"{name}: {file}")


def _highest(one: Mapping[str, int], other: Mapping[str, int]) -> dict[str, int]:
    return {key: max(each[key] for each in (one, other) if key in each) for key in {**one, **other}}


def _numbers(value: Mapping[str, Any]) -> dict[str, int]:
    """The marks in JSON; ValueError for one that is not a number."""
    if not all(type(each) is int and each >= 0 for each in value.values()):
        raise ValueError("a mark that is not a number")
    return {str(key): each for key, each in value.items()}


def _store(value: object) -> str:
    if not isinstance(value, str) or not _STORE.fullmatch(value):
        raise ValueError("the name of the store is not 32 hexadecimal digits")
    return value


def _head(value: Mapping[str, Any]) -> TreeHead:
    """A head in JSON; ValueError, TypeError or KeyError if it is not one."""
    origin, size, root = value["origin"], value["size"], bytes.fromhex(value["root"])
    if not isinstance(origin, str) or type(size) is not int or len(root) != HASH:
        raise ValueError("a head that is not one")
    return TreeHead(origin, size, root)
