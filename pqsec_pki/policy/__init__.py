"""Questions to policies: explain, who-may and diff, answered from a keystore or from files.

    loading        a document from a file, with its lines
    participants   a participant's verified documents, from its keystore
    answers        the answer of each stack to one access question, on each domain
    fleet          the participants of a keystore, or of permissions documents
    who_may        who may publish and subscribe to each topic
    named_rights   whether a participant may do what takes several topics, as to serve a service
    reasons        why one of them may
    one_sided      topics of some participants that look like mistakes
    differences    the rights that a change of documents or keystores grants and removes

The room `access` decides; this room reads the documents for it.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.policy.answers import Answer, DomainsAnswer
    from pqsec_pki.policy.differences import DocumentDifference, differences_between
    from pqsec_pki.policy.fleet import Fleet, fleet_in, fleet_of
    from pqsec_pki.policy.flow import Flow, flows
    from pqsec_pki.policy.loading import (
        Loaded,
        document_at,
        governance_in,
        only_subject,
        permissions_in,
        signed_by,
        valid_kind,
    )
    from pqsec_pki.policy.named_rights import NamedRight, RightAnswer, Use, answer_right
    from pqsec_pki.policy.one_sided import doubtful_topics, locale_doubt
    from pqsec_pki.policy.participants import (
        PolicyInput,
        own_permissions,
        policy_input_of,
        shared_governance,
    )
    from pqsec_pki.policy.reasons import Explanation, reason_of
    from pqsec_pki.policy.who_may import WhoMay, who_may_by_each, who_may_use
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "Answer",
    "DocumentDifference",
    "DomainsAnswer",
    "Explanation",
    "Fleet",
    "Flow",
    "Loaded",
    "NamedRight",
    "PolicyInput",
    "RightAnswer",
    "Use",
    "WhoMay",
    "answer_right",
    "differences_between",
    "document_at",
    "doubtful_topics",
    "fleet_in",
    "fleet_of",
    "flows",
    "governance_in",
    "locale_doubt",
    "only_subject",
    "own_permissions",
    "permissions_in",
    "policy_input_of",
    "reason_of",
    "shared_governance",
    "signed_by",
    "valid_kind",
    "who_may_by_each",
    "who_may_use",
]
