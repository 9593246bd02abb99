"""What a change does in each set of credentials of a keystore."""

from collections.abc import Iterable, Sequence
from datetime import datetime, timedelta
from typing import NamedTuple

from pqsec_pki.certificates import Authority
from pqsec_pki.documents import Permissions
from pqsec_pki.keystore import (
    Authorities,
    Entry,
    Keystore,
    Ledger,
    SetChange,
    StagedFolder,
    Transaction,
    layout,
)
from pqsec_pki.lifecycle._issuer import stage_permissions


class SetWork(NamedTuple):
    """One set, with all that a change of it needs."""

    keystore: Keystore
    authorities: Authorities
    ledger: Ledger
    """Answers about this set."""
    part: SetChange

    def folder(self, name: str, *, private: bool) -> StagedFolder:
        """Stage the folder of a participant."""
        return self.part.folder(layout.enclave_folder(name), private=private)

    def known(self, names: Sequence[str]) -> frozenset[str]:
        """Those of `names` that have a certificate of this set, by the ledger."""
        return frozenset(row[0] for row in self.ledger.participants(names))


def each_set(
    keystore: Keystore, authorities: Authorities, transaction: Transaction, ledger: Ledger
) -> tuple[SetWork, ...]:
    """The sets of the keystore, the first one first."""
    return tuple(
        SetWork(view, cas, ledger.of(view.set_name), transaction.of(view.set_name))
        for view, cas in zip(keystore.sets, authorities.sets, strict=True)
    )


def common_validity(cas: Iterable[Authority], now: datetime, validity: timedelta) -> timedelta:
    """How long certificates of these identity CAs are valid: `validity`, or until one of them ends.

    So the permissions of one are those of all. A CA that has ended refuses to issue by itself.
    """
    left = [each.certificate.not_after - now for each in cas]
    return min([validity, *(each for each in left if each > timedelta())])


def document_folders(
    sets: Sequence[SetWork], names: Sequence[str]
) -> list[list[StagedFolder | None]]:
    """Stage the folder of each participant in each set; None where it has no certificate yet."""
    known = [frozenset(names), *(each.known(names) for each in sets[1:])]
    return [
        [
            each.folder(name, private=False) if name in there else None
            for each, there in zip(sets, known, strict=True)
        ]
        for name in names
    ]


def sign_in_sets(  # noqa: PLR0913 -- as `stage_permissions`
    authorities: Authorities,
    folders: Sequence[StagedFolder | None],
    name: str,
    permissions: Permissions,
    *,
    number: int,
    now: datetime,
    subject: str,
    config_digest: str,
) -> list[Entry | None]:
    """Sign one permissions document in the folder of each set; the entries."""
    return [
        stage_permissions(
            folder,
            each,
            name,
            permissions,
            number=number,
            now=now,
            subject=subject,
            config_digest=config_digest,
        )[1]
        if folder
        else None
        for each, folder in zip(authorities.sets, folders, strict=True)
    ]


def record_in_sets(sets: Sequence[SetWork], entries: Sequence[Entry | None]) -> None:
    """Record the entry of each set, if there is one."""
    for each, entry in zip(sets, entries, strict=True):
        if entry:
            each.part.record(entry)
