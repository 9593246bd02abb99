"""Decides what a participant may do, by governance and permissions.

For the self-check, the plugin and the command line. Questions follow DDS-Security 1.1, 9.4.
There is one interpretation for the standard and one for each stack, because stacks differ.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.access._checks import reason_for_several
    from pqsec_pki.access._patterns import follows_locale, opendds_reads_beyond
    from pqsec_pki.access._topics import Topics
    from pqsec_pki.access.amending import (
        TopicRights,
        add_grant,
        add_rights,
        allowed_domains,
        granted_topics,
        remove_rights,
    )
    from pqsec_pki.access.change import Change, Difference, Sense
    from pqsec_pki.access.counterparts import (
        Alone,
        CriteriaRight,
        TopicRight,
        open_rights,
        rights_of,
        without_counterpart,
    )
    from pqsec_pki.access.deciding import InterpretedPolicy, decide
    from pqsec_pki.access.decision import Decision, Markup, Part, Protection, Verdict
    from pqsec_pki.access.decryptable import Decryptable, DecryptableTopics, decryptable_later
    from pqsec_pki.access.diff import permissions_diff
    from pqsec_pki.access.everywhere import (
        Placed,
        domain_set,
        domains_named,
        domains_said,
        domains_ungoverned,
        is_known,
        topics_asked,
        who_may_anywhere,
    )
    from pqsec_pki.access.interpretation import Interpretation, Viewpoint
    from pqsec_pki.access.interpretations import (
        CYCLONEDDS,
        CYCLONEDDS_11,
        FASTDDS,
        INTERPRETATIONS,
        NAMES,
        OPENDDS,
        SPEC,
        interpretations_named,
        names_of,
    )
    from pqsec_pki.access.join import may_join
    from pqsec_pki.access.matrix import DocumentOwner, TopicRow, topics_named
    from pqsec_pki.access.question import MAX_NAME, Action, Question
    from pqsec_pki.access.sharing import ParticipantDocuments, topics_between
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "CYCLONEDDS",
    "CYCLONEDDS_11",
    "FASTDDS",
    "INTERPRETATIONS",
    "MAX_NAME",
    "NAMES",
    "OPENDDS",
    "SPEC",
    "Action",
    "Alone",
    "Change",
    "CriteriaRight",
    "Decision",
    "Decryptable",
    "DecryptableTopics",
    "Difference",
    "DocumentOwner",
    "Interpretation",
    "InterpretedPolicy",
    "Markup",
    "Part",
    "ParticipantDocuments",
    "Placed",
    "Protection",
    "Question",
    "Sense",
    "TopicRight",
    "TopicRights",
    "TopicRow",
    "Topics",
    "Verdict",
    "Viewpoint",
    "add_grant",
    "add_rights",
    "allowed_domains",
    "decide",
    "decryptable_later",
    "domain_set",
    "domains_named",
    "domains_said",
    "domains_ungoverned",
    "follows_locale",
    "granted_topics",
    "interpretations_named",
    "is_known",
    "may_join",
    "names_of",
    "open_rights",
    "opendds_reads_beyond",
    "permissions_diff",
    "reason_for_several",
    "remove_rights",
    "rights_of",
    "topics_asked",
    "topics_between",
    "topics_named",
    "who_may_anywhere",
    "without_counterpart",
]
