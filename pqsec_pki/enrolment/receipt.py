"""Receipts: what a robot runs, signed with the keys of its participants.

A robot has one receipt: an archive that has, for each installed participant, its certificate of
each set and a statement, which names the installed files of all sets by their SHA-256. The
statement is S/MIME, like governance and permissions, and signed once with the key of each
certificate; if a certificate has an alternative key, that key countersigns. A receipt is evidence
for a keystore, which knows the certificates of each participant: `receipt_import.py`.
"""

import hashlib
from collections import defaultdict
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import field
from datetime import UTC, datetime
from typing import TypeAlias

from pqsec_pki import __version__
from pqsec_pki._dataclass import dataclass
from pqsec_pki.certificates import Certificate, common_name
from pqsec_pki.credentials import (
    ALT_KEY,
    CERTIFICATE,
    KEY,
    key_problems,
    only_certificate,
)
from pqsec_pki.enrolment.archive import Archive
from pqsec_pki.enrolment.bundle import Enclaves, parts_of
from pqsec_pki.enrolment.pins import set_named
from pqsec_pki.enrolment.trust import TrustState
from pqsec_pki.errors import MalformedError, PqsecError, VerificationError, shown
from pqsec_pki.keystore import PUBLIC_FILES, RECEIPT, Receipt, layout, regular_name
from pqsec_pki.problems import Code, Problem
from pqsec_pki.smime import Signer, sign, verify
from pqsec_pki.tokens import Pin, key_in, stored_pin

STATEMENT = "receipt.p7s"
IsIssued: TypeAlias = Callable[[str, Certificate, str], bool]
"""Whether the participant of that name ever had the certificate in that set."""


@dataclass(frozen=True, slots=True)
class SignedReceipt:
    """A receipt that the holder of `certificate` signed. Who issued that is not verified here."""

    receipt: Receipt
    certificate: Certificate
    """That of the first set."""
    further: Mapping[str, Certificate] = field(default_factory=dict)
    """Those of further sets, whose holder signed it too."""

    @property
    def certificates(self) -> dict[str, Certificate]:
        """Those of all sets."""
        return {layout.FIRST: self.certificate, **self.further}


def receipt_of(  # noqa: PLR0913 -- by name
    sets: Mapping[str, Enclaves],
    numbers: Mapping[str, int],
    trust: TrustState,
    *,
    installed_at: datetime,
    now: datetime,
    pin: Pin = stored_pin,
) -> bytes:
    """The receipt file for the installed enclaves of all sets, from bundles with these `numbers`.

    `trust` has the number of this receipt (`TrustState.with_next_receipt`), and is saved before it.
    `pin` gives the PIN of a token that has the keys. A participant whose certificate or keys cannot
    be read, or do not match, in one of the sets, is not in it.
    """
    files: dict[str, bytes] = {}
    for name in sets[layout.FIRST]:
        installed = {place: each.get(name, {}) for place, each in sets.items()}
        receipt = Receipt(
            participant=name,
            store=trust.store,
            number=trust.receipts,
            bundle=numbers.get(name),
            files={
                layout.in_set(place, file): hashlib.sha256(data).hexdigest()
                for place, own in installed.items()
                for file, data in sorted(own.items())
                if file in PUBLIC_FILES
            },
            installed_at=installed_at.astimezone(UTC).replace(microsecond=0),
            made_at=now.astimezone(UTC),
            pqsec=__version__,
        )
        with suppress(PqsecError, KeyError):
            signed = {
                _place(name, place, file): data
                for place, own in installed.items()
                for file, data in (
                    (CERTIFICATE, own[CERTIFICATE]),
                    (STATEMENT, _signed(receipt, own, pin)),
                )
            }
            files |= signed
    return Archive(RECEIPT, {}, files).pack()


