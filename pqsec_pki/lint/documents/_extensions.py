"""What a stack takes in documents beyond DDS-Security 1.1, and where that is documented.

RTI Connext was not run. `UM`: RTI Security Plugins User's Manual; `MG`: RTI Connext Migration
Guide; both are on community.rti.com. `examples`: those of rticommunity/rticonnextdds-examples.
"""

from collections.abc import Mapping

from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents import Extensions, Node
from pqsec_pki.lint.rule import Affected
from pqsec_pki.stacks import Stack


@dataclass(frozen=True, slots=True)
class VendorElement:
    """An element that a stack takes inside some others."""

    parents: tuple[str, ...]
    tag: str
    versions: str
    """From the oldest one for which it was found in the documents."""
    source: str
    replaces: str = ""
    """The required element in whose place it stands."""


_DOMAIN, _RULES = ("domain_rule",), ("allow_rule", "deny_rule")
_CONNEXT = (
    VendorElement(_DOMAIN, "enable_key_revision", "7.5.0 and later", "MG 7.5.0"),
    VendorElement(_DOMAIN, "rtps_psk_protection_kind", "7.3.0 and later", "MG 7.3.0; UM 6.7.2.2"),
    VendorElement(
        _DOMAIN, "rtps_preshared_secret_protection_kind", "to 7.2.0", "UM 7.2.0, 6.7.2.2"
    ),
    VendorElement(_DOMAIN, "allowed_security_algorithms", "7.2.0 and later", "UM 6.7.2.9"),
    VendorElement(_DOMAIN, "monitoring_metrics_protection_kind", "7.2.0 and later", "UM 6.7.2.5"),
    VendorElement(_DOMAIN, "monitoring_logging_protection_kind", "7.2.0 and later", "UM 6.7.2.6"),
    VendorElement(_DOMAIN, "service_request_protection_kind", "7.2.0 and later", "UM 6.7.2.7"),
    VendorElement(
        _DOMAIN, "instance_state_consistency_protection_kind", "7.2.0 and later", "UM 6.7.2.8"
    ),
    VendorElement(("domains",), "tag", "7.4.0 and later", "MG 7.4.0; examples"),
    VendorElement(("domains",), "tag_expression", "7.4.0 and later", "MG 7.4.0"),
    VendorElement(_RULES, "subscribe_monitoring", "7.7.0 and later", "UM 22; examples"),
    VendorElement(
        ("grant",),
        "subject_name_expression",
        "7.4.0 and later",
        "a user's report; not found in RTI's documents",
        replaces="subject_name",
    ),
)
ROWS: Mapping[Stack, tuple[VendorElement, ...]] = {Stack.CONNEXT: _CONNEXT}

_OPTIONAL = "must_interpret"
"""With the value false, Connext skips an element that it does not know (MG 7.4.0 and 7.5.0)."""
_SKIPPED: Affected = {Stack.CONNEXT: "7.4.0 and later"}

EXTENSIONS: Mapping[Stack, Extensions] = {
    stack: Extensions(
        elements={(parent, each.tag): each.replaces for each in rows for parent in each.parents},
        attributes=frozenset({_OPTIONAL}),
        skipped=(_OPTIONAL, "false"),
    )
    for stack, rows in ROWS.items()
}


def takers(parent: str, child: Node) -> Affected:
    """The stacks, with versions, that take the element in `parent`, against DDS-Security 1.1."""
    found = {
        stack: each.versions
        for stack, rows in ROWS.items()
        for each in rows
        if each.tag == child.tag and parent in each.parents
    }
    skipped = _SKIPPED if dict(child.attributes).get(_OPTIONAL) == "false" else {}
    return {**found, **skipped}


def replacements(node: Node, missing: str) -> Affected:
    """The stacks that take a child of `node` in place of the element that it lacks."""
    found: Affected = {}
    for child in node.children:
        if any(
            (each.tag, each.replaces) == (child.tag, missing)
            for rows in ROWS.values()
            for each in rows
        ):
            found = {**found, **takers(node.tag, child)}
    return found


def all_but(taken: Affected) -> Affected:
    """The other stacks; none, which means all of them, if no stack takes it."""
    return {stack: "" for stack in Stack if stack not in taken} if taken else {}
