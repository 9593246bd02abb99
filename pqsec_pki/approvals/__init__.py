"""Changes of a keystore that others than the CAs' holder decide, and the proof that they did.

    approval_policy   whose approvals are needed, how many, and for which changes
    proposal          a plan that is proposed: what exactly would change, from which state
    approval          one person's signature over a proposal; whether there are enough
    registration      what a registration authority may order, signed by the identity CA
    enrolment_order   what it orders
    _canonical        the JSON that is signed (RFC 8785), read strictly

Values and signatures only: no files, no clock. `domain` makes proposals of plans, and applies them.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.approvals.approval import Approval, approval_in, approve, refuse_without
    from pqsec_pki.approvals.approval_policy import ApprovalPolicy, Covered
    from pqsec_pki.approvals.enrolment_order import EnrolmentOrder, OrderedName
    from pqsec_pki.approvals.proposal import (
        MAX_PROPOSAL,
        ChangedRights,
        PlanProposal,
        ProposedStep,
        proposal_file,
        proposal_in,
    )
    from pqsec_pki.approvals.registration import MAX_GRANT, RegistrationGrant, SignedGrant
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "MAX_GRANT",
    "MAX_PROPOSAL",
    "Approval",
    "ApprovalPolicy",
    "ChangedRights",
    "Covered",
    "EnrolmentOrder",
    "OrderedName",
    "PlanProposal",
    "ProposedStep",
    "RegistrationGrant",
    "SignedGrant",
    "approval_in",
    "approve",
    "proposal_file",
    "proposal_in",
    "refuse_without",
]
