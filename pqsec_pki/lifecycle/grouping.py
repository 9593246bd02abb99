"""Stores the groups of a domain file in the keystore, for all commands that name participants."""

from collections.abc import Mapping

from pqsec_pki.keystore import Keystore, change, groups_file, layout


def store_groups(keystore: Keystore, groups: Mapping[str, tuple[str, ...]]) -> None:
    """Replace the groups of the keystore; they need no CA key and no line in the ledger.

    KeystoreError as of `change`.
    """
    with change(keystore.root) as transaction:
        transaction.folder(".", private=False).public(layout.GROUPS, groups_file(groups))
