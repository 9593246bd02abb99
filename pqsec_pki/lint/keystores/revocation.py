"""Rules about what a revocation did not end yet: robots without the list, earlier certificates."""

from collections.abc import Iterator, Sequence
from contextlib import suppress

from pqsec_pki._times import said
from pqsec_pki.errors import PqsecError
from pqsec_pki.keystore import (
    Entry,
    ListDelivery,
    layout,
    list_delivery,
    superseded_certificates,
)
from pqsec_pki.lint.rule import Severity, Violation, lint_rule
from pqsec_pki.lint.subjects import Inventory

_BY_RECEIPT = (
    "`pqsec receipt import` records what a robot installed. If yours send no receipts and all have"
    " the list, ignore the finding with that reason."
)


@lint_rule(
    "PQS351", Severity.WARNING, "robots may still accept a revoked certificate",
    why="A robot refuses a revoked certificate only if its own revocation list has it. By their"
    " receipts these robots do not have the newest list, or they sent none: whoever has the revoked"
    " key may still command them.",
    fix="Bring the list to them: `pqsec status` has the commands. " + _BY_RECEIPT,
    bad="$ pqsec -k k revoke /talker --yes",
    good="""
        $ pqsec -k k bundle /listener --plain-key -o listener.bundle
        $ pqsec install listener.bundle --dir robot --trust-first
        $ pqsec -k k receipt import robot/installed.receipt
    """,
)  # fmt: skip
def revoked_and_accepted(inventory: Inventory) -> Iterator[Violation]:
    keystore, found = inventory.keystore, _delivery(inventory)
    if keystore and found and found.accepted:
        words = f"{found}: {found.names}; {found.danger}"
        yield Violation(words, path=keystore.revocation_list_path)


@lint_rule(
    "PQS352", Severity.INFO, "robots do not have the newest revocation list",
    why="They refuse what is revoked. But a stack refuses every peer when its own list has ended,"
    " and the newest list ends later.",
    fix="Bring the list to them: `pqsec status` has the commands. " + _BY_RECEIPT,
    bad="$ pqsec -k k ca crl",
    good="""
        $ pqsec -k k bundle /talker /listener --plain-key -o both.bundle
        $ pqsec install both.bundle --dir robot --trust-first
        $ pqsec -k k receipt import robot/installed.receipt
    """,
)  # fmt: skip
def list_not_delivered(inventory: Inventory) -> Iterator[Violation]:
    keystore, found = inventory.keystore, _delivery(inventory)
    if keystore and found and found.late and not found.accepted:
        yield Violation(f"{found}: {found.names}", path=keystore.revocation_list_path)


@lint_rule(
    "PQS353", Severity.INFO, "a certificate that was replaced is still valid",
    why="A renewal or a replacement does not end the certificate before. Other participants accept"
    " whoever has its key until it expires, such as the thief of a robot that was replaced.",
    fix="If nobody needs it any more, run `pqsec revoke NAME --superseded`: it revokes those before"
    " the current certificate, and not that.",
    bad="$ pqsec -k k renew /talker",
    good="$ pqsec -k k revoke /talker --superseded --yes",
)  # fmt: skip
def superseded_and_valid(inventory: Inventory) -> Iterator[Violation]:
    keystore = inventory.keystore
    if not keystore:
        return
    with suppress(PqsecError):  # private/ is not for everybody to read
        for name, entries in superseded_certificates(keystore, now=inventory.now).items():
            for each in keystore.sets:
                if own := [entry for entry in entries if entry.set_name == each.set_name]:
                    place = each.folder / layout.enclave_folder(name)
                    yield Violation(_superseded(name, own), path=place)


def _superseded(name: str, entries: Sequence[Entry]) -> str:
    last = max(each.ends for each in entries)
    count = f"{len(entries)} certificate{'s' if len(entries) > 1 else ''}"
    return f"{count} before the current one of {name} can be used until {said(last)}"


def _delivery(inventory: Inventory) -> ListDelivery | None:
    """How far the newest lists got; None without a list, or a readable ledger."""
    with suppress(PqsecError):
        return list_delivery(inventory.keystore, now=inventory.now) if inventory.keystore else None
    return None
