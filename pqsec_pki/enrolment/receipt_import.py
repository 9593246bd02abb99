"""Record what robots run: verify their receipts against the ledger, and enter them there.

The ledger decides which participant a certificate was issued to, so a robot may still use one that
was renewed: its receipt then shows that the robot is outdated.

Receipts of one credential store are ordered by their numbers. Of two stores of a participant, one
replaced the other: the later one has the newer certificate. No clock orders receipts
(docs/explanation/adr/0035-robots-order-by-numbers.md).
"""

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import field
from datetime import datetime, timedelta
from pathlib import Path
from typing import Self, TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import read
from pqsec_pki._times import said
from pqsec_pki.certificates import Certificate
from pqsec_pki.enrolment.receipt import SignedReceipt, read_receipts
from pqsec_pki.enrolment.tarball import MAX_ARCHIVE
from pqsec_pki.errors import VerificationError, located
from pqsec_pki.keystore import (
    RECEIPT,
    Keystore,
    Ledger,
    Receipt,
    change,
    compromised_keys_in,
    key_hashes,
)
from pqsec_pki.problems import Code, Problem

MAX_AHEAD = timedelta(hours=1)
"""How far a robot's clock may be ahead before it is reported."""


@dataclass(frozen=True, slots=True)
class ImportedReceipt:
    """A receipt of one participant that is in the ledger now, or `revoked`."""

    receipt: Receipt
    path: Path
    already: bool
    """Whether it was recorded before, so that nothing was done."""
    revoked: bool = False
    """Whether it was not recorded: its certificate or key was revoked. The others of its file are
    recorded; otherwise a robot of several participants could send no receipt after one was
    revoked."""
    clock: str | None = None
    """What shows that the robot's clock was wrong; None if nothing does."""

    def to_json(self) -> dict[str, object]:
        """The receipt for --json."""
        return {
            "name": self.receipt.participant,
            "file": self.path,
            "already": self.already,
            "revoked": self.revoked,
            "bundle": self.receipt.bundle,
            "installed_at": self.receipt.installed_at,
            "made_at": self.receipt.made_at,
            "pqsec": self.receipt.pqsec,
            "store": self.receipt.store,
            "number": self.receipt.number,
            "clock": self.clock,
        }


def import_receipts(
    keystore: Keystore, paths: Iterable[Path], *, now: datetime, older: bool = False
) -> list[ImportedReceipt]:
    """Enter the receipts in the files `paths` in the ledger, all or none, oldest first.

    VerificationError, with everything that is wrong, for a receipt whose signature is not valid,
    for one by a certificate that this keystore did not issue to that participant, and, unless
    `older`, for one that is not newer than the newest recorded. One whose
    certificate was revoked, or whose key is compromised, is left out, and refused if its file has
    no other. MalformedError for a file that is not a receipt.
    """
    return record_receipts(keystore, map(_file, paths), now=now, older=older)


def record_receipts(
    keystore: Keystore,
    files: Iterable[tuple[Path, bytes]],
    *,
    now: datetime,
    older: bool = False,
) -> list[ImportedReceipt]:
    """Like `import_receipts`, with the content of each file; the paths are for messages."""
    found, problems = _read(files)
    with keystore.hold():
        with keystore.open_ledger() as ledger:
            records = _Records.of(keystore, ledger, found)
        done, entries = [], []
        kept = {path for path, signed in found if not records.is_revoked(signed)}
        for path, signed in found:
            revoked = path in kept and records.is_revoked(signed)
            already = not revoked and signed.receipt.sha256 in records.recorded
            clock = _wrong_clock(signed, now)
            done.append(ImportedReceipt(signed.receipt, path, already, revoked, clock))
            if revoked or already:
                continue
            wrong = list(records.problems(signed, older=older))
            problems += [each.of(f"{path}: {signed.receipt.participant}") for each in wrong]
            entries.append(signed.receipt.entry(signed.certificate, now))
            records.add(signed)
        if problems:
            raise VerificationError(*problems, hint=_hint(problems))
        if entries:
            with change(keystore.root) as transaction:
                transaction.record(*entries)
    return done


_Found: TypeAlias = tuple[Path, SignedReceipt]


@dataclass(frozen=True, slots=True)
class _Order:
    """The recorded receipts of one participant, as far as they decide which one is newer."""

    stores: dict[str, tuple[int, int]] = field(default_factory=dict)
    """By credential store, in the order in which each was last recorded: the number of its last
    receipt, and the largest sequence number of a certificate that signed one."""
    further: set[str] = field(default_factory=set)
    """The further sets of credentials that the newest receipt names."""

    def add(self, receipt: Receipt, certificate: int) -> None:
        """Record that `receipt` is the newest, signed with a certificate of that number."""
        _, before = self.stores.pop(receipt.store, (0, 0))
        self.stores[receipt.store] = receipt.number, max(before, certificate)
        self.further.clear()
        self.further.update(receipt.further)

    def older(self, receipt: Receipt, certificate: int) -> str | None:
        """Why `receipt`, signed with a certificate of that number, is not newer; None if it is.

        A rollback signs with an older certificate, so that of a store is the newest that it had.
        """
        number, before = self.stores.get(receipt.store, (0, 0))
        if receipt.number <= number:
            return f"receipt {receipt.number} of its store; receipt {number} is recorded"
        _, newest = next(reversed(self.stores.values()), (0, 0))
        if max(before, certificate) < newest:
            return "of a store with an older certificate than the one recorded last"
        if lacking := sorted(self.further.difference(receipt.further)):
            return f"it lacks the set of credentials {', '.join(lacking)}, which was installed"
        return None


