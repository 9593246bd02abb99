"""Stores what a domain file says beside its participants: groups, approvals, stock names."""

from collections.abc import Collection, Mapping, Sequence
from datetime import datetime

from pqsec_pki.approvals import ApprovalPolicy, Covered
from pqsec_pki.keystore import (
    Authorities,
    Keystore,
    change,
    groups_file,
    layout,
    policy_entry,
    stock_entry,
)


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


def store_stock(
    keystore: Keystore, authorities: Authorities, names: Sequence[str], *, now: datetime
) -> None:
    """Let these names and patterns, and nobody else, be met with the first set of credentials.

    The CAs sign a head with that line. KeystoreError if it needs approvals, which it does as a
    right that is given if a name is added.
    """
    with change(keystore.root, authorities) as transaction:
        grows = widens_stock(keystore, names)
        keystore.refuse_unapproved(Covered.GROW if grows else Covered.OTHER)
        transaction.record(stock_entry(names, keystore.head, now))


def widens_stock(keystore: Keystore, names: Collection[str]) -> bool:
    """Whether a name or pattern is among these that the keystore does not have."""
    return not {*names} <= {*keystore.stock}
