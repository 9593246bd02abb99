"""The governance document: how a domain and its topics are protected."""

from dataclasses import field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents import _reading, _schema, _writing
from pqsec_pki.documents._xml import with_line_feeds
from pqsec_pki.documents.domains import DomainSet
from pqsec_pki.errors import UsageError
from pqsec_pki.problems import Problem

if TYPE_CHECKING:
    from lxml.etree import _Element


class ProtectionKind(StrEnum):
    """The protection of a message; the last two use a separate key for each receiver."""

    NONE = "NONE"
    SIGN = "SIGN"
    ENCRYPT = "ENCRYPT"
    SIGN_WITH_ORIGIN_AUTHENTICATION = "SIGN_WITH_ORIGIN_AUTHENTICATION"
    ENCRYPT_WITH_ORIGIN_AUTHENTICATION = "ENCRYPT_WITH_ORIGIN_AUTHENTICATION"

    @property
    def encrypts(self) -> bool:
        """Whether others than the receivers cannot read the content."""
        return self.startswith("ENCRYPT")

    @property
    def authenticates_origin(self) -> bool:
        """Whether a receiver knows which participant sent it."""
        return self.endswith("_WITH_ORIGIN_AUTHENTICATION")


_MAX_USUAL, _DIGITS = 64 << 10, 9
"""Octets in which the domains of a usual document end, and digits of a domain id in it."""
_RULE_LINE, _TO_TOPICS = 4, 9
"""The line of its rule, and the lines from there to its topics, without those of the domains."""
_PAYLOAD_KINDS = {ProtectionKind.NONE, ProtectionKind.SIGN, ProtectionKind.ENCRYPT}


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicRule:
    """How topics whose name matches `topic_expression` (fnmatch) are protected (9.4.1.2).

    UsageError if `data_protection_kind` is one with origin authentication: payloads have
    none.
    """

    topic_expression: str
    enable_discovery_protection: bool
    enable_liveliness_protection: bool
    enable_read_access_control: bool
    enable_write_access_control: bool
    metadata_protection_kind: ProtectionKind
    data_protection_kind: ProtectionKind
    line: int | None = field(default=None, compare=False, repr=False)
    """Its line in the document; None if it was not read from one."""

    def __post_init__(self) -> None:
        if self.data_protection_kind not in _PAYLOAD_KINDS:
            raise UsageError(f"data_protection_kind cannot be {self.data_protection_kind}")

    @property
    def is_half_open(self) -> bool:
        """Whether permissions do not decide who may read, or who may write."""
        return not (self.enable_read_access_control and self.enable_write_access_control)


@dataclass(frozen=True, slots=True, kw_only=True)
class DomainRule:
    """How some domains are protected (9.4.1.2); the first topic rule that matches applies."""

    domains: DomainSet
    allow_unauthenticated_participants: bool
    enable_join_access_control: bool
    discovery_protection_kind: ProtectionKind
    liveliness_protection_kind: ProtectionKind
    rtps_protection_kind: ProtectionKind
    topic_rules: tuple[TopicRule, ...]
    line: int | None = field(default=None, compare=False, repr=False)
    """Its line in the document; None if it was not read from one."""

    def __post_init__(self) -> None:
        if not self.topic_rules:
            raise UsageError("a domain rule must have at least one topic rule")


