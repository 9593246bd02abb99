"""Accepts receipts from robots, with limits for the work and the ledger lines of each robot.

A robot with a certificate may be under an attacker's control: a file of 1 MB can have 10,000
participants.
"""

from datetime import datetime
from pathlib import Path

from pqsec_pki.certificates import Certificate
from pqsec_pki.enrolment import ImportedReceipt, SignedReceipt, read_receipts, record_receipts
from pqsec_pki.keystore import RECEIPT, Keystore, Ledger
from pqsec_pki.server.requester import NotAdmittedError, refuse_many


def take_receipts(
    keystore: Keystore, holder: str, body: bytes, *, now: datetime
) -> list[ImportedReceipt]:
    """Enter the receipts in the ledger, one of which is of the participant `holder`.

    NotAdmittedError if none is, or for too many; other errors as of `record_receipts`.
    """
    with keystore.open_ledger() as ledger:

        def is_issued(name: str, certificate: Certificate, set_name: str) -> bool:
            lines = ledger.of(set_name).of_name("participant", name)
            return any(each.sha256 == certificate.fingerprint for each in lines)

        found = read_receipts(body, is_issued)
        if holder not in {each.receipt.participant for each in found}:
            raise NotAdmittedError(403, f"the receipt is not of {holder}")
        for each in found:
            _refuse_many(ledger, each, now)
    return record_receipts(keystore, [(Path("receipt"), body)], now=now)


def _refuse_many(ledger: Ledger, found: SignedReceipt, now: datetime) -> None:
    name = found.receipt.participant
    lines = ledger.of_name(RECEIPT, name)
    if all(each.sha256 != found.receipt.sha256 for each in lines):
        refuse_many(f"receipts of {name}", lines, now)
