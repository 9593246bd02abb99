"""Valid documents that crash stacks, for tests of pqsec and of the stacks themselves."""

from dataclasses import dataclass

from pqsec_pki.documents import Governance, Permissions

PERMISSIONS = b"""\
<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="x">
<permissions><grant name="/lab/alice"><subject_name>CN=/lab/alice</subject_name>
<validity><not_before>2026-01-01T00:00:00Z</not_before><not_after>2060-01-01T00:00:00Z</not_after>
</validity>
<deny_rule><domains><id_range><min>7</min><max>8</max></id_range></domains></deny_rule>
<allow_rule><domains><id_range><min>0</min><max>9</max></id_range></domains>
<publish><topics><topic>rt/chatter</topic><topic>rt/p</topic></topics></publish>
<subscribe><topics><topic>rt/s</topic></topics></subscribe>
<relay><topics><topic>rt/r</topic></topics></relay></allow_rule>
<default>DENY</default></grant></permissions></dds>
"""
GOVERNANCE = b"""\
<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="x">
<domain_access_rules><domain_rule><domains><id_range><min>0</min><max>9</max></id_range></domains>
<allow_unauthenticated_participants>false</allow_unauthenticated_participants>
<enable_join_access_control>true</enable_join_access_control>
<discovery_protection_kind>ENCRYPT</discovery_protection_kind>
<liveliness_protection_kind>ENCRYPT</liveliness_protection_kind>
<rtps_protection_kind>SIGN</rtps_protection_kind><topic_access_rules>
<topic_rule><topic_expression>*</topic_expression>
<enable_discovery_protection>true</enable_discovery_protection>
<enable_liveliness_protection>true</enable_liveliness_protection>
<enable_read_access_control>true</enable_read_access_control>
<enable_write_access_control>true</enable_write_access_control>
<metadata_protection_kind>ENCRYPT</metadata_protection_kind>
<data_protection_kind>ENCRYPT</data_protection_kind></topic_rule></topic_access_rules>
</domain_rule></domain_access_rules></dds>
"""


def spoiled(xml: bytes, *replacements: bytes) -> bytes:
    """The document with each old text, which it has once, changed to the new one.

    With three texts, the first is where to look: the old one is changed in it.
    """
    within, old, new = replacements if len(replacements) > 2 else (xml, *replacements)
    assert xml.count(within) == within.count(old) == 1, within
    return xml.replace(within, within.replace(old, new))


@dataclass(frozen=True)
class Crashing:
    """A document that crashes stacks, and the place."""

    kind: type[Governance] | type[Permissions]
    xml: bytes
    line: int
    """Of the rule, or of its criteria."""
    stacks: str = "cyclonedds@0.10 cyclonedds@11.0"
    """Names of interpretations."""


def _permissions(line: int, *change: bytes) -> Crashing:
    return Crashing(Permissions, spoiled(PERMISSIONS, *change), line)


def _governance(new: bytes) -> Crashing:
    xml = spoiled(GOVERNANCE, b">*<", new)
    return Crashing(Governance, xml, 8, "cyclonedds@0.10 cyclonedds@11.0 fastdds")


CRASHING = {
    "a range without min": _permissions(6, b"<min>0</min>", b""),
    "in a deny_rule": _permissions(5, b"<min>7</min>", b""),
    "behind an id": _permissions(6, b"<id_range><min>0</min>", b"<id>3</id><id_range>"),
    "an empty topic": _permissions(7, b">rt/chatter<", b"><"),
    "an empty element": _permissions(8, b"<topic>rt/s</topic>", b"<topic/>"),
    "behind another topic": _permissions(7, b">rt/p<", b"><"),
    "a topic of white space": _permissions(7, b">rt/chatter<", b"> \t <"),
    "a topic of escaped white space": _permissions(7, b">rt/chatter<", b">&#9;&#32;&#13;&#10;<"),
    "an empty expression": _governance(b"><"),
    "an expression of white space": _governance(b"> \n <"),
}
