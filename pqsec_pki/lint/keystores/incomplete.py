"""Rules about what could not be checked: unreadable files, incomplete keystores."""

from collections.abc import Iterator
from contextlib import suppress

from pqsec_pki.errors import PqsecError
from pqsec_pki.keystore import SETTINGS, faults_of_ledger, layout, older_copies
from pqsec_pki.lint.file import File
from pqsec_pki.lint.rule import Severity, Violation, lint_rule
from pqsec_pki.lint.subjects import Inventory

UNREAD = "PQS001"


@lint_rule(
    UNREAD, Severity.WARNING, "a file could not be read",
    why="A file that cannot be read is not checked and may be wrong. The check is then incomplete."
    " The exception is a keystore's private/, which others are not meant to read.",
    fix="Run the check as the owner of the files, or do not include the file.",
    bad="$ truncate -s 100M k/governance-old.xml",
    good="$ rm k/governance-old.xml",
)  # fmt: skip
def unreadable(file: File) -> Iterator[Violation]:
    if file.unreadable:
        yield Violation(f"was not checked, because it cannot be read: {file.unreadable}")


@lint_rule(
    "PQS006", Severity.WARNING, "a change of the keystore was interrupted",
    why="A command was killed while it moved files into place, so the keystore is in an"
    " intermediate state. The check changes nothing and does not finish the change.",
    fix="Run `pqsec ca recover` on the keystore to finish the change, and check again.",
    bad="""
        $ mkdir k/.journal
        $ echo '{"targets": [], "entries": []}' > k/.journal/moves.json
    """,
    good="$ pqsec -k k ca recover",
)  # fmt: skip
def interrupted_change(inventory: Inventory) -> Iterator[Violation]:
    if inventory.interrupted_change:
        yield Violation(
            "a change of the keystore was not finished: `pqsec ca recover` finishes it",
            path=inventory.interrupted_change,
        )


@lint_rule(
    "PQS008", Severity.ERROR, "the ledger is not the one that the CAs signed",
    why="The ledger is shorter than the newest head that the CAs signed, or has other lines:"
    " somebody cut its end, rewrote it, or restored an older copy. What is gone may be revocations,"
    " or the rule about approvals, so commands refuse to decide by it.",
    fix="Restore the ledger that fits. If it is lost, `pqsec log --verify` shows since when;"
    " remove public/ledger.checkpoint to go on without it, and then revoke what it no longer has:"
    " `pqsec revoke --certificate FILE`.",
    bad="""
        $ mkdir ledgers
        $ cp -p k/private/ledger.sqlite3 ledgers/older
        $ pqsec -k k issue /third --publish chatter
        $ mv k/private/ledger.sqlite3 ledgers/newer
        $ mv ledgers/older k/private/ledger.sqlite3
    """,
    good="$ mv ledgers/newer k/private/ledger.sqlite3",
)  # fmt: skip
def other_ledger(inventory: Inventory) -> Iterator[Violation]:
    if not inventory.keystore:
        return
    with suppress(PqsecError):  # private/ is not for everybody to read
        for fault in faults_of_ledger(inventory.keystore):
            yield Violation(fault, path=inventory.keystore.root / SETTINGS)


@lint_rule(
    "PQS009", Severity.ERROR, "a file of the keystore is older than the ledger's newest",
    why="The ledger has a newer list, governance or certificate: somebody put an earlier copy back."
    " Its signature is valid, but an old list lacks revocations, and old documents have rights that"
    " were taken away. `pqsec bundle` and `pqsec export` refuse it; a copy of an enclave has it.",
    fix="Restore the newest one from a backup, or make the next: `pqsec ca crl`, `pqsec apply` or"
    " `pqsec sign-governance`, `pqsec issue NAME --force`. If another machine uses this ledger,"
    " `pqsec ca recover` gets it.",
    bad="""
        $ pqsec -k k ca crl
        $ cp -p k/public/identity_ca.crl.pem older
        $ pqsec -k k ca crl
        $ mv older k/public/identity_ca.crl.pem
    """,
    good="$ pqsec -k k ca crl",
)  # fmt: skip
def older_copy(inventory: Inventory) -> Iterator[Violation]:
    keystore = inventory.keystore
    if not keystore:
        return
    of_all = {keystore.folder / each for each in (layout.PUBLIC, layout.ENCLAVES)}
    with suppress(PqsecError):  # private/ is not for everybody to read
        for path in older_copies(keystore):
            # with other machines, those of one participant are where they were made
            if not keystore.ledger_address or path.parent in of_all:
                yield Violation("the ledger has a newer one", path=path)


@lint_rule(
    "PQS007", Severity.WARNING, "a part of the keystore is missing",
    why="Without pqsec.json, or without private/ and its ledger, the keystore is checked like any"
    " other folder. Its profile and the record of issued and revoked certificates are not used."
    " Issuing, renewing and revoking do not work either.",
    fix="Restore the missing files from a backup. Robots do not need these files: copy their"
    " enclaves (cp -rL), or use `pqsec bundle`.",
    bad="""
        $ mkdir backup
        $ mv k/pqsec.json backup
    """,
    good="$ mv backup/pqsec.json k",
)  # fmt: skip
def missing_parts(inventory: Inventory) -> Iterator[Violation]:
    for root, missing in inventory.missing_parts.items():
        words = f"the keystore lacks {', '.join(missing)}"
        yield Violation(f"{words}: the rules that need it were not checked", path=root)
