"""Stores what a domain file says beside its participants: groups, and demanded approvals."""

from collections.abc import Mapping
from datetime import datetime

from pqsec_pki.approvals import ApprovalPolicy, Covered
from pqsec_pki.keystore import Authorities, Keystore, change, groups_file, layout, policy_entry


def store_groups(keystore: Keystore, groups: Mapping[str, tuple[str, ...]]) -> None:
    """Replace the groups of the keystore; they need no CA key and no line in the ledger.

    KeystoreError as of `change`.
    """
    with change(keystore.root) as transaction:
        keystore.refuse_unapproved(Covered.OTHER)
        transaction.folder(".", private=False).public(layout.GROUPS, groups_file(groups))


def store_approvals(
    keystore: Keystore, authorities: Authorities, policy: ApprovalPolicy | None, *, now: datetime
) -> None:
    """Demand approvals from now on as `policy` says, or none; the CAs sign a head with that line.

    KeystoreError if the policy until now demands approvals for that.
    """
    with change(keystore.root, authorities) as transaction:
        keystore.refuse_unapproved(Covered.APPROVALS)
        transaction.record(policy_entry(policy, keystore.head, now))
