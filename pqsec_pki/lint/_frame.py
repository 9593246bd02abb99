"""Rules about the check itself: unreadable files, suppressions, incomplete keystores."""

from collections.abc import Iterator

from pqsec_pki.lint.file import File
from pqsec_pki.lint.rule import Family, Severity, Violation
from pqsec_pki.lint.subjects import Inventory
from pqsec_pki.lint.suppress import SuppressionFile

FAMILY = Family("frame")
UNREAD = "PQS001"


@FAMILY.rule(
    UNREAD, Severity.WARNING, File, "a file could not be read",
    why="A file that cannot be read is not checked and may be wrong. The check is then incomplete."
    " The exception is a keystore's private/, which others are not meant to read.",
    fix="Run the check as the owner of the files, or do not include the file.",
)  # fmt: skip
def unreadable(file: File) -> Iterator[Violation]:
    if file.unreadable:
        yield Violation(f"was not checked, because it cannot be read: {file.unreadable}")


@FAMILY.rule(
    "PQS002", Severity.ERROR, SuppressionFile, "a suppression gives no reason",
    why="Without a reason, a later reader cannot tell whether the finding is still accepted. The"
    " suppression is not applied.",
    fix="Add `reason:` to the entry: who decided, and why it is safe.",
)  # fmt: skip
def without_reason(file: SuppressionFile) -> Iterator[Violation]:
    for entry in file.entries:
        if not entry.reason:
            yield Violation(f"the suppression of {entry.rule} gives no reason", entry.line)


@FAMILY.rule(
    "PQS003", Severity.WARNING, SuppressionFile, "a suppression has expired",
    why="The date in `until:` has passed. The suppression is no longer applied.",
    fix="Fix the finding that it suppressed, or decide again and set a later date.",
)  # fmt: skip
def run_out(file: SuppressionFile) -> Iterator[Violation]:
    for entry in file.entries:
        if entry.is_over(file.today):
            yield Violation(f"the suppression of {entry.rule} expired on {entry.until}", entry.line)


@FAMILY.rule(
    "PQS004", Severity.WARNING, SuppressionFile, "a suppression is unused",
    why="No finding matches it. It would hide the problem if it came back.",
    fix="Remove the entry.",
)  # fmt: skip
def unused(file: SuppressionFile) -> Iterator[Violation]:
    for entry in file.entries if file.is_complete else ():
        holds = entry.reason and not entry.is_over(file.today) and entry.rule in file.asked
        if holds and not entry.used:
            yield Violation(f"the suppression of {entry.rule} matches no finding", entry.line)


@FAMILY.rule(
    "PQS005", Severity.ERROR, SuppressionFile, "a suppression is invalid",
    why="The entry does not suppress what it was meant to suppress, or it suppresses another rule.",
    fix="Write entries with rule and reason, and optionally path and until.",
)  # fmt: skip
def not_understood(file: SuppressionFile) -> Iterator[Violation]:
    yield from file.broken
    for entry in file.entries:
        if entry.rule not in file.known:
            yield Violation(f"there is no rule {entry.rule}", entry.line)


@FAMILY.rule(
    "PQS006", Severity.WARNING, Inventory, "a change of the keystore was interrupted",
    why="A command was killed while it moved files into place, so the keystore is in an"
    " intermediate state. The check changes nothing and does not finish the change.",
    fix="Run `pqsec ca recover` on the keystore to finish the change, and check again.",
)  # fmt: skip
def cut_off(inventory: Inventory) -> Iterator[Violation]:
    if inventory.cut_off:
        yield Violation("a change of the keystore was not finished", path=inventory.cut_off)


@FAMILY.rule(
    "PQS007", Severity.WARNING, Inventory, "a part of the keystore is missing",
    why="Without pqsec.json, or without private/ and its ledger, the keystore is checked like any"
    " other folder. Its profile and the record of issued and revoked certificates are not used."
    " Issuing, renewing and revoking do not work either.",
    fix="Restore the missing files from a backup. Robots do not need these files: copy their"
    " enclaves (cp -rL), or use `pqsec bundle`.",
)  # fmt: skip
def lacks(inventory: Inventory) -> Iterator[Violation]:
    for root, lost in inventory.lost.items():
        words = f"the keystore lacks {', '.join(lost)}"
        yield Violation(f"{words}: the rules that need it were not checked", path=root)
