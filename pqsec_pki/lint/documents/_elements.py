"""The elements of governance and permissions, from their schemas."""

_DOMAIN_RULE = (
    "domains",
    "allow_unauthenticated_participants",
    "enable_join_access_control",
    "discovery_protection_kind",
    "liveliness_protection_kind",
    "rtps_protection_kind",
    "topic_access_rules",
)
_TOPIC_RULE = (
    "topic_expression",
    "enable_discovery_protection",
    "enable_liveliness_protection",
    "enable_read_access_control",
    "enable_write_access_control",
    "metadata_protection_kind",
    "data_protection_kind",
)
_RULE = (("domains",), ("publish",), ("subscribe",), ("relay",))
_CRITERIA = (("topics", "partitions", "data_tags"),)
_DOMAINS = (("id", "id_range"),)

CHILDREN: dict[str, tuple[tuple[str, ...], ...]] = {
    "dds": (("domain_access_rules", "permissions"),),
    "domain_access_rules": (("domain_rule",),),
    "domain_rule": tuple((tag,) for tag in _DOMAIN_RULE),
    "topic_access_rules": (("topic_rule",),),
    "topic_rule": tuple((tag,) for tag in _TOPIC_RULE),
    "permissions": (("grant",),),
    "grant": (("subject_name",), ("validity",), ("allow_rule", "deny_rule"), ("default",)),
    "validity": (("not_before",), ("not_after",)),
    "allow_rule": _RULE,
    "deny_rule": _RULE,
    "publish": _CRITERIA,
    "subscribe": _CRITERIA,
    "relay": _CRITERIA,
    "domains": _DOMAINS,
    "id_range": (("min",), ("max",)),
    "topics": (("topic",),),
    "partitions": (("partition",),),
    "data_tags": (("tag",),),
    "tag": (("name", "value"),),
}
"""Element -> its children in order; those in one inner tuple may be in any order."""

NEW = {"enable_key_revision", "rtps_psk_protection_kind", "allowed_security_algorithms"}
"""Elements of DDS-Security 1.2."""
BOOLEANS = tuple(tag for tag in (*_DOMAIN_RULE, *_TOPIC_RULE) if tag.startswith(("allow", "enab")))
KINDS = tuple(tag for tag in (*_DOMAIN_RULE, *_TOPIC_RULE) if tag.endswith("_kind"))
WORDS = {"ALLOW", "DENY", "NONE", "SIGN", "ENCRYPT"} | {
    f"{word}_WITH_ORIGIN_AUTHENTICATION" for word in ("SIGN", "ENCRYPT")
}
NAMES = ("topic", "topic_expression", "partition")
SCHEMA_ATTRIBUTES = {"xmlns:xsi", "xsi:noNamespaceSchemaLocation"}
"""As they are written: Cyclone DDS knows no prefixes, and takes them in every element."""
NEEDED: dict[str, tuple[str, ...]] = {
    "domain_rule": _DOMAIN_RULE[1:],  # PQS217 is about <domains>, PQS216 about <default>
    "topic_rule": _TOPIC_RULE,
    "grant": ("subject_name", "validity"),
    "validity": ("not_before", "not_after"),
}
