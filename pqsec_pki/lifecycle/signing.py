"""Signs permissions for an existing certificate, the governance, and any other document.

Keys and certificates stay as they are. The new document replaces the old one, and its ledger
line is written, in one change.
"""

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors, refuse_existing, write
from pqsec_pki._processes import shared_out
from pqsec_pki.approvals import Covered
from pqsec_pki.documents import Governance, Kind, Permissions
from pqsec_pki.errors import UsageError, VerificationError
from pqsec_pki.keystore import (
    Authorities,
    Entry,
    Keystore,
    StagedFolder,
    change,
    checked_head,
    document_entry,
    faults_of_ledger,
    layout,
    one_set,
    placed_entry,
    stage_governance,
)
from pqsec_pki.lifecycle._inspector import Inspector
from pqsec_pki.lifecycle._sets import (
    SetWork,
    document_folders,
    each_set,
    record_in_sets,
    sign_in_sets,
)
from pqsec_pki.lifecycle.growing import changed_protection, changed_rights, refuse_growth
from pqsec_pki.lifecycle.issuing import ParticipantSpec, permissions_for
from pqsec_pki.transparency import TreeHead

_DOCUMENTS: Mapping[Kind, type[Governance] | type[Permissions]] = {
    Kind.GOVERNANCE: Governance,
    Kind.PERMISSIONS: Permissions,
}


def sign_permissions(
    keystore: Keystore, authorities: Authorities, specs: Sequence[ParticipantSpec], *, now: datetime
) -> None:
    """Sign new permissions for all existing participants in `specs`, or for none.

    In all their sets; they are valid as long as the certificate: the validity in `specs` is not
    used. KeystoreError for a participant that does not exist, was revoked, or whose certificate
    is not its newest.
    """
    names = [layout.enclave_name(spec.name) for spec in specs]
    with change(keystore.root, authorities) as transaction, keystore.open_ledger() as ledger:
        refuse_growth(
            keystore, lambda: (each for _, each in changed_rights(keystore, specs, now=now))
        )
        inspector = Inspector.of(keystore, ledger, names, now=now)
        inspector.refuse_revoked(names)
        sets = each_set(keystore, authorities, transaction, ledger)
        folders = document_folders(sets, names)
        signer = _Signer(keystore, authorities, inspector, transaction.number, now)
        for entries in shared_out(signer.sign_permissions, names, specs, folders):
            record_in_sets(sets, entries)


def sign_governance(
    keystore: Keystore,
    authorities: Authorities,
    governance: Governance,
    *,
    now: datetime,
    config_digest: str = "",
) -> None:
    """Sign the governance that all participants of the keystore share, the same in all sets.

    `config_digest` is copied into the ledger.
    """
    document = governance.to_xml()
    with change(keystore.root, authorities) as transaction:
        refuse_growth(keystore, lambda: [changed_protection(keystore, governance)])
        for each in authorities.sets:
            part = transaction.of(each.set_name)
            stage_governance(part, each, document, now=now, config_digest=config_digest)


def sign_head(keystore: Keystore, authorities: Authorities) -> TreeHead:
    """Sign a head over all lines of the ledger, unless there is one.

    VerificationError if it no longer has the lines of which the last head was signed.
    """
    if faults := faults_of_ledger(keystore):
        raise VerificationError(*faults, hint="`pqsec log --verify` shows what is missing")
    with change(keystore.root, authorities):
        pass  # each change with the CA keys signs one
    return checked_head(keystore).head


def sign_document(  # noqa: PLR0913 -- each is a choice of the user's, and by name
    keystore: Keystore,
    kind: Kind,
    document: bytes,
    goal: Path,
    authorities: Authorities,
    *,
    now: datetime,
    embed_certificate: bool = False,
    force: bool = False,
    profile: str | None = None,
) -> bytes:
    """Sign the meaning of `document` into the file `goal`, anywhere, and enter it in the ledger.

    What is signed has the form of `Governance.to_xml` or `Permissions.to_xml`, without comments. If
    `goal` is a document of the keystore, its line says so, and its XML file is replaced in the same
    change, in all sets of credentials. For a file elsewhere `profile` names the set whose CA signs;
    UsageError without it if there are several.
    ExistsError if `goal` exists, unless `force`; then nothing is entered. InvalidDocumentError if
    `document` is not valid, UsageError for a time that no stack understands.
    """
    document = _DOCUMENTS[kind].from_xml(document).to_xml()
    found = (layout.document_folder(each.folder, kind.value, goal) for each in keystore.sets)
    place = next((each for each in found if each is not None), None)
    if place is not None and profile is not None:
        raise UsageError(f"{goal} is signed in all sets of credentials: leave out --set")
    chosen = one_set(keystore, profile) if place is None else None
    with change(keystore.root, authorities) as transaction, keystore.open_ledger() as ledger:
        keystore.refuse_unapproved(Covered.GROW)
        made = []
        for each in each_set(keystore, authorities, transaction, ledger):
            if each.keystore != chosen if chosen else not _has(each, place):
                continue
            signed = each.authorities.sign(
                document,
                number=transaction.number,
                now=now,
                embed_certificate=embed_certificate,
            )
            entry = document_entry(kind.value, str(goal), signed, now)
            each.part.record(entry if place is None else placed_entry(entry, place))
            if place is not None:
                folder = each.part.folder(place, private=False)
                folder.public(goal.with_suffix(".xml").name, document)
                folder.public(goal.name, signed)
            made.append(signed)
        if place is None:
            write(goal, made[0], force=force)
        elif not force:
            refuse_existing(goal)
    return made[0]


def _has(work: SetWork, place: str | None) -> bool:
    """Whether a document belongs into that folder of the set: not if its participant has no
    certificate there yet."""
    if work.keystore.set_name == layout.FIRST or place in {None, layout.ENCLAVES}:
        return True
    return bool(work.known([str(place).removeprefix(layout.ENCLAVES)]))


@dataclass(frozen=True, slots=True)
class _Signer:
    keystore: Keystore
    authorities: Authorities
    inspector: Inspector
    number: int
    now: datetime

    def sign_permissions(
        self, name: str, spec: ParticipantSpec, folders: Sequence[StagedFolder | None]
    ) -> list[Entry | None]:
        there = self.keystore.folder / layout.enclave_folder(name)
        with disk_errors(there):
            certificate = self.inspector.certificate(name, there)
        return sign_in_sets(
            self.authorities,
            folders,
            name,
            permissions_for(spec, certificate),
            number=self.number,
            now=self.now,
            subject=certificate.subject_name,
            config_digest=spec.config_digest,
        )
