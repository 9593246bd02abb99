"""A domain as one file wants it: what differs from that in a keystore, and making it so.

For whoever keeps a fleet: `read_domain` says what domain.yaml wants, `plan` which steps lead
there from what the keystore's ledger says, and `perform` takes them.
"""

from pqsec_pki.domain.apply import apply_plan, create_keystore
from pqsec_pki.domain.desired import Desired, Member, Role
from pqsec_pki.domain.plan import plan
from pqsec_pki.domain.reading import new_domain, read_domain
from pqsec_pki.domain.steps import Action, Blocked, Plan, Step

__all__ = [
    "Action",
    "Blocked",
    "Desired",
    "Member",
    "Plan",
    "Role",
    "Step",
    "apply_plan",
    "create_keystore",
    "new_domain",
    "plan",
    "read_domain",
]