@dataclass(frozen=True, slots=True, kw_only=True)
class Governance:
    """A governance document (DDS-Security 1.1, 9.4.1.2)."""

    domain_rules: tuple[DomainRule, ...]
    markup: tuple[Problem, ...] = ()
    """Values with markup in them, which readers read differently; each has its line."""

    def __post_init__(self) -> None:
        if not self.domain_rules:
            raise UsageError("a governance document must have at least one domain rule")

    @classmethod
    def protected(cls, domains: DomainSet) -> Self:
        """Everything on these domains is authenticated and encrypted.

        SROS2 writes the same. Every stack accepts it, but OpenDDS creates no participant unless
        some topic is open to all (its issue 5007). The whole RTPS message is signed and not
        encrypted, because discovery, liveliness, each submessage and its payload already are.
        ENCRYPT would cost twice and hide only submessage headers; SIGN is enough to refuse
        messages of outsiders.
        """
        topics = TopicRule(
            topic_expression="*",
            enable_discovery_protection=True,
            enable_liveliness_protection=True,
            enable_read_access_control=True,
            enable_write_access_control=True,
            metadata_protection_kind=ProtectionKind.ENCRYPT,
            data_protection_kind=ProtectionKind.ENCRYPT,
        )
        rule = DomainRule(
            domains=domains,
            allow_unauthenticated_participants=False,
            enable_join_access_control=True,
            discovery_protection_kind=ProtectionKind.ENCRYPT,
            liveliness_protection_kind=ProtectionKind.ENCRYPT,
            rtps_protection_kind=ProtectionKind.SIGN,
            topic_rules=(topics,),
        )
        return cls(domain_rules=(rule,))

    @classmethod
    def from_xml(cls, xml: bytes, *, any_markup: bool = False) -> Self:
        """The governance in the XML document.

        InvalidDocumentError if it is not XML, or breaks its schema, or names a domain id of more
        than 31 bits, or, unless `any_markup`, has markup in a value.
        """
        if rules := _usual_rules(xml):
            return cls(domain_rules=rules)
        rules, markup = _rules_in_elements(xml, any_markup=any_markup)
        return cls(domain_rules=rules, markup=markup)

    def to_xml(self) -> bytes:
        """The document in the form that every stack accepts, schema-valid UTF-8.

        UsageError for a topic expression with a character that XML does not allow;
        InvalidDocumentError for what crashes a stack (`crashes`), and for `markup`.
        """
        return _writing.governance_xml(self)

    def rule_for(self, domain: int) -> DomainRule | None:
        """The rule that governs `domain`: the first that names it (9.4.1.2.7)."""
        return next((rule for rule in self.domain_rules if domain in rule.domains), None)


def _usual_rules(xml: bytes) -> tuple[DomainRule, ...]:
    """The rules of a document that is, octet by octet, what pqsec writes by default; else none.

    So the first participant of a domain does not wait for lxml.
    """
    xml = with_line_feeds(xml)
    _, _, rest = xml[:_MAX_USUAL].partition(b"<domains>\n")
    ids = rest.partition(b"</domains>")[0].splitlines()
    numbers = [each.removeprefix(b"<id>").removesuffix(b"</id>") for each in ids]
    if not numbers or not all(each.isdigit() and len(each) <= _DIGITS for each in numbers):
        return ()
    usual = Governance.protected(DomainSet(parts=tuple(map(int, numbers))))
    if _writing.governance_text(usual) != xml:
        return ()
    [rule] = usual.domain_rules
    [topics] = rule.topic_rules
    topics = replace(topics, line=_RULE_LINE + len(numbers) + _TO_TOPICS)
    return (replace(rule, topic_rules=(topics,), line=_RULE_LINE),)


def _rules_in_elements(
    xml: bytes, *, any_markup: bool = False
) -> tuple[tuple[DomainRule, ...], tuple[Problem, ...]]:
    """The rules and values with markup, by the XML parser and the schema, whatever the form."""
    root, markup = _schema.read(xml, _schema.Kind.GOVERNANCE, any_markup=any_markup)
    return tuple(map(_domain_rule, root[0])), markup


# The schema fixes the number and order of the children, so they are found by position.


def _domain_rule(element: "_Element") -> DomainRule:
    domains, unauthenticated, join, discovery, liveliness, rtps, topics = element
    return DomainRule(
        domains=_reading.domains(domains),
        allow_unauthenticated_participants=_reading.boolean(unauthenticated),
        enable_join_access_control=_reading.boolean(join),
        discovery_protection_kind=ProtectionKind(_reading.text(discovery)),
        liveliness_protection_kind=ProtectionKind(_reading.text(liveliness)),
        rtps_protection_kind=ProtectionKind(_reading.text(rtps)),
        topic_rules=tuple(map(_topic_rule, topics)),
        line=_reading.line(element),
    )


def _topic_rule(element: "_Element") -> TopicRule:
    expression, discovery, liveliness, read, write, metadata, data = element
    return TopicRule(
        topic_expression=_reading.text(expression),
        enable_discovery_protection=_reading.boolean(discovery),
        enable_liveliness_protection=_reading.boolean(liveliness),
        enable_read_access_control=_reading.boolean(read),
        enable_write_access_control=_reading.boolean(write),
        metadata_protection_kind=ProtectionKind(_reading.text(metadata)),
        data_protection_kind=ProtectionKind(_reading.text(data)),
        line=_reading.line(element),
    )
