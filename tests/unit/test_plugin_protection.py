"""How governance protects what a participant makes, as Cyclone DDS is told it."""

from dataclasses import replace

import pytest

from pqsec_pki.documents import DomainSet, Governance, Grant, Permissions, ProtectionKind
from pqsec_pki.errors import VerificationError
from pqsec_pki.plugin import attributes
from pqsec_pki.plugin.rights import RemoteRights
from pqsec_pki.problems import Code
from tests.unit.keystores import DAY, NOW

ENCRYPTED, BY_ORIGIN = 1, 4
"""Bits of PluginEndpointSecurityAttributes (DDS-Security 1.1, 9.4.2.6)."""
DISCOVERY = ("DCPSParticipantsSecure", "DCPSPublicationsSecure", "DCPSSubscriptionsSecure")
LIVELINESS, KEYS = "DCPSParticipantMessageSecure", "DCPSParticipantVolatileMessageSecure"


def of_builtin(topic, *, discovery=ProtectionKind.NONE, liveliness=ProtectionKind.NONE):
    """Whether submessages are protected, and the bits that say how."""
    [rule] = Governance.protected(DomainSet.of(0)).domain_rules
    rule = replace(rule, discovery_protection_kind=discovery, liveliness_protection_kind=liveliness)
    found = attributes.of_builtin(rule, topic)
    assert found.plugin & attributes.VALID
    return found.submessage, found.plugin & ~attributes.VALID


def test_a_builtin_topic_is_protected_as_its_own_kind_says_and_not_as_another_does():
    bits = {
        ProtectionKind.NONE: (0, 0),
        ProtectionKind.SIGN: (1, 0),
        ProtectionKind.ENCRYPT: (1, ENCRYPTED),
        ProtectionKind.SIGN_WITH_ORIGIN_AUTHENTICATION: (1, BY_ORIGIN),
        ProtectionKind.ENCRYPT_WITH_ORIGIN_AUTHENTICATION: (1, ENCRYPTED | BY_ORIGIN),
    }
    for kind, wanted in bits.items():
        for topic in DISCOVERY:
            assert of_builtin(topic, discovery=kind) == wanted
            assert of_builtin(topic, liveliness=kind) == (0, 0)
        assert of_builtin(LIVELINESS, liveliness=kind) == wanted
        assert of_builtin(LIVELINESS, discovery=kind) == (0, 0)


def test_keys_are_exchanged_encrypted_whatever_governance_says():
    assert of_builtin(KEYS) == (1, ENCRYPTED)


def test_what_finds_participants_before_they_authenticate_is_not_protected():
    kinds = dict.fromkeys(("discovery", "liveliness"), ProtectionKind.ENCRYPT)
    plain = attributes.BUILTIN - {*DISCOVERY, LIVELINESS, KEYS}
    assert {topic: of_builtin(topic, **kinds) for topic in plain} == dict.fromkeys(plain, (0, 0))


def rights(domain, *expressions):
    """Of somebody on `domain`, where domain 0 has rules for those topics alone."""
    [rule] = Governance.protected(DomainSet.of(0)).domain_rules
    topics = tuple(replace(rule.topic_rules[0], topic_expression=each) for each in expressions)
    governance = Governance(domain_rules=(replace(rule, topic_rules=topics),))
    grant = Grant.least(
        subject_name="CN=x", not_before=NOW - DAY, not_after=NOW + DAY, domains=DomainSet.of(0)
    )
    permissions = Permissions(grants=(grant,))
    return RemoteRights(
        subject="CN=x", domain=domain, governance=governance, permissions=permissions
    )


def test_the_first_topic_rule_that_covers_a_topic_protects_it():
    ours = rights(0, "rt/a*", "rt/*")
    for topic, expression in {"rt/arm": "rt/a*", "rt/leg": "rt/*"}.items():
        assert ours.topic_rule(topic).topic_expression == expression
    with pytest.raises(VerificationError, match="no topic rule of governance covers 'rq/arm'"):
        ours.topic_rule("rq/arm")


def test_a_domain_that_governance_does_not_name_has_no_protection_to_tell():
    assert rights(0, "*").domain_rule.topic_rules
    with pytest.raises(VerificationError, match="no governance rule names domain 1") as caught:
        rights(1, "*").topic_rule("rt/arm")
    assert caught.value.codes == {Code.NO_DOMAIN_RULE}
