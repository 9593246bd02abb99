"""Rules about names that stacks confuse, and subjects of certificates that they cannot match."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pqsec_pki.certificates import Certificate
from pqsec_pki.credentials import CERTIFICATE
from pqsec_pki.documents import same_subject
from pqsec_pki.lint._names import CUTS, parsed, repeated
from pqsec_pki.lint.document import PermissionsFile
from pqsec_pki.lint.rule import Family, Severity, Target, Violation
from pqsec_pki.lint.subjects import CertificateFile, Inventory

FAMILY = Family("naming")

ERROR, WARNING, _ = Severity
_CYCLONE = Target.CYCLONEDDS
_CYCLONES = "Cyclone DDS 0.10.2, 0.10.5, 11.0.1"


@dataclass(frozen=True, slots=True)
class _Holder:
    """A certificate or grant: its name, and the pieces into which Cyclone DDS splits it."""

    name: str
    pieces: frozenset[tuple[str, str]]
    path: Path
    line: int | None = None


@FAMILY.rule(
    "PQS401", ERROR, Inventory, "a participant may use another participant's permissions",
    why="Cyclone DDS splits names at each , / and |. It accepts a grant if it contains all pieces"
    " of the certificate's subject, in any order. CN=/robot was accepted with the permissions of"
    " CN=/robot/admin and published on its topics. Permissions are not secret: each handshake sends"
    " them unencrypted.",
    fix="Rename one of the two, so that each path has a part that the other does not have:"
    " /robot/driver and /robot/admin.",
    stacks=(_CYCLONE,),
    rows=("**security**: identity CN=/robot presenting a document for CN=/robot/admin",
          "identity CN=/x/a, grant CN=/a/x", "superset (+`,L=Madrid`)"),
    measured=_CYCLONES,
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


def _may_pass(other: _Holder, grant: _Holder) -> bool:
    if not other.pieces <= grant.pieces or other.name == grant.name:
        return False
    return not same_subject(parsed(other.name), parsed(grant.name))


def _identities(inventory: Inventory) -> Iterator[_Holder]:
    for file in inventory.certificates:
        for certificate in _participants(file):
            name = certificate.subject_name
            if pieces := _pieces(name):
                yield _Holder(name, pieces, file.path)


def _granted(inventory: Inventory) -> Iterator[_Holder]:
    for document in inventory.documents:
        for grant in document.grants if isinstance(document, PermissionsFile) else ():
            if pieces := _pieces(grant.subject_name):
                line = document.line(grant.line)
                yield _Holder(grant.subject_name, pieces, document.path, line)


def _by_rarest_piece(holders: list[_Holder]) -> dict[tuple[str, str], list[_Holder]]:
    """Each name once, under the piece that the fewest names have, to compare few pairs."""
    unique = {holder.name: holder for holder in holders}
    counts = Counter(piece for holder in unique.values() for piece in holder.pieces)
    found: dict[tuple[str, str], list[_Holder]] = {}
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


@FAMILY.rule(
    "PQS402", WARNING, Inventory, "two participants with the same name",
    why="Permissions are bound to a name: each of the two may use the permissions of the other.",
    fix="Give each participant its own subject.",
)  # fmt: skip
def same_name(inventory: Inventory) -> Iterator[Violation]:
    before: dict[bytes, tuple[str, bytes]] = {}
    for enclave in inventory.enclaves:
        certificate = enclave.certificate()
        if certificate is None:
            continue
        name, spki = before.setdefault(certificate.subject_der, (enclave.name, certificate.spki))
        if spki != certificate.spki:
            message = f"{name} has the same subject {certificate.subject_name} and another key"
            yield Violation(message, path=enclave.files[CERTIFICATE].path)


@FAMILY.rule(
    "PQS431", ERROR, CertificateFile, "an attribute type twice in a certificate's subject",
    why="If a subject has two OUs, Cyclone DDS reads only the first, and Fast DDS 3 finds no"
    " grant.",
    fix="Issue the certificate with one of them. CN alone works with every stack.",
    rows=("two OUs",), measured=f"{_CYCLONES}, Fast DDS 3.1.2, 3.6.2",
)  # fmt: skip
def certificate_repeats(file: CertificateFile) -> Iterator[Violation]:
    for certificate in _participants(file):
        if twice := repeated(parsed(certificate.subject_name)):
            yield Violation(f"the subject {certificate.subject_name} has {twice} twice")


@FAMILY.rule(
    "PQS432", ERROR, CertificateFile, "a multi-valued part in a certificate's subject",
    why="No stack finds a grant for a subject such as CN=x+OU=y.",
    fix="Issue the certificate with separate parts, or with CN alone.",
    rows=("multi-valued RDN",), measured="all six stacks",
)  # fmt: skip
def certificate_joins(file: CertificateFile) -> Iterator[Violation]:
    for certificate in _participants(file):
        if any(len(list(rdn)) > 1 for rdn in certificate.subject.rdns):
            yield Violation(f"the subject {certificate.subject_name} has parts joined by +")


def _participants(file: CertificateFile) -> Iterator[Certificate]:
    """The certificates in it that are not self-issued: documents name only participants."""
    return (each for each in file.certificates if not each.is_self_issued)
