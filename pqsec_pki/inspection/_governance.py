"""Describes a governance document: who may join, and how everything is protected."""

from collections.abc import Iterator

from pqsec_pki.documents import DomainRule, Governance, ProtectionKind, TopicRule
from pqsec_pki.inspection.description import Fact, Row, Value

_PROTECTION = {
    ProtectionKind.NONE: "not protected",
    ProtectionKind.SIGN: "signed",
    ProtectionKind.ENCRYPT: "encrypted",
    ProtectionKind.SIGN_WITH_ORIGIN_AUTHENTICATION: "signed, with origin authentication",
    ProtectionKind.ENCRYPT_WITH_ORIGIN_AUTHENTICATION: "encrypted, with origin authentication",
}
_JOINING = {
    (False, True): "only participants with a certificate and permissions for the domain",
    (False, False): "any participant with a certificate; joining needs no permissions",
    (True, True): "anyone, even without a certificate; those with one also need permissions",
    (True, False): "anyone, even without a certificate",
}
"""By (allow_unauthenticated_participants, enable_join_access_control)."""


def governance_fact(governance: Governance) -> Fact:
    """The whole content of the document."""
    rows: list[Row] = []
    for number, rule in enumerate(governance.domain_rules, 1):
        first, *rest = _rule_words(rule)
        rows += [(f"domain rule {number}", first), *(("", line) for line in rest)]
    return Fact("domain_rules", tuple(map(_rule_value, governance.domain_rules)), tuple(rows))


def _rule_words(rule: DomainRule) -> Iterator[str]:
    joining = (rule.allow_unauthenticated_participants, rule.enable_join_access_control)
    yield rule.domains.words
    yield f"who may join: {_JOINING[joining]}"
    yield f"discovery: {_PROTECTION[rule.discovery_protection_kind]}"
    yield f"liveliness: {_PROTECTION[rule.liveliness_protection_kind]}"
    yield f"rtps (whole messages): {_PROTECTION[rule.rtps_protection_kind]}"
    for topic in rule.topic_rules:
        yield f"topics {topic.topic_expression}"
        yield from (f"  {line}" for line in _topic_words(topic, rule))


def _topic_words(rule: TopicRule, domain: DomainRule) -> Iterator[str]:
    free, controlled = "every participant that joined", "only with permission"
    yield f"write: {controlled if rule.enable_write_access_control else free}"
    yield f"read: {controlled if rule.enable_read_access_control else free}"
    # The topic rule enables protection, and the domain rule has its kind (9.4.1.2.6).
    protects = rule.enable_discovery_protection
    yield f"discovery: {_protection(domain.discovery_protection_kind, wanted=protects)}"
    protects = rule.enable_liveliness_protection
    yield f"liveliness: {_protection(domain.liveliness_protection_kind, wanted=protects)}"
    yield f"data: {_PROTECTION[rule.data_protection_kind]}"
    yield f"metadata (submessages): {_PROTECTION[rule.metadata_protection_kind]}"


def _protection(kind: ProtectionKind, *, wanted: bool) -> str:
    return _PROTECTION[kind if wanted else ProtectionKind.NONE]


def _rule_value(rule: DomainRule) -> dict[str, Value]:
    return {
        "domains": str(rule.domains),
        "allow_unauthenticated_participants": rule.allow_unauthenticated_participants,
        "enable_join_access_control": rule.enable_join_access_control,
        "discovery_protection_kind": rule.discovery_protection_kind.value,
        "liveliness_protection_kind": rule.liveliness_protection_kind.value,
        "rtps_protection_kind": rule.rtps_protection_kind.value,
        "topic_rules": tuple(map(_topic_value, rule.topic_rules)),
    }


def _topic_value(rule: TopicRule) -> dict[str, Value]:
    return {
        "topic_expression": rule.topic_expression,
        "enable_discovery_protection": rule.enable_discovery_protection,
        "enable_liveliness_protection": rule.enable_liveliness_protection,
        "enable_read_access_control": rule.enable_read_access_control,
        "enable_write_access_control": rule.enable_write_access_control,
        "metadata_protection_kind": rule.metadata_protection_kind.value,
        "data_protection_kind": rule.data_protection_kind.value,
    }
