"""Record what robots run: verify their receipts against the ledger, and enter them there.

The ledger decides which participant a certificate was issued to, so a robot may still use one that
was renewed: its receipt then shows that the robot is outdated.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import field
from datetime import datetime, timedelta
from pathlib import Path
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import read
from pqsec_pki._times import exact
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
"""How far a robot's clock may be ahead. A receipt from far in the future would make all later ones
seem older."""


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
        }


def import_receipts(
    keystore: Keystore, paths: Iterable[Path], *, now: datetime, older: bool = False
) -> list[ImportedReceipt]:
    """Enter the receipts in the files `paths` in the ledger, all or none, oldest first.

    VerificationError, with everything that is wrong, for a receipt whose signature is not valid,
    for one by a certificate that this keystore did not issue to that participant, for one from the
    future, and, unless `older`, for one that is not newer than the newest recorded. One whose
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
            records = _Records.of(keystore, ledger)
        done, entries = [], []
        kept = {path for path, signed in found if not records.is_revoked(signed)}
        for path, signed in found:
            if path in kept and records.is_revoked(signed):
                done.append(ImportedReceipt(signed.receipt, path, already=False, revoked=True))
                continue
            already = signed.receipt.sha256 in records.recorded
            done.append(ImportedReceipt(signed.receipt, path, already))
            if already:
                continue
            wrong = list(records.problems(signed, now, older=older))
            problems += [each.of(f"{path}: {signed.receipt.participant}") for each in wrong]
            entries.append(signed.receipt.entry(signed.certificate, now))
            records.add(signed.receipt)
        if problems:
            raise VerificationError(*problems, hint=_hint(problems))
        if entries:
            with change(keystore.root) as transaction:
                transaction.record(*entries)
    return done


@dataclass(frozen=True, slots=True)
class _Records:
    """The ledger's content by which pqsec accepts or refuses receipts."""

    issued: Mapping[str, str] = field(repr=False)
    """The participant, by the SHA-256 of its certificate."""
    revoked: frozenset[str]
    compromised: frozenset[str]
    recorded: set[str]
    """SHA-256 of all receipts."""
    newest: dict[str, datetime]
    """The time at which each participant made its newest receipt."""

    @classmethod
    def of(cls, keystore: Keystore, ledger: Ledger) -> Self:
        return cls(
            issued=ledger.issued(),
            revoked=frozenset(ledger.numbers("revocation")),
            compromised=frozenset(compromised_keys_in(keystore.root, ledger)),
            recorded=set(ledger.numbers(RECEIPT)),
            newest={each.name: Receipt.of(each).made_at for each in ledger.newest(RECEIPT)},
        )

    def add(self, receipt: Receipt) -> None:
        self.recorded.add(receipt.sha256)
        self.newest[receipt.participant] = receipt.made_at

    def is_revoked(self, signed: SignedReceipt) -> bool:
        """Whether the certificate that signed was revoked, or its key as compromised."""
        certificate = signed.certificate
        keys = key_hashes(certificate.public_key, certificate.alternative_key).split()
        return certificate.fingerprint in self.revoked or not self.compromised.isdisjoint(keys)

    def problems(self, signed: SignedReceipt, now: datetime, *, older: bool) -> Iterator[Problem]:
        receipt, certificate = signed.receipt, signed.certificate
        keys = key_hashes(certificate.public_key, certificate.alternative_key).split()
        made_at = exact(receipt.made_at)
        if self.issued.get(certificate.fingerprint) != receipt.participant:
            words = "this keystore did not issue the certificate that signed the receipt"
            yield Problem(words, Code.NOT_ISSUED)
        elif certificate.fingerprint in self.revoked:
            yield Problem("its certificate was revoked", Code.REVOKED)
        elif not self.compromised.isdisjoint(keys):
            yield Problem("its key was revoked as compromised", Code.REVOKED)
        if receipt.made_at > now + MAX_AHEAD:
            words = f"made at {made_at}, which is in the future: check the robot's clock"
            yield Problem(words, Code.NOT_YET_VALID)
        if receipt.installed_at > receipt.made_at:
            words = f"made at {made_at}, before it was installed: no pqsec makes such a receipt"
            yield Problem(words, Code.NOT_YET_VALID)
        newest = self.newest.get(receipt.participant)
        if newest and receipt.made_at <= newest and not older:
            words = f"made at {made_at}; one of {exact(newest)} is recorded"
            yield Problem(words, Code.OLDER)


def _file(path: Path) -> tuple[Path, bytes]:
    with located(path):
        return path, read(path, limit=MAX_ARCHIVE)


def _read(
    files: Iterable[tuple[Path, bytes]],
) -> tuple[list[tuple[Path, SignedReceipt]], list[Problem]]:
    """The receipts in the files, oldest first, and what is wrong with their signatures."""
    found: list[tuple[Path, SignedReceipt]] = []
    problems: list[Problem] = []
    for path, data in files:
        try:
            with located(path):
                found += [(path, each) for each in read_receipts(data)]
        except VerificationError as error:
            problems += [each.of(str(path)) for each in error.problems]
    return sorted(found, key=lambda each: each[1].receipt.made_at), problems


def _hint(problems: Sequence[Problem]) -> str | None:
    if {each.code for each in problems} == {Code.OLDER}:
        return "--older records it anyway, if the robot's clock was wrong"
    return "nothing was recorded; `pqsec install` on the robot makes a receipt again"
