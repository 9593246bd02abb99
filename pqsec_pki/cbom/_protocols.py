"""The protocols of DDS-Security as assets: authentication with its suites, and protection."""

from collections.abc import Iterable, Mapping

from cyclonedx.model.crypto import (
    CryptoAssetType,
    CryptoProperties,
    ProtocolProperties,
    ProtocolPropertiesCipherSuite,
    ProtocolPropertiesType,
)

from pqsec_pki.algorithms import Family, KeyAgreement, Profile, SignatureAlgorithm, usual_agreements
from pqsec_pki.cbom import _algorithms
from pqsec_pki.cbom._assets import Asset, Assets, bom_refs
from pqsec_pki.certificates import Certificate
from pqsec_pki.documents import DomainRule, ProtectionKind
from pqsec_pki.errors import PqsecError

AUTHENTICATION, PROTECTION = "DDS:Auth:PKI-DH", "DDS:Crypto:AES-GCM-GMAC"
VERSION = "1.0"
"""The version of both plugins in DDS-Security 1.1 (clauses 9.3 and 9.5)."""
_GMAC, _GCM = "AES256-GMAC", "AES256-GCM"
_CIPHERS = {
    ProtectionKind.SIGN: _GMAC,
    ProtectionKind.SIGN_WITH_ORIGIN_AUTHENTICATION: _GMAC,
    ProtectionKind.ENCRYPT: _GCM,
    ProtectionKind.ENCRYPT_WITH_ORIGIN_AUTHENTICATION: _GCM,
}
_DERIVATION = ("HMAC-SHA256", "SHA-256")
"""The functions that derive session keys from the shared secret."""
Suite = tuple[SignatureAlgorithm, KeyAgreement]


def add_authentication(
    assets: Assets, certificates: Iterable[tuple[Certificate, str, Profile | None]]
) -> None:
    """Add the handshake, with a suite for each key of participants and its key agreements.

    A plain classical key is for stock peers, which have the key agreements of the standard. Other
    keys use the key agreement of the profile beside the certificate, that of its set of
    credentials, else of the profile with such keys. What both sides choose at run time can be
    restricted further.
    """
    suites: dict[str, Suite] = {}
    places: set[str] = set()
    for certificate, place, profile in certificates:
        places.add(place)
        for row, agreement in _suites(certificate, profile):
            suites[f"{row.wire_name} with {agreement.wire_name}"] = (row, agreement)
    if not suites:
        return
    digest = _algorithms.symmetric(assets, "SHA-256")
    named = {
        name: (
            _algorithms.handshake_row(assets, row),
            _algorithms.agreement_row(assets, agreement),
            digest,
        )
        for name, (row, agreement) in suites.items()
    }
    levels = {name: min(each.level for each in suite) for name, suite in suites.items()}
    _add(assets, AUTHENTICATION, named, levels, places)


def add_protection(assets: Assets, rules: Iterable[tuple[DomainRule, str]]) -> None:
    """Add the protection of messages that governance requires; nothing if it requires none."""
    ciphers: set[str] = set()
    places: set[str] = set()
    for rule, place in rules:
        found = {_CIPHERS[kind] for kind in _kinds(rule) if kind in _CIPHERS}
        ciphers |= found
        places |= {place} if found else set()
    named = {
        name: tuple(_algorithms.symmetric(assets, each) for each in (name, *_DERIVATION))
        for name in ciphers
    }
    if named:
        _add(assets, PROTECTION, named, {}, places)


def _suites(certificate: Certificate, profile: Profile | None) -> Iterable[Suite]:
    try:
        keys, second = certificate.handshake_keys, certificate.alternative_key
    except PqsecError:  # a key of a kind that pqsec cannot use
        return
    own = certificate.public_key.algorithm
    for key in keys:
        alternative = second.algorithm if second and key.algorithm is not own else None
        agreements = usual_agreements(own, alternative)
        if profile is not None and key.algorithm.family is not Family.CLASSICAL:
            agreements = (profile.key_agreement,)
        yield from ((key.algorithm, each) for each in agreements)


def _kinds(rule: DomainRule) -> set[ProtectionKind]:
    kinds = {
        rule.discovery_protection_kind,
        rule.liveliness_protection_kind,
        rule.rtps_protection_kind,
    }
    for topic in rule.topic_rules:
        kinds |= {topic.metadata_protection_kind, topic.data_protection_kind}
    return kinds


def _add(
    assets: Assets,
    name: str,
    suites: Mapping[str, tuple[str, ...]],
    levels: Mapping[str, int],
    places: set[str],
) -> None:
    needs = tuple(sorted({ref for refs in suites.values() for ref in refs}))
    properties = ProtocolProperties(
        type=ProtocolPropertiesType.OTHER,
        version=VERSION,
        cipher_suites=[
            ProtocolPropertiesCipherSuite(name=each, algorithms=bom_refs(refs))
            for each, refs in suites.items()
        ],
    )
    asset = Asset(
        ref=f"protocol:{name}",
        name=name,
        crypto=CryptoProperties(
            asset_type=CryptoAssetType.PROTOCOL, protocol_properties=properties
        ),
        needs=needs,
        details=tuple(
            (f"nistQuantumSecurityLevel:{each}", str(level)) for each, level in levels.items()
        ),
    )
    assets.add(asset, *places)
