"""Governance and permissions: reads XML and YAML as values, and writes them.

It also handles the names in these documents: certificate subjects as text, and ROS 2 names in
their DDS form (module `ros`). The module `sros2` reads SROS2's policies.
No XML element leaves this package.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.documents import ros, sros2
    from pqsec_pki.documents._schema import Extensions, Kind, load_schemas, validate
    from pqsec_pki.documents._xml import with_line_feeds
    from pqsec_pki.documents.crashes import (
        CRASH_SHAPES,
        Crash,
        CrashShape,
        governance_crashes,
        grant_crashes,
        is_blank,
    )
    from pqsec_pki.documents.domains import MAX_DOMAIN, MAX_DOMAIN_ID, DomainRange, DomainSet
    from pqsec_pki.documents.governance import DomainRule, Governance, ProtectionKind, TopicRule
    from pqsec_pki.documents.governance_yaml import (
        governance_from_yaml,
        governance_to_yaml,
        new_governance,
    )
    from pqsec_pki.documents.markup import Token, TokenKind, tokens_of
    from pqsec_pki.documents.permissions import (
        Criteria,
        DefaultAction,
        Grant,
        PermissionRule,
        Permissions,
    )
    from pqsec_pki.documents.permissions_yaml import (
        lasting,
        new_permissions,
        permissions_from_yaml,
        permissions_to_yaml,
    )
    from pqsec_pki.documents.presets import PRESETS, Preset, preset_named
    from pqsec_pki.documents.subject import Subject, parse_subject, same_subject
    from pqsec_pki.documents.tree import Node, Tree, read_tree
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "CRASH_SHAPES",
    "MAX_DOMAIN",
    "MAX_DOMAIN_ID",
    "PRESETS",
    "Crash",
    "CrashShape",
    "Criteria",
    "DefaultAction",
    "DomainRange",
    "DomainRule",
    "DomainSet",
    "Extensions",
    "Governance",
    "Grant",
    "Kind",
    "Node",
    "PermissionRule",
    "Permissions",
    "Preset",
    "ProtectionKind",
    "Subject",
    "Token",
    "TokenKind",
    "TopicRule",
    "Tree",
    "governance_crashes",
    "governance_from_yaml",
    "governance_to_yaml",
    "grant_crashes",
    "is_blank",
    "lasting",
    "load_schemas",
    "new_governance",
    "new_permissions",
    "parse_subject",
    "permissions_from_yaml",
    "permissions_to_yaml",
    "preset_named",
    "read_tree",
    "ros",
    "same_subject",
    "sros2",
    "tokens_of",
    "validate",
    "with_line_feeds",
]
