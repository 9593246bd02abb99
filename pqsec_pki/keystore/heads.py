"""The signed head of the ledger's tree: made with each change, and checked.

A change with the permissions CA's keys at hand signs a head over its own lines and those since the
last head.
Beside the head are the roots of the complete subtrees, so that no older line is read again.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import exists, read
from pqsec_pki.algorithms import PublicKey, load_public_key
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import (
    KeystoreError,
    MalformedError,
    MissingError,
    PqsecError,
    VerificationError,
    located,
)
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._ledger import Ledger
from pqsec_pki.keystore._lock import at_rest
from pqsec_pki.keystore._settings import read_ledger, set_names
from pqsec_pki.keystore.participant import load_first_certificate
from pqsec_pki.problems import Code
from pqsec_pki.transparency import Checkpoint, CompactRange, TreeHead, leaf_of

if TYPE_CHECKING:
    from pqsec_pki.keystore.authorities import Authorities

MAX_TREE = 16 << 10
"""Bytes; 63 hashes take 5 kB."""
_WAY_OUT = (
    "restore the ledger that has these lines: they may be revocations, or the rule of approvals;"
    " `pqsec log --verify` says more, and docs/how-to/anchors.md how to go on without that ledger"
)


@dataclass(slots=True)
class SeenLedger:
    """The state of a ledger after a read, for later reads: a ledger only gets new lines."""

    size: int = 0
    chain: str = ""
    """The chain value of line `size`."""
    signed: CompactRange = CompactRange()
    """The lines of which the newest head was signed."""

    def refuse_less(self, root: Path, ledger: Ledger) -> None:
        """Look at the ledger of the keystore at `root` again.

        VerificationError if it lacks lines that were seen, or of which the CAs signed the newest
        head: those that are gone may be revocations.
        """
        last, head = next(ledger.rows(after=self.size - 1), None), read_head(root)
        if self.size and (last is None or last[0] != self.size or last[-1] != self.chain):
            raise _lost(f"line {self.size}, which was there,")
        if head:
            size = head.head.size
            new = takewhile(lambda each: each[0] <= size, ledger.rows(after=self.signed.size))
            signed = self.signed.extended(leaf_of(*row) for row in new)
            if (signed.size, signed.root) != (size, head.head.root):
                raise _lost(f"one of the {size} lines of which the CAs signed a head")
            self.signed = signed
        self.size, self.chain = ledger.size, ledger.head


def _lost(what: str) -> VerificationError:
    return VerificationError(
        f"the ledger lacks {what}: it was rolled back, or is another one",
        code=Code.CONTENT_CHANGED,
        hint="`pqsec log --verify` shows what is missing; restore the ledger that fits",
    )


@dataclass(frozen=True, slots=True)
class SignedTree:
    """A signed head with its tree."""

    checkpoint: Checkpoint
    tree: CompactRange

    def files(self) -> Iterator[tuple[str, bytes]]:
        """The names and contents of its files in `public/`."""
        subtrees = [each.hex() for each in self.tree.subtrees]
        value = {"size": self.tree.size, "subtrees": subtrees}
        yield layout.TREE_HEAD, self.checkpoint.to_bytes()
        yield layout.TREE, json.dumps(value, indent=1).encode() + b"\n"


def compared(root: Path, open_ledger: Callable[[], Ledger]) -> Ledger:
    """The ledger of the keystore at `root`, which has what its CAs signed the newest head of.

    KeystoreError if it lacks a line of that head, or the head is not theirs, or if the settings
    name other sets of credentials than its lines. Without a head the rest is not compared. `audit`
    also finds lines that were rewritten under the same chain values.
    """
    ledger, wrong = _compared(root, open_ledger)
    if wrong:
        ledger.close()
        with at_rest(root):  # a change puts the head into its place before its lines
            ledger, wrong = _compared(root, open_ledger)
    if wrong:
        ledger.close()
        raise wrong
    return ledger


def _compared(root: Path, open_ledger: Callable[[], Ledger]) -> tuple[Ledger, KeystoreError | None]:
    """The ledger, and the error if it contradicts the newest head."""
    path = root / layout.PUBLIC / layout.TREE_HEAD
    head = read(path) if exists(path) else b""  # first: other machines add lines meanwhile
    ledger = open_ledger()
    try:
        wrong = other_sets(root, ledger)
        if not wrong and head and not ledger.fits(head):
            wrong = _difference(root, ledger, head)
    except BaseException:
        ledger.close()
        raise
    if not wrong:
        ledger.is_found_to_fit(head)
    return ledger, wrong


def other_sets(root: Path, ledger: Ledger) -> KeystoreError | None:
    """The error if the settings, which nobody signs, name other sets than the ledger has."""
    named, known = {*set_names(root)}, {layout.FIRST, *ledger.sets()}
    if named == known:
        return None
    lacks, names = bool(known - named), ", ".join(sorted(known ^ named))
    hint = "restore the settings from a backup: without a set, it would no longer be looked at"
    if lacks and read_ledger(root / layout.SETTINGS):
        hint = (
            f"another machine added it: copy {layout.SETTINGS}, {layout.PUBLIC}/ and"
            f" {layout.SETS}/ from the one where `pqsec ca add-set` ran: docs/how-to/postgresql.md"
        )
    return KeystoreError(
        f"{root / layout.SETTINGS} {'lacks' if lacks else 'has'} the set of credentials {names},"
        f" and the ledger {'has it' if lacks else 'does not'}",
        hint=hint,
    )


def _difference(root: Path, ledger: Ledger, data: bytes) -> KeystoreError | None:
    """The error if the ledger contradicts the signed head in `data`."""
    try:
        head = _verified_in(root, data).head
    except (MalformedError, VerificationError, MissingError) as error:
        ca = f"; the CA is that in {layout.PUBLIC}/{layout.PERMISSIONS_CA}"
        where = "" if isinstance(error, MissingError) else ca
        return KeystoreError(
            f"the ledger cannot be compared with its signed head: {error}{where}",
            hint="one of the two files was replaced: restore public/ from a backup. If only the"
            " head is lost, remove it: `pqsec log --sign` signs another",
        )
    if ledger.origin != head.origin:
        words = f"the CAs signed the head of another ledger: {head.origin}, not {ledger.origin}"
    elif ledger.size < head.size:
        words = (
            f"the ledger lacks lines: it has {ledger.size}, and the CAs signed a head of"
            f" {head.size}: it was rolled back"
        )
    elif not _has_lines(root, ledger, head):
        words = (
            f"the ledger lacks one of the {head.size} lines of which the CAs signed a head: it was"
            " rolled back, or is another one"
        )
    else:
        return None
    return KeystoreError(f"{root}: {words}", hint=_WAY_OUT)


def _has_lines(root: Path, ledger: Ledger, head: TreeHead) -> bool:
    """Whether the ledger has the last line of which `head` was signed, and so those before.

    The chain value of a line, which is in its leaf, covers all lines before it. Of the tree only
    the last complete subtree is computed, if the others are stored.
    """
    if not head.size:
        return True
    if stored := _stored(root, head):
        count, wanted = head.size & -head.size, stored.subtrees[-1]
    else:
        count, wanted = head.size, head.root
    rows = ledger.rows(after=head.size - count)
    own = takewhile(lambda each: each[0] <= head.size, rows)
    tree = CompactRange().extended(leaf_of(*row) for row in own)
    return (tree.size, tree.root) == (count, wanted)


def signers_of(root: Path) -> list[Certificate]:
    """Who signs heads of the keystore at `root`: the signers of each of its sets."""
    public = (root / layout.in_set(each, layout.PUBLIC) for each in set_names(root))
    return [signer for folder in public for signer in signers_in(folder)]


def signers_in(folder: Path) -> list[Certificate]:
    """The permissions CA in the folder and, if there is one, its countersigner."""
    second = [layout.PERMISSIONS_ALT_CA] if exists(folder / layout.PERMISSIONS_ALT_CA) else []
    return [load_first_certificate(folder / each) for each in (layout.PERMISSIONS_CA, *second)]


def signing_keys(signers: Iterable[Certificate]) -> list[PublicKey]:
    """The keys that must have signed a head."""
    return [each.public_key for each in signers]


def read_head(root: Path) -> Checkpoint | None:
    """The newest signed head of the keystore at `root`; None if there is none.

    MalformedError if it is not a head, VerificationError unless all its CAs signed it.
    """
    path = root / layout.PUBLIC / layout.TREE_HEAD
    return _verified_in(root, read(path)) if exists(path) else None


def _verified_in(root: Path, head: bytes) -> Checkpoint:
    """The head in `head`, by the CAs of the keystore at `root`; errors as of `read_head`."""
    with located(root / layout.PUBLIC / layout.TREE_HEAD):
        return _verified(head, *(each.spki for each in signers_of(root)))


@lru_cache(maxsize=4)
def _verified(head: bytes, *signers: bytes) -> Checkpoint:
    """The head, if all these keys signed it, cached: a server asks for one three times."""
    checkpoint = Checkpoint.from_bytes(head)
    checkpoint.verify([load_public_key(each) for each in signers])
    return checkpoint


def extended(
    root: Path, ledger: Ledger, entries: Sequence[Entry], authorities: "Authorities"
) -> SignedTree | None:
    """The next head, over all lines of `ledger` and then `entries`, which are added to it.

    None if the last head is over the same lines, or if lines that it is over are no longer there:
    the CA does not sign a second history. `pqsec log --verify` then reports it.
    """
    try:
        last = read_head(root)
        before = ledger.size
        ledger.append(entries)
        tree = _tree_before(root, ledger, last.head) if last else CompactRange()
    except (MalformedError, VerificationError):
        return None
    if tree is None or before < tree.size or ledger.size == tree.size:
        return None
    if last and last.head.origin != ledger.origin:
        return None
    tree = tree.extended(leaf_of(*row) for row in ledger.rows(after=tree.size))
    head = TreeHead(ledger.origin, tree.size, tree.root)
    return SignedTree(Checkpoint.signed(head, [each.key for each in authorities.signers]), tree)


def _tree_before(root: Path, ledger: Ledger, head: TreeHead) -> CompactRange | None:
    """The tree of which `head` is the head, as stored, or else of the ledger's lines."""
    if stored := _stored(root, head):
        return stored
    rows = (row for row in ledger.rows() if row[0] <= head.size)
    tree = CompactRange().extended(leaf_of(*row) for row in rows)
    return tree if (tree.size, tree.root) == (head.size, head.root) else None


def _stored(root: Path, head: TreeHead) -> CompactRange | None:
    """The stored tree; None if it is damaged or not that of `head`."""
    try:
        value = json.loads(read(root / layout.PUBLIC / layout.TREE, limit=MAX_TREE))
        tree = CompactRange(int(value["size"]), tuple(map(bytes.fromhex, value["subtrees"])))
    except (PqsecError, ValueError, KeyError, TypeError, RecursionError):
        return None
    is_of_head = tree.is_sound and (tree.size, tree.root) == (head.size, head.root)
    return tree if is_of_head else None
