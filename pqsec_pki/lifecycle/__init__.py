"""The operations on a keystore: issue, renew, revoke, sign, replace the CAs, adopt.

Each is one change of the keystore, made wholly or not at all.

Participants and documents:
    issuing       issues new participants; `_issuer` makes their files, and `_key_checks` refuses
                  keys that are compromised or another participant's
    renewing      renews participants; `_inspector` finds the newest files of each
    signing       signs governance and permissions again, and heads of the ledger
    permitting    changes single rights of participants
    growing       whether documents to be signed give more than those that are signed
    revoking      revokes certificates and issues revocation lists
CAs:
    adding        adds a set of credentials of another profile; `_sets` has what other changes do in
                  each set
    additions     which participants it would be for, and what is in its way; `_alike` issues them
                  what they have
    removing      removes a set of credentials
    rollover      the options of replacing CAs, and the plan; `rollover_plan` makes the plan,
                  `rollover_apply` executes it, `_ca_changes` creates CAs
    passphrase    changes the passphrase of the CA keys
    grouping      stores groups and stock names of a domain file, and whose approvals are needed
    fetching      gets what another machine with the same ledger wrote
    moving        moves the ledger from its file into a database, and back
    registering   grants for registration authorities, and their end
    adopting      makes another tool's keystore a pqsec keystore; `_scan` finds what it contains
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.lifecycle._issuer import Issued, PublicKeys
    from pqsec_pki.lifecycle.adding import AddedSet, add_set
    from pqsec_pki.lifecycle.additions import Addable, addable
    from pqsec_pki.lifecycle.adopting import Adoptable, Adopted, adopt, adoptable
    from pqsec_pki.lifecycle.fetching import fetch_files
    from pqsec_pki.lifecycle.grouping import (
        store_approvals,
        store_groups,
        store_stock,
        widens_stock,
    )
    from pqsec_pki.lifecycle.growing import changed_protection, changed_rights, grows
    from pqsec_pki.lifecycle.issuing import ParticipantSpec, issue
    from pqsec_pki.lifecycle.moving import IN_A_FILE, LedgerMove, move_ledger
    from pqsec_pki.lifecycle.passphrase import change_passphrase
    from pqsec_pki.lifecycle.permitting import (
        PermissionsChange,
        changed_permissions,
        earlier_ends,
        sign_changed,
    )
    from pqsec_pki.lifecycle.registering import add_registration, end_registrations
    from pqsec_pki.lifecycle.removing import RemovedSet, removable_set, remove_set
    from pqsec_pki.lifecycle.renewing import Renewal, lasts_longer, renew
    from pqsec_pki.lifecycle.revoking import (
        LIST_VALIDITY,
        REVOCATIONS,
        Revoked,
        renew_list,
        revocable,
        revoke,
    )
    from pqsec_pki.lifecycle.rollover import (
        CA_VALIDITY,
        OverlapStep,
        Rollover,
        RolloverPlan,
        Scope,
        refuse_keys_in_files,
    )
    from pqsec_pki.lifecycle.rollover_apply import RolloverResult, apply_rollover
    from pqsec_pki.lifecycle.rollover_plan import plan_rollover
    from pqsec_pki.lifecycle.signing import (
        sign_document,
        sign_governance,
        sign_head,
        sign_permissions,
    )
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "CA_VALIDITY",
    "IN_A_FILE",
    "LIST_VALIDITY",
    "REVOCATIONS",
    "Addable",
    "AddedSet",
    "Adoptable",
    "Adopted",
    "Issued",
    "LedgerMove",
    "OverlapStep",
    "ParticipantSpec",
    "PermissionsChange",
    "PublicKeys",
    "RemovedSet",
    "Renewal",
    "Revoked",
    "Rollover",
    "RolloverPlan",
    "RolloverResult",
    "Scope",
    "add_registration",
    "add_set",
    "addable",
    "adopt",
    "adoptable",
    "apply_rollover",
    "change_passphrase",
    "changed_permissions",
    "changed_protection",
    "changed_rights",
    "earlier_ends",
    "end_registrations",
    "fetch_files",
    "grows",
    "issue",
    "lasts_longer",
    "move_ledger",
    "plan_rollover",
    "refuse_keys_in_files",
    "removable_set",
    "remove_set",
    "renew",
    "renew_list",
    "revocable",
    "revoke",
    "sign_changed",
    "sign_document",
    "sign_governance",
    "sign_head",
    "sign_permissions",
    "store_approvals",
    "store_groups",
    "store_stock",
    "widens_stock",
]
