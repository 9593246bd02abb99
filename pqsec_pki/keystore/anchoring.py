"""Anchors: signed heads of the ledger that are kept in another place, and what they show.

An attacker who can write the ledger and use the CA keys can replace it by another complete ledger.
That one lacks the lines of which heads were signed before, and the attacker cannot change those
heads.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors, read, write
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import MalformedError, VerificationError, located
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._settings import set_names
from pqsec_pki.keystore.heads import other_sets, read_head, signers_in, signing_keys
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.transparency import Checkpoint, HeadExtension, MerkleTree, TreeHead, leaf_of

_FILES = "*.checkpoint"
_NONE: Mapping[Path, HeadExtension] = {}
_HINT = "docs/how-to/anchors.md says what to do"


@dataclass(frozen=True, slots=True)
class Anchored:
    """The newest signed head, in another place."""

    path: Path
    head: TreeHead
    unsigned: int
    """Lines of the ledger after it."""
    already: bool
    """Whether it was there before."""

    def to_json(self) -> dict[str, object]:
        """The head for --json."""
        return {
            "anchor": self.path,
            "origin": self.head.origin,
            "size": self.head.size,
            "root": self.head.root.hex(),
            "unsigned": self.unsigned,
            "already": self.already,
        }


def write_anchor(keystore: Keystore, folder: Path) -> Anchored:
    """Write the newest signed head of `keystore` into `folder`, unless it is there.

    VerificationError, and nothing is written, if there is no head, or the ledger does not have
    the lines of which it, or a head in `folder`, was signed.
    """
    tree, anchors = ledger_tree(keystore), read_anchors(folder)
    newest = checked_head(keystore, tree, anchors)
    head, sizes = newest.head, [each.head.size for each in anchors.values()]
    path, last = folder / f"{head.size:09}.checkpoint", max(sizes, default=0)
    if head.size not in sizes:
        proof = tuple(tree.consistency(last, head.size))
        with disk_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
        write(path, HeadExtension(newest, last, proof).to_bytes(), force=True)
    return Anchored(path, head, tree.size - head.size, already=head.size in sizes)


def checked_head(
    keystore: Keystore,
    tree: MerkleTree | None = None,
    anchors: Mapping[Path, HeadExtension] = _NONE,
) -> Checkpoint:
    """The newest signed head; the ledger has what the CAs signed then, and of `anchors`.

    `tree` is that of the ledger, if it was made before. VerificationError if there is no head, or
    the ledger has something else.
    """
    tree = tree or ledger_tree(keystore)
    problems = list(head_problems(keystore, tree, anchors))
    if problems:
        raise VerificationError(*problems, hint=_HINT)
    newest = read_head(keystore.root)
    if newest is None:
        raise VerificationError(
            "the CAs have not signed a head of this ledger", hint="`pqsec log --sign` signs one"
        )
    return newest


def anchored_head(keystore: Keystore, folder: Path | None) -> Checkpoint:
    """The newest signed head, as `checked_head`, compared with the anchors in the folder, if any.

    VerificationError also if a folder is named, and has none.
    """
    found = read_anchors(folder) if folder else _NONE
    if folder and not found:
        raise VerificationError(
            f"{folder} has no anchors", hint="`pqsec log --anchor DIR` writes them"
        )
    return checked_head(keystore, anchors=found)


def read_anchors(folder: Path) -> dict[Path, HeadExtension]:
    """The anchors in the folder by their files, the smallest tree first; none without folder.

    MalformedError for a file that is not one.
    """
    found = {}
    with disk_errors(folder):
        paths = sorted(folder.glob(_FILES))
    for path in paths:
        with located(path):
            found[path] = HeadExtension.from_bytes(read(path))
    return dict(sorted(found.items(), key=lambda item: item[1].head.size))


def ledger_tree(keystore: Keystore) -> MerkleTree:
    """The tree over the ledger as it is."""
    with keystore.as_found.open_ledger() as ledger:
        return MerkleTree(leaf_of(*row) for row in ledger.rows())


def faults_of_ledger(keystore: Keystore) -> list[str]:
    """Differences of the ledger from the settings and from the newest head in the keystore.

    Empty without any. Whose signatures a head needs is in the settings: the sets that they name.
    """
    with keystore.as_found.open_ledger() as ledger:
        others = other_sets(keystore.root, ledger)
    found = [str(others)] if others else []
    return [*found, *head_problems(keystore, ledger_tree(keystore), _NONE)]


def head_problems(
    keystore: Keystore, tree: MerkleTree, anchors: Mapping[Path, HeadExtension]
) -> Iterator[str]:
    """Differences of the ledger, with that tree, from the heads that the CAs signed.

    The heads are the newest one in the keystore, and `anchors`.
    """
    heads: dict[Path, TreeHead] = {}
    try:
        if newest := read_head(keystore.root):
            heads[keystore.root / layout.PUBLIC / layout.TREE_HEAD] = newest.head
    except (MalformedError, VerificationError) as error:
        yield str(error)
    with keystore.as_found.open_ledger() as ledger:
        origin = ledger.origin
    signers = list(_signers(keystore.root)) if anchors else []
    for path, anchor in anchors.items():
        if any(_signed_by(anchor.checkpoint, each) for each in signers):
            heads[path] = anchor.head
        else:
            yield f"{path}: not signed by a CA of this keystore"
    for path, head in heads.items():
        if head.origin != origin:
            yield f"{path}: the head of another ledger: {head.origin} instead of {origin}"
    yield from _broken_proofs(anchors)
    yield from _differences(heads, tree)


def _broken_proofs(anchors: Mapping[Path, HeadExtension]) -> Iterator[str]:
    """Anchors that do not continue the one before, and gaps where one was removed."""
    known = {anchor.head.size: anchor.head for anchor in anchors.values()}
    for path, anchor in anchors.items():
        before = known.get(anchor.old)
        if before is None and anchor.old:
            yield f"{path}: the head of {anchor.old} lines, which it continues, is missing"
        elif before:
            try:
                anchor.verify(before)
            except VerificationError as error:
                yield f"{path}: {error}"


def _differences(heads: Mapping[Path, TreeHead], tree: MerkleTree) -> Iterator[str]:
    """The first head of each kind whose lines the ledger does not have."""
    fitting = {path for path, head in heads.items() if _fits(head, tree)}
    signed = [heads[path].size for path in fitting]
    wrong = sorted((head.size, path) for path, head in heads.items() if path not in fitting)
    cut = [(size, path) for size, path in wrong if size > tree.size][:1]
    other = [(size, path) for size, path in wrong if size <= tree.size][:1]
    for size, path in other:
        lines = f"lines {_whole(signed, size) + 1} to {size}"
        if any(each >= size for each in signed):
            yield f"{path}: fork: the CAs signed this head, and later one over other {lines}"
        else:
            yield f"{path}: {lines} are not those of which this head was signed"
    for size, path in cut:
        yield (
            f"{path}: the end was cut off: this head is over {size} lines, the ledger has"
            f" {tree.size}, and those up to {_whole(signed, size)} are as signed"
        )


def _whole(signed: list[int], size: int) -> int:
    """The last line below `size` up to which the ledger is as signed."""
    return max((each for each in signed if each < size), default=0)


def _fits(head: TreeHead, tree: MerkleTree) -> bool:
    return head.size <= tree.size and tree.root(head.size) == head.root


def _signed_by(checkpoint: Checkpoint, signers: list[Certificate]) -> bool:
    try:
        checkpoint.verify(signing_keys(signers))
    except VerificationError:
        return False
    return True


def _signers(root: Path) -> Iterator[list[Certificate]]:
    """The current signers of each set, and those that were replaced.

    One set's are enough: heads from before another set was added have no others.
    """
    for name in set_names(root):
        yield signers_in(root / layout.in_set(name, layout.PUBLIC))
        generations = root / layout.in_set(name, layout.GENERATIONS)
        with disk_errors(generations):
            there = sorted(generations.iterdir()) if generations.is_dir() else []
        for folder in there:
            if (folder / layout.PERMISSIONS_CA).exists():
                yield signers_in(folder)
