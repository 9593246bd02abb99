"""Governance and permissions: what the XML says, as values, and back.

For every room that asks what a participant may do or writes it down. Here are also the
two kinds of names such documents are full of: certificate subjects as text, and ROS 2
names in their DDS form (`ros`, a module of its own). No XML element leaves this room.
"""

from pqsec_pki.documents import ros
from pqsec_pki.documents._schema import Kind, validate
from pqsec_pki.documents.domains import DomainRange, DomainSet
from pqsec_pki.documents.governance import DomainRule, Governance, ProtectionKind, TopicRule
from pqsec_pki.documents.permissions import Criteria, DefaultAction, Grant, Permissions, Rule
from pqsec_pki.documents.subject import Subject, parse_subject, same_subject

__all__ = [
    "Criteria",
    "DefaultAction",
    "DomainRange",
    "DomainRule",
    "DomainSet",
    "Governance",
    "Grant",
    "Kind",
    "Permissions",
    "ProtectionKind",
    "Rule",
    "Subject",
    "TopicRule",
    "parse_subject",
    "ros",
    "same_subject",
    "validate",
]