@dataclass(frozen=True, slots=True)
class _Records:
    """The ledger's content by which pqsec accepts or refuses receipts."""

    issued: Mapping[str, str] = field(repr=False)
    """The participant, by the SHA-256 of its certificate."""
    sets: Mapping[str, Collection[str]] = field(repr=False)
    """SHA-256 of the certificates, by the set of credentials."""
    revoked: frozenset[str]
    compromised: frozenset[str]
    recorded: set[str]
    """SHA-256 of all receipts."""
    orders: Mapping[str, _Order]
    """By participant."""

    @classmethod
    def of(cls, keystore: Keystore, ledger: Ledger, found: Iterable[_Found]) -> Self:
        """`found` are the receipts to come, of whose participants the recorded ones are read."""
        orders = defaultdict[str, _Order](_Order)
        for name in {signed.receipt.participant for _, signed in found}:
            for each in ledger.of_name(RECEIPT, name):
                orders[name].add(Receipt.of(each), Receipt.certificate_number(each))
        ledgers = {each.set_name: ledger.of(each.set_name) for each in keystore.sets}
        return cls(
            issued=ledger.issued(),
            sets={name: each.numbers("participant") for name, each in ledgers.items()},
            revoked=frozenset(
                sha256 for each in ledgers.values() for sha256 in each.numbers("revocation")
            ),
            compromised=frozenset(compromised_keys_in(keystore.folder, ledger)),
            recorded=set(ledger.numbers(RECEIPT)),
            orders=orders,
        )

    def add(self, signed: SignedReceipt) -> None:
        self.recorded.add(signed.receipt.sha256)
        number = signed.certificate.number or 0
        self.orders[signed.receipt.participant].add(signed.receipt, number)

    def is_revoked(self, signed: SignedReceipt) -> bool:
        """Whether a certificate that signed was revoked, or its key as compromised."""
        return any(self._why_revoked(each) for each in signed.certificates.values())

    def _why_revoked(self, certificate: Certificate) -> str | None:
        if certificate.fingerprint in self.revoked:
            return "its certificate was revoked"
        keys = key_hashes(certificate.public_key, certificate.alternative_key).split()
        if not self.compromised.isdisjoint(keys):
            return "its key was revoked as compromised"
        return None

    def problems(self, signed: SignedReceipt, *, older: bool) -> Iterator[Problem]:
        receipt, certificate = signed.receipt, signed.certificate
        for name, each in signed.certificates.items():
            if not self._is_issued(receipt.participant, each, name):
                words = "this keystore did not issue the certificate that signed the receipt"
                yield Problem(words, Code.NOT_ISSUED, f"set {name}" if name else "")
            elif why := self._why_revoked(each):
                yield Problem(why, Code.REVOKED, f"set {name}" if name else "")
        order = self.orders[receipt.participant]
        if not older and (why := order.older(receipt, certificate.number or 0)):
            yield Problem(why, Code.OLDER)

    def _is_issued(self, name: str, certificate: Certificate, set_name: str) -> bool:
        fingerprint = certificate.fingerprint
        return self.issued.get(fingerprint) == name and fingerprint in self.sets.get(set_name, ())


def _file(path: Path) -> tuple[Path, bytes]:
    with located(path):
        return path, read(path, limit=MAX_ARCHIVE)


def _read(files: Iterable[tuple[Path, bytes]]) -> tuple[list[_Found], list[Problem]]:
    """The receipts in the files, oldest first, and what is wrong with their signatures."""
    found: list[_Found] = []
    problems: list[Problem] = []
    for path, data in files:
        try:
            with located(path):
                found += [(path, each) for each in read_receipts(data)]
        except VerificationError as error:
            problems += [each.of(str(path)) for each in error.problems]
    return _sorted(found), problems


def _sorted(found: Iterable[_Found]) -> list[_Found]:
    """Oldest first: each with the newest certificate that its store had until then."""
    newest, placed = dict[tuple[str, str], int](), []
    for path, signed in sorted(found, key=lambda each: each[1].receipt.number):
        receipt = signed.receipt
        key = receipt.participant, receipt.store
        newest[key] = max(newest.get(key, 0), signed.certificate.number or 0)
        placed.append((newest[key], receipt.store, receipt.number, (path, signed)))
    return [each for *_, each in sorted(placed, key=lambda one: one[:3])]


def _wrong_clock(signed: SignedReceipt, now: datetime) -> str | None:
    """What the times of a receipt, which order nothing, show of the robot's clock."""
    made_at = signed.receipt.made_at
    if made_at > now + MAX_AHEAD:
        why = "which is in the future by this clock"
    elif made_at < signed.certificate.not_before <= now:  # else the CA's clock was ahead
        why = "before its certificate began"
    else:
        return None
    return f"made at {said(made_at)}, {why}: check the robot's clock"


def _hint(problems: Sequence[Problem]) -> str | None:
    if {each.code for each in problems} == {Code.OLDER}:
        return "--older records it anyway, if the robot was restored from a backup"
    return "nothing was recorded; `pqsec install` on the robot makes a receipt again"