def read_receipts(data: bytes, is_issued: IsIssued | None = None) -> tuple[SignedReceipt, ...]:
    """The receipts in the file `data`, each signed by the holder of the certificates beside it.

    MalformedError if it is not a receipt file. VerificationError, with everything that is wrong,
    for a signature that is not valid or missing, in each set of which the receipt names files, and
    for a receipt of another certificate.
    `is_issued` says whether a participant ever had that certificate. With it, reading ends at the
    first problem, so that the work is limited by the participants that the keystore knows.
    """
    archive = Archive.unpack(data, RECEIPT)
    if not archive.files:
        raise MalformedError("the receipt has no participants")
    sets = defaultdict[str, set[str]](set)
    for path in archive.files:
        place, name = _parts(path)
        sets[name].add(place)
    found, problems = [], []
    for name in sorted(sets):
        try:
            signed = {
                place: [
                    archive.files[_place(name, place, file)] for file in (CERTIFICATE, STATEMENT)
                ]
                for place in sorted({layout.FIRST, *sets[name]})
            }
        except KeyError:
            raise MalformedError(f"the receipt of {name} is incomplete") from None
        try:
            found.append(_of_all(name, signed, is_issued))
        except VerificationError as error:
            problems += [each.of(name) for each in error.problems]
            if is_issued:
                break
    if problems:
        raise VerificationError(*problems, hint="make it again: `pqsec install` on the robot")
    return tuple(found)


def _signed(receipt: Receipt, files: Mapping[str, bytes], pin: Pin) -> bytes:
    certificate = only_certificate(files[CERTIFICATE], CERTIFICATE)
    key = key_in(files[KEY], pin=pin)
    second = key_in(files[ALT_KEY], pin=pin) if ALT_KEY in files else None
    if problems := list(key_problems(certificate, key, second)):
        raise VerificationError(*problems)
    return sign(
        receipt.to_json(),
        Signer(certificate, key),
        countersigner=Signer(certificate, second) if second else None,
        embed_certificate=False,
        now=receipt.made_at,
    )


def _of_all(
    name: str, signed: Mapping[str, list[bytes]], is_issued: IsIssued | None
) -> SignedReceipt:
    """The receipt that all keys of a participant signed, by the certificate and the statement of
    each set; VerificationError if one did not sign it."""
    certificates = {place: only_certificate(each[0], CERTIFICATE) for place, each in signed.items()}
    receipts = {
        place: _verified(name, place, certificates[place], each[1], is_issued)
        for place, each in signed.items()
    }
    receipt = receipts[layout.FIRST]
    problems = [
        Problem(f"the key of the set {each} did not sign it", Code.SIGNATURE_MISSING)
        for each in receipt.further
        if each not in receipts
    ]
    if any(each != receipt for each in receipts.values()):
        problems.append(Problem("the sets have different receipts", Code.CONTENT_CHANGED))
    if problems:
        raise VerificationError(*problems)
    return SignedReceipt(receipt, certificates.pop(layout.FIRST), certificates)


def _verified(
    name: str,
    place: str,
    certificate: Certificate,
    statement: bytes,
    is_issued: IsIssued | None,
) -> Receipt:
    """The receipt that `certificate`'s keys signed, all of them; VerificationError if not."""
    if is_issued and not is_issued(name, certificate, place):
        raise VerificationError("this keystore did not issue its certificate")
    second = certificate.with_alternative_key
    verified = verify(statement, certificate, alternative_ca=second, pinned=True)
    receipt = Receipt.from_json(verified.document)
    problems = []
    if name != receipt.participant or certificate.subject_der != common_name(name):
        words = f"a receipt of {receipt.participant}, signed by {certificate.subject_name}"
        problems.append(Problem(words, Code.WRONG_SUBJECT))
    # Else who keeps an old key could claim that the newest files are installed.
    if (
        receipt.files.get(layout.in_set(place, CERTIFICATE))
        != hashlib.sha256(certificate.pem).hexdigest()
    ):
        words = "the certificate that is installed is not the one that signed the receipt"
        problems.append(Problem(words, Code.WRONG_SIGNER))
    if problems:
        raise VerificationError(*problems)
    return receipt


def _place(name: str, place: str, file: str) -> str:
    """The path in the archive of a participant's file of that set."""
    return layout.in_set(place, f"{layout.enclave_folder(name)}/{file}")


def _parts(path: str) -> tuple[str, str]:
    """The set and the participant whose file is at `path` in the archive.

    MalformedError if there is none.
    """
    with suppress(PqsecError):
        place, name, file = parts_of(path)
        is_known = place == layout.FIRST or set_named(place) == place
        if is_known and file in {CERTIFICATE, STATEMENT} and regular_name(name) == name:
            return place, name
    raise MalformedError(f"a receipt must not contain {shown(path)}")
