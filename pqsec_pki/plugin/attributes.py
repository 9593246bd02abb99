"""How governance protects participants and endpoints, as the bits that DDS stacks exchange.

DDS-Security 1.1, 7.4.8, 8.4.2.7 to 8.4.2.9 and 9.4.2.3 to 9.4.2.6.
"""

from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents import DomainRule, ProtectionKind, TopicRule

VALID = 1 << 31
_BY_DISCOVERY = {"DCPSParticipantsSecure", "DCPSPublicationsSecure", "DCPSSubscriptionsSecure"}
_BY_LIVELINESS = "DCPSParticipantMessageSecure"
_VOLATILE = "DCPSParticipantVolatileMessageSecure"
_PLAIN = {
    *("DCPSParticipant", "DCPSPublication", "DCPSSubscription", "DCPSTopic"),
    *("DCPSParticipantMessage", "DCPSParticipantStatelessMessage"),
    *("DCPSTypeLookupRequest", "DCPSTypeLookupReply"),
}
BUILTIN = frozenset({*_BY_DISCOVERY, _BY_LIVELINESS, _VOLATILE, *_PLAIN})
"""Topics that Cyclone DDS creates for itself; permissions do not apply to them."""


@dataclass(frozen=True, slots=True)
class ParticipantAttributes:
    """ParticipantSecurityAttributes, in Cyclone DDS's order."""

    allow_unauthenticated: int
    access: int
    rtps: int
    discovery: int
    liveliness: int
    plugin: int


@dataclass(frozen=True, slots=True)
class TopicAttributes:
    """TopicSecurityAttributes, in Cyclone DDS's order."""

    read: int = 0
    write: int = 0
    discovery: int = 0
    liveliness: int = 0


@dataclass(frozen=True, slots=True)
class EndpointAttributes:
    """EndpointSecurityAttributes, in Cyclone DDS's order."""

    read: int = 0
    write: int = 0
    discovery: int = 0
    liveliness: int = 0
    submessage: int = 0
    payload: int = 0
    key: int = 0
    plugin: int = 0


def of_participant(rule: DomainRule) -> ParticipantAttributes:
    """9.4.2.3 and 9.4.2.4: for three kinds of traffic, whether encrypted, and whether by origin."""
    rtps, discovery = rule.rtps_protection_kind, rule.discovery_protection_kind
    liveliness = rule.liveliness_protection_kind
    plugin = VALID
    for bit, kind in enumerate((rtps, discovery, liveliness)):
        plugin |= kind.encrypts << bit | kind.authenticates_origin << bit + 3
    return ParticipantAttributes(
        int(rule.allow_unauthenticated_participants),
        int(rule.enable_join_access_control),
        int(rtps is not ProtectionKind.NONE),
        int(discovery is not ProtectionKind.NONE),
        int(liveliness is not ProtectionKind.NONE),
        plugin,
    )


def of_topic(rule: TopicRule) -> TopicAttributes:
    """8.4.2.8."""
    return TopicAttributes(
        int(rule.enable_read_access_control),
        int(rule.enable_write_access_control),
        int(rule.enable_discovery_protection),
        int(rule.enable_liveliness_protection),
    )


def of_endpoint(rule: TopicRule) -> EndpointAttributes:
    """9.4.2.5 and 9.4.2.6. If a payload is encrypted, so is its key hash."""
    topic, data = of_topic(rule), rule.data_protection_kind
    submessage = rule.metadata_protection_kind
    encrypted = data is ProtectionKind.ENCRYPT
    return EndpointAttributes(
        topic.read,
        topic.write,
        topic.discovery,
        topic.liveliness,
        int(submessage is not ProtectionKind.NONE),
        int(data is not ProtectionKind.NONE),
        int(encrypted),
        _submessage_bits(submessage) | encrypted << 1,
    )


def of_builtin(rule: DomainRule, topic: str) -> EndpointAttributes:
    """8.4.2.9: discovery and liveliness as in the domain rule; the key exchange is encrypted."""
    if topic == _VOLATILE:
        return _protected(ProtectionKind.ENCRYPT)
    if topic == _BY_LIVELINESS:
        return _protected(rule.liveliness_protection_kind)
    if topic in _BY_DISCOVERY:
        return _protected(rule.discovery_protection_kind)
    return EndpointAttributes(plugin=VALID)


def _protected(kind: ProtectionKind) -> EndpointAttributes:
    protected = int(kind is not ProtectionKind.NONE)
    return EndpointAttributes(submessage=protected, plugin=_submessage_bits(kind))


def _submessage_bits(kind: ProtectionKind) -> int:
    return VALID | kind.encrypts | kind.authenticates_origin << 2
