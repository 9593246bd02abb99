"""Rules about participants that stacks confuse because of their names."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki.credentials import CERTIFICATE
from pqsec_pki.documents import same_subject
from pqsec_pki.lint.document import PermissionsFile
from pqsec_pki.lint.permissions._names import CUTS, parsed
from pqsec_pki.lint.rule import CYCLONE, CYCLONES, Severity, Violation, lint_rule
from pqsec_pki.lint.subjects import Inventory
from pqsec_pki.stacks import Stack

ERROR, WARNING, _ = Severity
_SETS, _INSTALLED = "sets", "installed"
"""The folder of the further sets of a keystore or a robot, `sets/<profile>/enclaves/...`, and that
of a robot's installations, `installed/<n>/`."""
_CYCLONE = Stack.CYCLONEDDS


@dataclass(frozen=True, slots=True)
class _NamePieces:
    """A certificate or grant: its name, and the pieces into which Cyclone DDS splits it."""

    name: str
    pieces: frozenset[tuple[str, str]]
    path: Path
    line: int | None = None


@lint_rule(
    "PQS401", ERROR, "a participant may use another participant's permissions",
    why="Cyclone DDS splits names at each , / and |. It accepts a grant if it contains all pieces"
    " of the certificate's subject, in any order. CN=/robot was accepted with the permissions of"
    " CN=/robot/admin and published on its topics. Permissions are not secret: each handshake sends"
    " them unencrypted.",
    fix="Rename one of the two, so that each path has a part that the other does not have:"
    " /robot/driver and /robot/admin.",
    stacks=CYCLONE,
    rows=("**security**: identity CN=/robot presenting a document for CN=/robot/admin",
          "identity CN=/x/a, grant CN=/a/x", "superset (+`,L=Madrid`)"),
    measured=CYCLONES,
    bad="$ pqsec -k k issue --publish chatter /talker/admin",
    good="""
        $ mv k/enclaves/talker/admin elsewhere/
        $ pqsec -k k issue --publish chatter /admin
    """,
)  # fmt: skip
def escalation(inventory: Inventory) -> Iterator[Violation]:
    grants = list(_granted(inventory))
    by_rarest = _by_rarest_piece([*_identities(inventory), *grants])
    for grant in grants:
        reported: set[str] = set()
        for piece in grant.pieces:
            for other in by_rarest.get(piece, ()):
                if other.name not in reported and _may_pass(other, grant):
                    reported.add(other.name)
                    message = (
                        f"on Cyclone DDS, {other.name} may use the permissions of {grant.name}"
                    )
                    yield Violation(message, grant.line, grant.path)


def _may_pass(other: _NamePieces, grant: _NamePieces) -> bool:
    if not other.pieces <= grant.pieces or other.name == grant.name:
        return False
    return not same_subject(parsed(other.name), parsed(grant.name))


def _identities(inventory: Inventory) -> Iterator[_NamePieces]:
    for file in inventory.certificates:
        for certificate in file.issued:
            name = certificate.subject_name
            if pieces := _pieces(name):
                yield _NamePieces(name, pieces, file.path)


def _granted(inventory: Inventory) -> Iterator[_NamePieces]:
    for document in inventory.documents:
        for grant in document.grants if isinstance(document, PermissionsFile) else ():
            if pieces := _pieces(grant.subject_name):
                line = document.line(grant.line)
                yield _NamePieces(grant.subject_name, pieces, document.path, line)


def _by_rarest_piece(holders: list[_NamePieces]) -> dict[tuple[str, str], list[_NamePieces]]:
    """Each name once, under the piece that the fewest names have, to compare few pairs."""
    unique = {holder.name: holder for holder in holders}
    counts = Counter(piece for holder in unique.values() for piece in holder.pieces)
    found: dict[tuple[str, str], list[_NamePieces]] = {}
    for holder in unique.values():
        rarest = min(holder.pieces, key=lambda piece: (counts[piece], piece))
        found.setdefault(rarest, []).append(holder)
    return found


def _pieces(name: str) -> frozenset[tuple[str, str]]:
    values: dict[str, str] = {}
    for piece in CUTS.split(name):
        word, _, value = piece.partition("=")
        if piece:
            values.setdefault(word, value)
    return frozenset(values.items())


@lint_rule(
    "PQS402", WARNING, "two participants with the same name",
    why="Permissions are bound to a name: each of the two may use the permissions of the other.",
    fix="Give each participant its own subject.",
    bad="""
        $ mkdir robots
        $ cp -rL k/enclaves/talker robots/one
        $ pqsec -k k issue --force --publish chatter /talker
        $ cp -rL k/enclaves/talker robots/two
    """,
    good="""
        $ mv robots/two elsewhere/
        $ cp -rL k/enclaves/listener robots/two
    """,
)  # fmt: skip
def same_name(inventory: Inventory) -> Iterator[Violation]:
    before: dict[bytes, tuple[str, bytes, Path]] = {}
    for enclave in inventory.enclaves:
        certificate = enclave.certificate()
        if certificate is None:
            continue
        place = _without_set(enclave.folder)
        first = before.setdefault(certificate.subject_der, (enclave.name, certificate.spki, place))
        name, spki, elsewhere = first
        if spki != certificate.spki and place != elsewhere:
            message = f"{name} has the same subject {certificate.subject_name} and another key"
            yield Violation(message, path=enclave.files[CERTIFICATE].path)


def _without_set(folder: Path) -> Path:
    """The folder as in the first set, and on a robot without the number of the installation: it
    keeps the one before the current one."""
    parts = folder.parts
    for kind in (_SETS, _INSTALLED):
        if kind in parts:
            place = len(parts) - parts[::-1].index(kind)
            parts = (*parts[: place - 1], *parts[place + 1 :])
    return Path(*parts)
