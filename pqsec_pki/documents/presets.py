"""Governance for the common cases, each with what it protects and what it costs.

Every stack accepts them: no element of DDS-Security 1.2, no payload with origin authentication,
and unauthenticated participants only where RTPS messages are not protected (Fast DDS 3 refuses
both together). With any of them, OpenDDS creates no participant until a topic rule opens some
topic to all (its issue 5007).
"""

from collections.abc import Iterable
from dataclasses import replace
from difflib import get_close_matches

from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents.domains import DomainSet
from pqsec_pki.documents.governance import DomainRule, Governance, ProtectionKind, TopicRule
from pqsec_pki.errors import UsageError

_NONE, _SIGN, _ENCRYPT = ProtectionKind.NONE, ProtectionKind.SIGN, ProtectionKind.ENCRYPT


@dataclass(frozen=True, slots=True, kw_only=True)
class Preset:
    """A named level of protection."""

    name: str
    summary: str
    """Its purpose, in one line."""
    protects: str
    costs: str
    """What it does not protect, and its cost in bytes and processing."""
    rule: DomainRule
    """The rule for domain 0, with one topic rule for all topics."""

    @property
    def topic_rule(self) -> TopicRule:
        """The rule for every topic."""
        return self.rule.topic_rules[-1]

    def governance(self, domains: DomainSet) -> Governance:
        """This protection on these domains."""
        return Governance(domain_rules=(replace(self.rule, domains=domains),))


[_PROTECTED] = Governance.protected(DomainSet.of(0)).domain_rules
[_ALL_TOPICS] = _PROTECTED.topic_rules
_SIGNED = replace(_ALL_TOPICS, metadata_protection_kind=_SIGN, data_protection_kind=_NONE)
_SEEN = replace(_ALL_TOPICS, enable_discovery_protection=False, enable_liveliness_protection=False)
_LIGHT = replace(_ALL_TOPICS, enable_liveliness_protection=False, metadata_protection_kind=_NONE)

STRICT = Preset(
    name="strict",
    summary="Everything is authenticated and encrypted. The default.",
    protects=(
        "Only participants with credentials join, and a listener on the network learns no data, no"
        " topic and no type. SROS2 and `pqsec ca init` write this governance."
    ),
    costs=(
        "About 70 bytes for each message, 56 for each submessage and 44 for each sample, and"
        " AES-GCM over all of it. Network tools see ciphertext. The permissions, with topic"
        " names, still travel in clear in the handshake: that is how DDS-Security 1.1 works."
    ),
    rule=_PROTECTED,
)
AUTHENTICATED = Preset(
    name="authenticated",
    summary="Everything is authenticated, nothing is secret.",
    protects=(
        "Only participants with permissions join, publish and subscribe, and nobody else can forge"
        " or alter what they send. Captures stay readable, which helps while a system is built."
    ),
    costs=(
        "Anyone on the network reads all data. About 70 bytes for each message and 48 for each"
        " submessage; GMAC, which is cheaper than AES-GCM where there is no AES in the processor."
    ),
    rule=replace(
        _PROTECTED,
        discovery_protection_kind=_SIGN,
        liveliness_protection_kind=_SIGN,
        topic_rules=(_SIGNED,),
    ),
)
OPEN_DISCOVERY = Preset(
    name="open-discovery",
    summary="Data is encrypted; participants and topics can be seen.",
    protects=(
        "Data as in strict: only participants with permissions join, publish, subscribe and read."
        " Monitors, recorders of traffic and discovery tools see participants, topics, types and"
        " QoS, and large systems start faster, without key exchanges for discovery."
    ),
    costs=(
        "An attacker learns the structure of the system: names of topics, types, nodes. Discovery"
        " is still signed, as part of whole messages. Otherwise as strict."
    ),
    rule=replace(
        _PROTECTED,
        discovery_protection_kind=_NONE,
        liveliness_protection_kind=_NONE,
        topic_rules=(_SEEN,),
    ),
)
LOSSY_NETWORK = Preset(
    name="lossy-network",
    summary="Data and discovery are encrypted, with the fewest bytes for each packet.",
    protects=(
        "Data is encrypted once for each sample, before it is cut into fragments, so a repeated"
        " fragment is sent again as it was and large samples cost the same as small ones. For"
        " radio, and for images and point clouds."
    ),
    costs=(
        "Heartbeats, acknowledgements and assertions of liveliness are not authenticated: an"
        " attacker on the network can hold up or stop delivery, but neither read nor alter data."
        " 44 bytes for each sample, and nothing for each packet or fragment."
    ),
    rule=replace(
        _PROTECTED,
        liveliness_protection_kind=_NONE,
        rtps_protection_kind=_NONE,
        topic_rules=(_LIGHT,),
    ),
)
MIGRATION = Preset(
    name="migration",
    summary="Unsecured participants may stay in the domain, without access to the data.",
    protects=(
        "Data as in strict, on all topics but those you open. Participants without security are"
        " let in, and use the topics whose own rule turns all access control and protection off."
    ),
    costs=(
        "Anyone on the network can join the domain and see its participants and topics; opened"
        " topics have no protection at all. Whole messages cannot be signed, because unsecured"
        " participants could not read them. Use it only during the migration."
    ),
    rule=replace(
        _PROTECTED,
        allow_unauthenticated_participants=True,
        discovery_protection_kind=_NONE,
        liveliness_protection_kind=_NONE,
        rtps_protection_kind=_NONE,
        topic_rules=(_SEEN,),
    ),
)

PRESETS = (STRICT, AUTHENTICATED, OPEN_DISCOVERY, LOSSY_NETWORK, MIGRATION)
"""All of them, the default first."""


def preset_named(name: str, presets: Iterable[Preset] = PRESETS) -> Preset:
    """The preset `name`; UsageError, with the nearest name, if there is none."""
    rows = {preset.name: preset for preset in presets}
    if name in rows:
        return rows[name]
    near = get_close_matches(name, rows, n=1)
    hint = f"did you mean {near[0]}?" if near else "`pqsec governance presets` explains them"
    raise UsageError(f"{name!r} is not a preset: choose from {', '.join(rows)}", hint=hint)
