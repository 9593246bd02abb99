"""Rules about the check itself: files it could not read, and suppressions."""

from collections.abc import Iterator

from pqsec_pki.lint.file import File
from pqsec_pki.lint.rule import Family, Severity, Violation
from pqsec_pki.lint.subjects import Inventory
from pqsec_pki.lint.suppress import SuppressionFile

FAMILY = Family("frame")
UNREAD = "PQS001"


@FAMILY.rule(
    UNREAD, Severity.WARNING, File, "a file could not be read",
    why="What cannot be read is not checked, and may be wrong. The check is incomplete, unless"
    " that is a keystore's private/, which is closed to others.",
    fix="Run the check as the owner of the files, or leave the file out.",
)  # fmt: skip
def unreadable(file: File) -> Iterator[Violation]:
    if file.unreadable:
        yield Violation(f"cannot be read, so it was not checked: {file.unreadable}")


@FAMILY.rule(
    "PQS002", Severity.ERROR, SuppressionFile, "a suppression gives no reason",
    why="Whoever comes later cannot tell whether the finding may still stay. It is not applied.",
    fix="Write `reason:` beside it: who decided, and why it is safe.",
)  # fmt: skip
def without_reason(file: SuppressionFile) -> Iterator[Violation]:
    for entry in file.entries:
        if not entry.reason:
            yield Violation(f"the suppression of {entry.rule} gives no reason", entry.line)


@FAMILY.rule(
    "PQS003", Severity.WARNING, SuppressionFile, "a suppression has run out",
    why="Its `until:` has passed. It is not applied any more.",
    fix="Mend what it hid, or decide again and write a later day.",
)  # fmt: skip
def run_out(file: SuppressionFile) -> Iterator[Violation]:
    for entry in file.entries:
        if entry.is_over(file.today):
            yield Violation(f"the suppression of {entry.rule} ended on {entry.until}", entry.line)


@FAMILY.rule(
    "PQS004", Severity.WARNING, SuppressionFile, "a suppression is not needed",
    why="It would hide the flaw when it comes back.",
    fix="Take the entry out.",
)  # fmt: skip
def unused(file: SuppressionFile) -> Iterator[Violation]:
    for entry in file.entries if file.is_complete else ():
        holds = entry.reason and not entry.is_over(file.today) and entry.rule in file.asked
        if holds and not entry.used:
            yield Violation(f"the suppression of {entry.rule} is not needed any more", entry.line)


@FAMILY.rule(
    "PQS005", Severity.ERROR, SuppressionFile, "a suppression cannot be understood",
    why="What was meant to be suppressed is not, or another rule is.",
    fix="Write entries with rule, reason and, where wanted, path and until.",
)  # fmt: skip
def not_understood(file: SuppressionFile) -> Iterator[Violation]:
    yield from file.broken
    for entry in file.entries:
        if entry.rule not in file.known:
            yield Violation(f"there is no rule {entry.rule}", entry.line)


@FAMILY.rule(
    "PQS006", Severity.WARNING, Inventory, "a change of the keystore was cut off",
    why="A command was killed while it moved files into place: what is here is not what it"
    " wanted. The check changes nothing, so it does not finish it either.",
    fix="Run `pqsec ca recover` on the keystore, which finishes it, and check again.",
)  # fmt: skip
def cut_off(inventory: Inventory) -> Iterator[Violation]:
    if inventory.cut_off:
        yield Violation("a change of the keystore was not finished", path=inventory.cut_off)


@FAMILY.rule(
    "PQS007", Severity.WARNING, Inventory, "a keystore lacks a part of what pqsec put there",
    why="Without pqsec.json, or without private/ and its ledger, it is looked at like any folder:"
    " against no profile, and without what was issued and revoked there. Nobody can issue, renew"
    " or revoke in it either.",
    fix="Restore what is missing from a backup. A copy for robots needs none of it: copy their"
    " enclaves (cp -rL), or use `pqsec bundle`.",
)  # fmt: skip
def lacks(inventory: Inventory) -> Iterator[Violation]:
    for root, lost in inventory.lost.items():
        words = f"a keystore of pqsec's that lacks {', '.join(lost)}"
        yield Violation(f"{words}: what that tells was not checked", path=root)
