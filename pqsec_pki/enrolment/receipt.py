"""Receipts: what a robot runs, signed with the keys of its participants.

A robot has one receipt: an archive that has, for each installed participant, its certificate and a
statement, which names the installed files by their SHA-256. The statement is S/MIME, like
governance and permissions, signed with the certificate's key; if the certificate has an alternative
key, that key countersigns. A receipt is evidence for a keystore, which knows the certificates of
each participant: `receipt_import.py`.
"""

import hashlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from typing import TypeAlias

from pqsec_pki import __version__
from pqsec_pki._dataclass import dataclass
from pqsec_pki.certificates import Certificate, common_name
from pqsec_pki.credentials import (
    ALT_KEY,
    CERTIFICATE,
    ENCLAVES,
    KEY,
    key_problems,
    only_certificate,
)
from pqsec_pki.enrolment.archive import Archive
from pqsec_pki.enrolment.trust import TrustState
from pqsec_pki.errors import MalformedError, PqsecError, VerificationError, shown
from pqsec_pki.keystore import PUBLIC_FILES, RECEIPT, Receipt, regular_name
from pqsec_pki.problems import Code, Problem
from pqsec_pki.smime import Signer, sign, verify
from pqsec_pki.tokens import Pin, key_in, stored_pin

STATEMENT = "receipt.p7s"
IsIssued: TypeAlias = Callable[[str, Certificate], bool]


@dataclass(frozen=True, slots=True)
class SignedReceipt:
    """A receipt that the holder of `certificate` signed. Who issued that is not verified here."""

    receipt: Receipt
    certificate: Certificate


def receipt_of(  # noqa: PLR0913 -- by name
    enclaves: Mapping[str, Mapping[str, bytes]],
    numbers: Mapping[str, int],
    trust: TrustState,
    *,
    installed_at: datetime,
    now: datetime,
    pin: Pin = stored_pin,
) -> bytes:
    """The receipt file for the installed `enclaves`, from bundles with these `numbers`.

    `trust` has the number of this receipt (`TrustState.with_next_receipt`), and is saved before it.
    `pin` gives the PIN of a token that has the keys. An enclave whose certificate or keys cannot
    be read, or do not match, is not in it.
    """
    files: dict[str, bytes] = {}
    for name, installed in enclaves.items():
        receipt = Receipt(
            participant=name,
            store=trust.store,
            number=trust.receipts,
            bundle=numbers.get(name),
            files={
                file: hashlib.sha256(data).hexdigest()
                for file, data in sorted(installed.items())
                if file in PUBLIC_FILES
            },
            installed_at=installed_at.astimezone(UTC).replace(microsecond=0),
            made_at=now.astimezone(UTC),
            pqsec=__version__,
        )
        with suppress(PqsecError, KeyError):
            statement = _signed(receipt, installed, pin)
            files[f"{ENCLAVES}{name}/{CERTIFICATE}"] = installed[CERTIFICATE]
            files[f"{ENCLAVES}{name}/{STATEMENT}"] = statement
    return Archive(RECEIPT, {}, files).pack()


def read_receipts(data: bytes, is_issued: IsIssued | None = None) -> tuple[SignedReceipt, ...]:
    """The receipts in the file `data`, each signed by the holder of the certificate beside it.

    MalformedError if it is not a receipt file. VerificationError, with everything that is wrong,
    for a signature that is not valid or missing, and for a receipt of another certificate.
    `is_issued` says whether a participant ever had that certificate. With it, reading ends at the
    first problem, so that the work is limited by the participants that the keystore knows.
    """
    archive = Archive.unpack(data, RECEIPT)
    if not archive.files:
        raise MalformedError("the receipt has no participants")
    found, problems = [], []
    for name in dict.fromkeys(map(_name_in, sorted(archive.files))):
        try:
            certificate, statement = (
                archive.files[f"{ENCLAVES}{name}/{file}"] for file in (CERTIFICATE, STATEMENT)
            )
        except KeyError:
            raise MalformedError(f"the receipt of {name} is incomplete") from None
        try:
            signer = only_certificate(certificate, CERTIFICATE)
            found.append(_verified(name, signer, statement, is_issued))
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


def _verified(
    name: str, certificate: Certificate, statement: bytes, is_issued: IsIssued | None
) -> SignedReceipt:
    """The receipt that `certificate`'s keys signed, all of them; VerificationError if not."""
    if is_issued and not is_issued(name, certificate):
        raise VerificationError("this keystore did not issue its certificate")
    second = certificate.with_alternative_key
    verified = verify(statement, certificate, alternative_ca=second, pinned=True)
    receipt = Receipt.from_json(verified.document)
    problems = []
    if name != receipt.participant or certificate.subject_der != common_name(name):
        words = f"a receipt of {receipt.participant}, signed by {certificate.subject_name}"
        problems.append(Problem(words, Code.WRONG_SUBJECT))
    # Else who keeps an old key could claim that the newest files are installed.
    if receipt.files.get(CERTIFICATE) != hashlib.sha256(certificate.pem).hexdigest():
        words = "the certificate that is installed is not the one that signed the receipt"
        problems.append(Problem(words, Code.WRONG_SIGNER))
    if problems:
        raise VerificationError(*problems)
    return SignedReceipt(receipt, certificate)


def _name_in(path: str) -> str:
    """The participant whose file is at `path` in the archive; MalformedError if there is none."""
    folder, _, file = path.rpartition("/")
    name = folder.removeprefix(ENCLAVES)
    with suppress(PqsecError):
        if file in {CERTIFICATE, STATEMENT} and folder == f"{ENCLAVES}{regular_name(name)}":
            return name
    raise MalformedError(f"a receipt must not contain {shown(path)}")
