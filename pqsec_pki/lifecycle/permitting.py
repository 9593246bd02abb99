"""Changes rights of participants: keys and certificates stay, permissions are signed again.

In two steps, so that a user sees the change first: `changed_permissions` reads the signed
permissions and edits them, and `sign_changed` signs the result, unless they were changed since.
"""

from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._processes import shared_out
from pqsec_pki.access import permissions_diff
from pqsec_pki.certificates import Certificate
from pqsec_pki.documents import DomainSet, Grant, Permissions
from pqsec_pki.errors import KeystoreError, located
from pqsec_pki.keystore import (
    PERMITTED,
    Authorities,
    Entry,
    Keystore,
    StagedFolder,
    change,
    layout,
    refuse_other_permissions,
    superseded_certificates,
)
from pqsec_pki.lifecycle._inspector import Inspector
from pqsec_pki.lifecycle._sets import (
    document_folders,
    each_set,
    record_in_sets,
    sign_in_sets,
)
from pqsec_pki.lifecycle.growing import refuse_growth


@dataclass(frozen=True, slots=True)
class PermissionsChange:
    """The permissions of a participant before and after a change of rights."""

    name: str
    old: Permissions | None
    """None if none were signed yet."""
    new: Permissions
    config_digest: str = ""
    """The digest of its entry in a domain file; empty if it is in none."""
    subject: str = ""
    """The subject of its certificate."""


def changed_permissions(
    keystore: Keystore,
    names: Sequence[str],
    edit: Callable[[str, Grant], Grant],
    *,
    now: datetime,
) -> list[PermissionsChange]:
    """The permissions of each participant, and what `edit` makes of its name and its grant.

    Nothing is written.

    KeystoreError for a participant that does not exist, was revoked, has no grant, or whose
    files are not its newest; VerificationError for a signature that is not valid; and the errors
    of `edit`.
    """
    names = [layout.enclave_name(name) for name in names]
    with keystore.open_ledger() as ledger:
        inspector = Inspector.of(keystore, ledger, names, now=now)
    inspector.refuse_revoked(names)
    return [_changed(inspector, name, edit) for name in names]


def earlier_ends(
    keystore: Keystore, changes: Sequence[PermissionsChange], *, now: datetime
) -> dict[str, datetime]:
    """Until when documents that were signed before can be used, by participant.

    Permissions name a subject and no key, so whoever has an earlier document can put it beside any
    certificate of that name. It ends no later than the old one of the change, or than the last
    certificate that was superseded. What has ended at `now` is left out.
    """
    superseded = superseded_certificates(keystore, now=now)
    found = {}
    for each in changes:
        old = each.old.grants_for(each.subject) if each.old else ()
        ends = [grant.not_after for grant in old]
        ends += [line.ends for line in superseded.get(each.name, ())]
        if ends and max(ends) >= now:
            found[each.name] = max(ends)
    return found


def sign_changed(
    keystore: Keystore,
    authorities: Authorities,
    changes: Sequence[PermissionsChange],
    *,
    now: datetime,
) -> None:
    """Sign the new permissions of all participants in `changes`, or of none, in all their sets.

    KeystoreError as in `changed_permissions`, and if permissions have changed since.
    """
    names = [each.name for each in changes]
    with change(keystore.root, authorities) as transaction, keystore.open_ledger() as ledger:
        refuse_growth(keystore, lambda: (permissions_diff(each.old, each.new) for each in changes))
        inspector = Inspector.of(keystore, ledger, names, now=now)
        inspector.refuse_revoked(names)
        sets = each_set(keystore, authorities, transaction, ledger)
        folders, number = document_folders(sets, names), transaction.number

        def sign(
            wanted: PermissionsChange, folders: Sequence[StagedFolder | None]
        ) -> list[Entry | None]:
            there = keystore.folder / layout.enclave_folder(wanted.name)
            if _signed(inspector, wanted.name, there) != wanted.old:
                raise KeystoreError(
                    f"the permissions of {wanted.name} were changed by another command",
                    hint="run this command again: it shows the change to the new permissions",
                )
            return sign_in_sets(
                authorities,
                folders,
                wanted.name,
                wanted.new,
                number=number,
                now=now,
                subject=wanted.subject,
                config_digest=PERMITTED + wanted.config_digest,
            )

        for entries in shared_out(sign, changes, folders):
            record_in_sets(sets, entries)


def _changed(
    inspector: Inspector, name: str, edit: Callable[[str, Grant], Grant]
) -> PermissionsChange:
    folder = inspector.keystore.folder / layout.enclave_folder(name)
    certificate = inspector.certificate(name, folder)
    subject = certificate.subject_name
    old = _signed(inspector, name, folder)
    if old is None:
        least = _least(certificate, name, inspector.keystore.domains)
        first = Permissions(grants=(edit(name, least),))
        return PermissionsChange(name, None, first, subject=subject)
    refuse_other_permissions(inspector.keystore, name)
    with located(folder / layout.PERMISSIONS):
        own = old.grants_for(subject)
        if not own:
            raise KeystoreError(f"there is no grant for {subject}")
    grants = [edit(name, grant) if grant in own else grant for grant in old.grants]
    new = Permissions(grants=tuple(grants))
    digest = inspector.config_digest(name, folder).removeprefix(PERMITTED)
    return PermissionsChange(name, old, new, digest, subject)


def _signed(inspector: Inspector, name: str, folder: Path) -> Permissions | None:
    """The newest permissions of `name`; None if none were signed yet."""
    if inspector.lacks_permissions(name, folder):
        return None
    return inspector.permissions(name, folder)


def _least(certificate: Certificate, name: str, domains: DomainSet) -> Grant:
    """A grant that allows nothing."""
    return Grant.least(
        name=name,
        subject_name=certificate.subject_name,
        not_before=certificate.not_before,
        not_after=certificate.not_after,
        domains=domains,
    )
