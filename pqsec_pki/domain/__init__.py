"""Brings a keystore into the state that a domain file describes.

`read_domain` reads domain.yaml, `plan` compares it with the keystore's ledger and lists the
steps, and `apply_plan` executes them. `apply` does all that in one call. `import_domain` makes a
domain file of keystores and policies. Where changes need approvals, `propose` makes of a plan
what people approve, and `approved_plan` what may be applied. `perform_order` issues what a
registration authority ordered.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.domain._profile_change import change_profile
    from pqsec_pki.domain._reconcile import has_rights
    from pqsec_pki.domain._role_values import role_value
    from pqsec_pki.domain.applying import apply, apply_plan, create_keystore, refuse_mass_revocation
    from pqsec_pki.domain.approved import ApprovedPlan, approved_plan
    from pqsec_pki.domain.commanded import (
        KINDS,
        CommandReview,
        approved_command,
        command_in,
        propose_command,
    )
    from pqsec_pki.domain.desired import Desired, Member, Role
    from pqsec_pki.domain.devices import FACTORY, Device
    from pqsec_pki.domain.importing import Imported, import_domain
    from pqsec_pki.domain.ordered import (
        OrderedIssue,
        ordered_issue,
        perform_order,
        uncovered,
    )
    from pqsec_pki.domain.planning import plan
    from pqsec_pki.domain.proposing import (
        PlanReview,
        propose,
        refuse_unapproved,
        rights_words,
    )
    from pqsec_pki.domain.reading import desired_in, new_domain, read_domain
    from pqsec_pki.domain.requests import deliver_request
    from pqsec_pki.domain.steps import Blocked, Plan, Step, StepAction
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "FACTORY",
    "KINDS",
    "ApprovedPlan",
    "Blocked",
    "CommandReview",
    "Desired",
    "Device",
    "Imported",
    "Member",
    "OrderedIssue",
    "Plan",
    "PlanReview",
    "Role",
    "Step",
    "StepAction",
    "apply",
    "apply_plan",
    "approved_command",
    "approved_plan",
    "change_profile",
    "command_in",
    "create_keystore",
    "deliver_request",
    "desired_in",
    "has_rights",
    "import_domain",
    "new_domain",
    "ordered_issue",
    "perform_order",
    "plan",
    "propose",
    "propose_command",
    "read_domain",
    "refuse_mass_revocation",
    "refuse_unapproved",
    "rights_words",
    "role_value",
    "uncovered",
]
