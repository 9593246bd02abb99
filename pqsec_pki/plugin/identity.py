"""A local participant: the result of validate_local_identity."""

from collections.abc import Callable
from dataclasses import field, replace
from datetime import datetime
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import KeyAgreement, PrivateKey, pair_private
from pqsec_pki.certificates import Certificate, RevocationList
from pqsec_pki.credentials import (
    ALT_KEY,
    CERTIFICATE,
    KEY,
    TrustAnchors,
    key_problems,
)
from pqsec_pki.errors import FileError, PqsecError, UsageError, located
from pqsec_pki.handshake import (
    Discovered,
    Identity,
    Introduction,
    PeerRequirements,
    Terms,
    WireVersion,
    adjusted_guid,
    check_carried,
)
from pqsec_pki.plugin import credentials, trust
from pqsec_pki.plugin.credentials import PASSWORD, FileState, Properties, Source, state_of
from pqsec_pki.plugin.trust import ParticipantTrust
from pqsec_pki.problems import Code, Problem

_WAY_OUT = 'put all files of the enclave there, or set peers = "stock" in pqsec.toml'


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalIdentity(Identity):
    """An identity with the participant data that the stack gave for it."""

    participant_data: bytes

    def introduction(self, agreement: KeyAgreement, *, nul: bool) -> Introduction:
        """All participant data is in c.pdata: peers authenticate only the content of c.pdata."""
        plain = Identity.introduction(self, agreement, nul=nul)
        return replace(plain, participant_data=self.participant_data)


@dataclass(frozen=True, slots=True, kw_only=True)
class Local:
    """A local participant in one set: its certificate, keys, trust anchors and requirements."""

    certificate: Certificate
    key: PrivateKey = field(repr=False)
    anchors: TrustAnchors
    """The CAs that it trusts, with the revocation list that applies."""
    list_at: Source | None
    list_state: FileState
    """The state of the list's file when it was last read."""
    guid: bytes
    """16 bytes."""
    agreement: KeyAgreement
    """The key agreement that it proposes."""
    policy: PeerRequirements
    permissions: bytes = field(default=b"", repr=False)
    """The signed permissions document; empty until access control has set it."""

    @classmethod
    def load(cls, trusted: ParticipantTrust, candidate: bytes, now: datetime) -> Self:
        """Steps of DDS-Security 1.1, 9.3.3, table 52, validate_local_identity.

        VerificationError with all problems, or the error of a file that is missing or cannot
        be read.
        """
        properties = trusted.properties
        certificate, anchors = trusted.certificate, trusted.anchors
        policy = trusted.settings.policy(certificate)
        key, second = _keys(properties, both=policy.require_alternative)
        problems = [*anchors.problems(now), *anchors.own_identity_problems(certificate, now)]
        problems += key_problems(certificate, key, second, alone=anchors.stock_peers)
        if policy.require_alternative and not anchors.signed_twice:
            words = "it has an alternative key, and the identity CA has none"
            problems.append(Problem(words, Code.ALTERNATIVE_MISSING, CERTIFICATE))
        if problems:
            missing = policy.require_alternative and (second is None or not anchors.countersigner)
            hint = _WAY_OUT if missing else None
            raise trust.refusal(problems, trust.places(properties), hint=hint)
        return cls(
            certificate=certificate,
            key=pair_private(key, second) if second else key,
            anchors=anchors,
            list_at=trusted.list_at,
            list_state=trusted.list_state,
            guid=adjusted_guid(certificate.subject_der, candidate),
            agreement=trusted.settings.agreements[0],
            policy=policy,
        )

    def with_versions_for(self, permissions: Source, note: Callable[[str], None]) -> Self:
        """This identity, without the second version if that cannot carry our own documents.

        Cyclone DDS announces the versions before it sets the permissions, so these are read here;
        access control reports a file that cannot be read. UsageError if there is no other version.
        """
        policy = self.policy
        if WireVersion.SECOND not in policy.readable:
            return self
        try:
            with located(permissions.where):
                check_carried(self.certificate.pem, permissions.read())
        except FileError:
            return self
        except PqsecError as error:
            rest = tuple(each for each in policy.versions if each is not WireVersion.SECOND)
            if not rest:
                hint = "put wire_versions = [2, 1] in pqsec.toml, or leave it out"
                raise UsageError(str(error), hint=hint) from error
            note(f"{error}; version 1 is used")
            return replace(self, policy=replace(policy, versions=rest))
        return self

    @property
    def revoked(self) -> RevocationList | None:
        """Its revocation list as it was last read; None if it has none."""
        return self.anchors.revocation_list

    def terms(self, discovered: Discovered, announced: bytes | None, data: bytes) -> Terms:
        """The terms of a handshake with one peer; `data` is our participant data."""
        own = LocalIdentity(
            certificate=self.certificate,
            key=self.key,
            ca=self.anchors.identity_ca,
            guid=self.guid,
            permissions=self.permissions,
            revocation_list=self.revoked,
            participant_data=data,
        )
        return Terms(own=own, policy=self.policy, discovered=discovered, announced=announced)

    def with_newer_list(self) -> Self:
        """This identity, with the revocation list that its file has now.

        PqsecError if the file is missing or its CA did not sign it.
        """
        state = state_of(self.list_at)
        if self.list_at is None or state == self.list_state:
            return self
        fresh = credentials.revocation_list_at(self.list_at)
        with located(self.list_at.where):
            fresh.verify(self.anchors.identity_ca, require_alternative=self.anchors.signed_twice)
        return replace(self.with_list(fresh), list_state=state)

    def with_list(self, fresh: RevocationList) -> Self:
        """This identity, with the revocation list `fresh`."""
        return replace(self, anchors=replace(self.anchors, revocation_list=fresh))

    def revokes(self, certificate: Certificate) -> bool:
        """Whether its revocation list, as last read, contains the certificate, or is not for it."""
        return self.revoked is not None and (
            self.revoked.revocation_of(certificate) is not None
            or not self.revoked.covers(certificate)
        )


def _keys(properties: Properties, *, both: bool) -> tuple[PrivateKey, PrivateKey | None]:
    """The certificate's key, and with `both` its alternative key, if that exists."""
    password = properties.optional(PASSWORD)
    key = credentials.key_at(properties.source(trust.PROPERTIES[KEY]), password)
    beside = trust.beside(properties, ALT_KEY) if both else None
    return key, credentials.key_at(beside, password) if beside else None
