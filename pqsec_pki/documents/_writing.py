"""Writes governance and permissions as XML, in the form that every stack accepts.

Elements are in the order of the schemas, and values have no white space around them: Fast DDS or
Cyclone DDS would refuse anything else.
"""

import re
from collections.abc import Iterable, Iterator
from datetime import datetime
from typing import TYPE_CHECKING, TypeAlias

from pqsec_pki._times import said
from pqsec_pki.documents._schema import Kind, validate
from pqsec_pki.documents.crashes import Crash, governance_crashes, grant_crashes
from pqsec_pki.documents.domains import DomainRange
from pqsec_pki.errors import InvalidDocumentError, UsageError
from pqsec_pki.problems import Problem

if TYPE_CHECKING:
    from pqsec_pki.documents.governance import DomainRule, Governance, TopicRule
    from pqsec_pki.documents.permissions import Criteria, Grant, PermissionRule, Permissions

LAST_YEAR = 2261
"""Cyclone DDS counts nanoseconds in 64 bits: it treats a later time as past."""

Element: TypeAlias = tuple[str, str | Iterable["Element"]]
"""A tag, perhaps with attributes, and its text or its elements."""

_DOCUMENT = """\
<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="\
http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_{kind}.xsd">
{content}</dds>
"""
# XML 1.0, production 2. Compiled only when needed: that takes some milliseconds.
_NOT_XML = "[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]"
_ESCAPES = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&#34;", "'": "&#39;"})
# A parser would change these to spaces or line feeds if they were not escaped.
_ESCAPES |= str.maketrans({"\t": "&#9;", "\n": "&#10;", "\r": "&#13;"})


def governance_xml(governance: "Governance") -> bytes:
    """The document. UsageError for a character that XML does not allow.

    InvalidDocumentError for what crashes a stack, or what readers read differently.
    """
    _refuse(governance.markup, governance_crashes(governance.domain_rules))
    return _valid(governance_text(governance))


def governance_text(governance: "Governance") -> bytes:
    """The document, not yet validated: that takes lxml."""
    rules = map(_domain_rule, governance.domain_rules)
    return _document(Kind.GOVERNANCE, ("domain_access_rules", rules))


def permissions_xml(permissions: "Permissions") -> bytes:
    """The document. Errors as above, and UsageError for a time that no stack understands."""
    _refuse(permissions.markup, grant_crashes(permissions.grants))
    return _valid(_document(Kind.PERMISSIONS, ("permissions", map(_grant, permissions.grants))))


def _refuse(markup: Iterable[Problem], crashes: Iterable[Crash]) -> None:
    if problems := [*markup, *(each.problem for each in crashes)]:
        raise InvalidDocumentError(problems)


def _document(kind: Kind, content: Element) -> bytes:
    return _DOCUMENT.format(kind=kind, content="".join(_lines(content))).encode()


def _valid(xml: bytes) -> bytes:
    validate(xml)
    return xml


def _lines(element: Element) -> Iterator[str]:
    """Without indentation: a stack has little room for permissions in a message."""
    tag, content = element
    if isinstance(content, str):
        yield f"<{tag}>{_escaped(content)}</{tag}>\n"
        return
    yield f"<{tag}>\n"
    for each in content:
        yield from _lines(each)
    yield f"</{tag.partition(' ')[0]}>\n"


def _domain_rule(rule: "DomainRule") -> Element:
    return "domain_rule", (
        ("domains", map(_domain, rule.domains.parts)),
        ("allow_unauthenticated_participants", _boolean(rule.allow_unauthenticated_participants)),
        ("enable_join_access_control", _boolean(rule.enable_join_access_control)),
        ("discovery_protection_kind", rule.discovery_protection_kind),
        ("liveliness_protection_kind", rule.liveliness_protection_kind),
        ("rtps_protection_kind", rule.rtps_protection_kind),
        ("topic_access_rules", map(_topic_rule, rule.topic_rules)),
    )


def _topic_rule(rule: "TopicRule") -> Element:
    return "topic_rule", (
        ("topic_expression", rule.topic_expression),
        ("enable_discovery_protection", _boolean(rule.enable_discovery_protection)),
        ("enable_liveliness_protection", _boolean(rule.enable_liveliness_protection)),
        ("enable_read_access_control", _boolean(rule.enable_read_access_control)),
        ("enable_write_access_control", _boolean(rule.enable_write_access_control)),
        ("metadata_protection_kind", rule.metadata_protection_kind),
        ("data_protection_kind", rule.data_protection_kind),
    )


def _grant(grant: "Grant") -> Element:
    validity = (("not_before", _time(grant.not_before)), ("not_after", _time(grant.not_after)))
    return f'grant name="{_escaped(grant.name)}"', (
        ("subject_name", grant.subject_name),
        ("validity", validity),
        *map(_rule, grant.rules),
        ("default", grant.default),
    )


def _rule(rule: "PermissionRule") -> Element:
    return "allow_rule" if rule.allow else "deny_rule", (
        ("domains", map(_domain, rule.domains.parts)),
        *(("publish", _criteria(each)) for each in rule.publish),
        *(("subscribe", _criteria(each)) for each in rule.subscribe),
        *(("relay", _criteria(each)) for each in rule.relay),
    )


def _criteria(criteria: "Criteria") -> Iterator[Element]:
    yield "topics", [("topic", each) for each in criteria.topics]
    if criteria.partitions:
        yield "partitions", [("partition", each) for each in criteria.partitions]
    if criteria.data_tags:
        yield (
            "data_tags",
            [("tag", (("name", name), ("value", value))) for name, value in criteria.data_tags],
        )


def _domain(part: int | DomainRange) -> Element:
    if not isinstance(part, DomainRange):
        return "id", str(part)
    last = () if part.last is None else (("max", str(part.last)),)
    return "id_range", (("min", str(part.first)), *last)


def _boolean(value: bool) -> str:  # noqa: FBT001 -- it is what is written
    return "true" if value else "false"


def _escaped(value: str) -> str:
    if not value.isprintable() and (found := re.search(_NOT_XML, value)):
        raise UsageError(f"{value!r} has the character {found[0]!r}, which XML cannot carry")
    return value.translate(_ESCAPES)


def _time(value: datetime) -> str:
    if value.year > LAST_YEAR:
        raise UsageError(
            f"{said(value)} is too late: to Cyclone DDS, any time after {LAST_YEAR} is expired"
        )
    return f"{value.replace(tzinfo=None).isoformat()}Z"
