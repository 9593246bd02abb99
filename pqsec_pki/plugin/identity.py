"""Who a local participant is: what validate_local_identity finds in its configuration."""

from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Self

from pqsec_pki.algorithms import KeyAgreement, PrivateKey, pair_private
from pqsec_pki.certificates import (
    Certificate,
    RevocationList,
    verify_chain,
    verify_not_revoked,
)
from pqsec_pki.errors import PqsecError, UsageError, VerificationError, located
from pqsec_pki.handshake import Discovered, Identity, Introduction, Policy, Terms, adjusted_guid
from pqsec_pki.plugin import credentials
from pqsec_pki.plugin.credentials import FileState, Properties, Source, state_of
from pqsec_pki.plugin.property_names import REVOCATION_LIST
from pqsec_pki.plugin.settings import Settings

CERTIFICATE = "dds.sec.auth.identity_certificate"
_CA = "dds.sec.auth.identity_ca"
_KEY = "dds.sec.auth.private_key"
_PASSWORD = "dds.sec.auth.password"  # noqa: S105 -- a property's name
_TRUSTED = "dds.sec.auth.trusted_ca_dir"
_REVOKED = REVOCATION_LIST


@dataclass(frozen=True, slots=True, kw_only=True)
class Speaker(Identity):
    """An identity with the participant data that Cyclone DDS has written for it."""

    participant_data: bytes

    def introduction(self, agreement: KeyAgreement, *, nul: bool) -> Introduction:
        """With all of that data in c.pdata: only what stands there is authenticated."""
        plain = Identity.introduction(self, agreement, nul=nul)
        return replace(plain, participant_data=self.participant_data)


@dataclass(frozen=True, slots=True, kw_only=True)
class Local:
    """A local participant: what it shows, signs with and insists on."""

    certificate: Certificate
    key: PrivateKey = field(repr=False)
    authorities: tuple[Certificate, ...]
    """Its identity CA, and others whose participants it trusts as much."""
    list_at: Source | None
    revoked: RevocationList | None
    """What its revocation list said when it last was read, and how its file was then."""
    list_state: FileState
    guid: bytes
    """16 bytes."""
    agreement: KeyAgreement
    """What it asks for."""
    policy: Policy
    permissions: bytes = field(default=b"", repr=False)
    """The signed document, once access control has said so."""

    @classmethod
    def load(cls, properties: Properties, candidate: bytes, now: datetime) -> Self:
        """Steps of DDS-Security 1.1, 9.3.3, table 52, validate_local_identity.

        VerificationError with all that is wrong, or the error of a file that is missing
        or cannot be read.
        """
        certificate = credentials.certificate_at(properties.source(CERTIFICATE))
        ca = credentials.certificate_at(properties.source(_CA))
        settings = Settings.of(certificate, properties.source(CERTIFICATE))
        policy = settings.policy(certificate)
        verify_chain(certificate, ca, now=now, require_alternative=policy.require_alternative)
        source = _list_source(properties)
        state = state_of(source)
        revoked = credentials.revocation_list_at(source) if source else None
        if revoked:
            verify_not_revoked(
                certificate, revoked, ca, now=now, require_alternative=policy.require_alternative
            )
        return cls(
            certificate=certificate,
            key=_key(properties, certificate, pair=policy.require_alternative),
            authorities=(ca, *_trusted(properties, ca)),
            list_at=source,
            revoked=revoked,
            list_state=state,
            guid=adjusted_guid(certificate.subject_der, candidate),
            agreement=settings.agreements[0],
            policy=policy,
        )

    def terms(self, discovered: Discovered, announced: bytes | None, data: bytes) -> Terms:
        """For a handshake with one peer; `data` is our participant data."""
        own = Speaker(
            certificate=self.certificate,
            key=self.key,
            ca=self.authorities[0],
            guid=self.guid,
            permissions=self.permissions,
            revocation_list=self.revoked,
            participant_data=data,
        )
        return Terms(own=own, policy=self.policy, discovered=discovered, announced=announced)

    def with_newer_list(self) -> Self:
        """The same, with the revocation list that its file has now.

        PqsecError, and nothing is changed, if that is gone or not the CA's.
        """
        state = state_of(self.list_at)
        if self.list_at is None or state == self.list_state:
            return self
        fresh = credentials.revocation_list_at(self.list_at)
        with located(self.list_at.where):
            fresh.verify(self.authorities[0], require_alternative=self.policy.require_alternative)
        return replace(self, revoked=fresh, list_state=state)

    def takes_back(self, certificate: Certificate) -> bool:
        """Whether its revocation list, as it was read last, names the certificate."""
        return self.revoked is not None and self.revoked.revocation_of(certificate) is not None

    def issuer_of(self, certificate: Certificate) -> Certificate:
        """The authority that issued a peer's certificate; ours if none of them did."""
        if len(self.authorities) > 1:
            for each in self.authorities:
                if each.subject_der == certificate.issuer_der and _signed(certificate, each):
                    return each
        return self.authorities[0]


def _signed(certificate: Certificate, authority: Certificate) -> bool:
    try:
        key = authority.public_key
        key.verify(certificate.signature, certificate.tbs, certificate.identifier)
    except PqsecError:
        return False
    return True


def _key(properties: Properties, certificate: Certificate, *, pair: bool) -> PrivateKey:
    """The key to sign with: the certificate's, or with `pair` both of its keys."""
    source, password = properties.source(_KEY), properties.optional(_PASSWORD)
    key = credentials.key_at(source, password)
    if key.public_key.spki != certificate.spki:
        raise VerificationError(f"{source.where} is not the key of {certificate.subject_name}")
    if not pair:
        return key
    beside = source.beside(f"alt.{source.path.name}") if source.path else None
    if beside is None:
        raise VerificationError(
            f"there is no alternative key for {certificate.subject_name} beside {source.where}",
            hint='put alt.key.pem there, or say peers = "stock" in pqsec.toml',
        )
    second = credentials.key_at(replace(source, path=beside), password)
    known = certificate.alternative_key
    if known is None or second.public_key.spki != known.spki:
        raise VerificationError(f"{beside} is not the alternative key in the certificate")
    return pair_private(key, second)


def _trusted(properties: Properties, ca: Certificate) -> tuple[Certificate, ...]:
    """Other identity CAs: those behind its own in the file, as in an overlap, and in a folder.

    A revocation list is its own CA's: beside one, those in the file are not trusted.
    """
    folder = properties.folder(_TRUSTED)
    found = credentials.certificates_in(folder) if folder else ()
    if not properties.optional(_REVOKED):
        found += credentials.certificates_at(properties.source(_CA))[1:]
    return tuple(each for each in found if each.der != ca.der)


def _list_source(properties: Properties) -> Source | None:
    if not properties.optional(_REVOKED):
        return None
    if properties.optional(_TRUSTED):
        raise UsageError(
            "a revocation list and a folder of trusted CAs exclude each other, as in Cyclone DDS",
            hint="the list is the identity CA's; for the others there would be none",
        )
    return properties.source(_REVOKED)
