"""The operations on a keystore: issue, renew, revoke, sign, replace the CAs, adopt.

Each is one change of the keystore, made wholly or not at all.

Participants and documents:
    issuing       issues new participants; `_issuer` makes their files, and `_key_checks` refuses
                  keys that are compromised or another participant's
    renewing      renews participants; `_inspector` finds the newest files of each
    signing       signs governance and permissions again
    revoking      revokes certificates and issues revocation lists
CAs:
    rotating      replaces CAs; `rollover` has the options, `rollover_plan` the preview,
                  `_rollover_transaction` the steps
    overlapping   replaces the identity CA while the old one is still trusted
    passphrase    changes the passphrase of the CA keys
    adopting      makes another tool's keystore a pqsec keystore; `_scan` finds what it contains
"""

from pqsec_pki.lifecycle._issuer import Issued, PublicKeys
from pqsec_pki.lifecycle.adopting import Adopted, adopt
from pqsec_pki.lifecycle.issuing import ParticipantSpec, issue
from pqsec_pki.lifecycle.overlapping import (
    BegunOverlap,
    begin_overlap,
    cancel_overlap,
    check_begin,
    finish_overlap,
    switch_overlap,
)
from pqsec_pki.lifecycle.passphrase import change_passphrase
from pqsec_pki.lifecycle.renewing import Renewal, renew
from pqsec_pki.lifecycle.revoking import LIST_VALIDITY, Revoked, renew_list, revoke
from pqsec_pki.lifecycle.rollover import CA_VALIDITY, Rollover, Scope
from pqsec_pki.lifecycle.rollover_plan import RolloverPlan, plan_rollover
from pqsec_pki.lifecycle.rotating import Rotated, rotate
from pqsec_pki.lifecycle.signing import sign_document, sign_governance, sign_permissions

__all__ = [
    "CA_VALIDITY",
    "LIST_VALIDITY",
    "Adopted",
    "BegunOverlap",
    "Issued",
    "ParticipantSpec",
    "PublicKeys",
    "Renewal",
    "Revoked",
    "Rollover",
    "RolloverPlan",
    "Rotated",
    "Scope",
    "adopt",
    "begin_overlap",
    "cancel_overlap",
    "change_passphrase",
    "check_begin",
    "finish_overlap",
    "issue",
    "plan_rollover",
    "renew",
    "renew_list",
    "revoke",
    "rotate",
    "sign_document",
    "sign_governance",
    "sign_permissions",
    "switch_overlap",
]
