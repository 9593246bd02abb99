"""Whether documents to be signed give more than those that are signed, as `pqsec diff` compares.

What cannot be compared, because the old files are missing, damaged or not the newest, grows.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from datetime import datetime

from pqsec_pki.access import Difference, Sense, permissions_diff
from pqsec_pki.access.governance_diff import governance_diff
from pqsec_pki.approvals import Covered
from pqsec_pki.documents import Governance, Permissions
from pqsec_pki.errors import PqsecError
from pqsec_pki.keystore import (
    Keystore,
    governance_digest,
    layout,
    refuse_other_governance,
    refuse_other_permissions,
    signed_governance,
)
from pqsec_pki.lifecycle._inspector import Inspector
from pqsec_pki.lifecycle.issuing import ParticipantSpec, permissions_for

_LESS = {Sense.TAKEN, Sense.STRONGER}


def grows(difference: Difference) -> bool:
    """Whether anything is granted or weaker, or may be."""
    less = all(change.sense in _LESS for change in difference.changes)
    return not (difference.complete and less)


def changed_rights(
    keystore: Keystore, specs: Sequence[ParticipantSpec], *, now: datetime
) -> Iterator[tuple[str, Difference]]:
    """The name of each of these participants, and what new permissions by its spec change.

    A comparison takes some milliseconds: it is made when it is asked for.
    """
    names = [layout.enclave_name(spec.name) for spec in specs]
    with keystore.open_ledger() as ledger:
        inspector = Inspector.of(keystore, ledger, names, now=now)
    for name, spec in zip(names, specs, strict=True):
        yield name, _changed(inspector, name, spec)


def _changed(inspector: Inspector, name: str, spec: ParticipantSpec) -> Difference:
    folder = inspector.keystore.folder / layout.enclave_folder(name)
    old: Permissions | None = None
    certificate = inspector.certificate(name, folder)
    with suppress(PqsecError):  # what is not known, or differs between the sets, may grow
        refuse_other_permissions(inspector.keystore, name)
        old = inspector.permissions(name, folder)
    return permissions_diff(old, permissions_for(spec, certificate))


def changed_protection(keystore: Keystore, governance: Governance) -> Difference:
    """What a new governance changes."""
    with suppress(PqsecError):
        refuse_other_governance(keystore)
        if governance_digest(keystore) is not None:
            return governance_diff(signed_governance(keystore), governance)
    return Difference((), complete=False)


def refuse_growth(keystore: Keystore, found: Callable[[], Iterable[Difference]]) -> None:
    """KeystoreError if one of these differences needs approvals, and was not approved."""
    if keystore.approved or keystore.approvals is None:
        return
    keystore.refuse_unapproved(Covered.GROW if any(map(grows, found())) else Covered.OTHER)
