"""Brings a keystore into the state that a domain file describes.

`read_domain` reads domain.yaml, `plan` compares it with the keystore's ledger and lists the
steps, and `apply_plan` executes them. `apply` does all that in one call.
"""

from pqsec_pki.domain.apply import apply, apply_plan, create_keystore, refuse_mass_revocation
from pqsec_pki.domain.desired import Desired, Member, Role
from pqsec_pki.domain.plan import plan
from pqsec_pki.domain.reading import new_domain, read_domain
from pqsec_pki.domain.steps import Blocked, Plan, Step, StepAction

__all__ = [
    "Blocked",
    "Desired",
    "Member",
    "Plan",
    "Role",
    "Step",
    "StepAction",
    "apply",
    "apply_plan",
    "create_keystore",
    "new_domain",
    "plan",
    "read_domain",
    "refuse_mass_revocation",
]
