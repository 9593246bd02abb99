"""A local participant with all its sets of credentials, and which one it uses with a peer."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import datetime
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.certificates import Certificate
from pqsec_pki.credentials import PERMISSIONS
from pqsec_pki.handshake import (
    IdentityToken,
    PolicyRow,
    StockPeers,
    WireVersion,
    refuse_weak_set,
    set_of,
    set_to_ask_with,
)
from pqsec_pki.plugin.credentials import Properties
from pqsec_pki.plugin.identity import Local
from pqsec_pki.plugin.sets import TrustedSets
from pqsec_pki.plugin.trust import PROPERTIES

_ANY = PolicyRow(subject=None, is_stock=True)
"""The row for everybody of a participant with one set."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Participant:
    """A participant in each of its sets, that of stock stacks first; one GUID in all."""

    sets: tuple[Local, ...]
    profiles: tuple[str, ...]
    """The profile of each; empty if there is one set."""
    configured: int
    """The number of the set whose files the stack's configuration names."""
    stock: StockPeers | None
    """Who may be met with the first set; None if there is one set."""

    @classmethod
    def load(
        cls, properties: Properties, candidate: bytes, now: datetime, note: Callable[[str], None]
    ) -> Self:
        """validate_local_identity in each set; errors as of `Local.load` and `TrustedSets.of`.

        `note` is called with what a set cannot send.
        """
        trusted = TrustedSets.of(properties, now)
        found = [Local.load(each, candidate, now) for each in trusted.sets]
        for number, each in enumerate(trusted.sets):
            if not each.properties.optional(PROPERTIES[PERMISSIONS]):
                continue
            permissions = each.properties.source(PROPERTIES[PERMISSIONS])
            found[number] = found[number].with_versions_for(permissions, note)
            if number != trusted.configured:  # the stack gives those of its own configuration
                found[number] = replace(found[number], permissions=permissions.read())
        return cls(
            sets=tuple(found),
            profiles=trusted.profiles,
            configured=trusted.configured,
            stock=trusted.stock,
        )

    @property
    def guid(self) -> bytes:
        """16 bytes. It depends on the subject's name, which all sets have."""
        return self.sets[0].guid

    @property
    def first(self) -> Local:
        """That of stock stacks."""
        return self.sets[0]

    @property
    def strongest(self) -> Local:
        """That for all peers that stock does not name."""
        return self.sets[-1]

    @property
    def readable(self) -> frozenset[WireVersion]:
        """The versions of messages that some set reads; its policy decides again."""
        return frozenset[WireVersion]().union(*(each.policy.readable for each in self.sets))

    @property
    def has_list(self) -> bool:
        """Whether a set has a revocation list: then all have."""
        return any(each.revoked is not None for each in self.sets)

    def token(self) -> IdentityToken:
        """The announcement: what stock stacks see is that of the first set."""
        local, policy = self.first, self.strongest.policy
        ca = local.anchors.identity_ca
        return IdentityToken.announced(
            local.certificate, ca, policy.agreements, policy.versions, self.profiles
        )

    def asks(self, said: IdentityToken, guid: bytes) -> tuple[Local, PolicyRow]:
        """The set of a Request to the peer that announced `said` and `guid`.

        VerificationError for a name that does not belong to the GUID.
        """
        row = self._row(said, guid)
        if self.stock is None:
            return self.first, row
        certificate = self.strongest.certificate
        return self.sets[set_to_ask_with(row, said, self.profiles[-1], certificate)], row

    def answers(
        self, said: IdentityToken, guid: bytes, certificate: Certificate
    ) -> tuple[Local, PolicyRow]:
        """The set of a Reply to a peer that shows `certificate`, by the CA that it names.

        VerificationError likewise, and if our policy does not allow that set for the peer.
        """
        row, number = self._row(said, guid), self._number_of(certificate)
        if self.stock is not None:
            refuse_weak_set(row, number, self.profiles)
        return self.sets[number], row

    def set_of(self, certificate: Certificate) -> Local:
        """The set of a peer that has authenticated with `certificate`."""
        return self.sets[self._number_of(certificate)]

    def revokes(self, certificate: Certificate) -> bool:
        """Whether the revocation list of the certificate's set contains it."""
        return self.set_of(certificate).revokes(certificate)

    @property
    def is_revoked(self) -> bool:
        """Whether a set's revocation list contains its own certificate."""
        return any(each.revokes(each.certificate) for each in self.sets)

    @property
    def certificates(self) -> Iterator[Certificate]:
        """Its certificates and those of their issuers, which all must be valid."""
        for each in self.sets:
            yield from (each.certificate, each.anchors.issuer_of(each.certificate))

    def with_permissions(self, document: bytes) -> Self:
        """The same, with the document that the stack gives for its configured set."""
        sets = list(self.sets)
        sets[self.configured] = replace(sets[self.configured], permissions=document)
        return replace(self, sets=tuple(sets))

    def _row(self, said: IdentityToken, guid: bytes) -> PolicyRow:
        return _ANY if self.stock is None else self.stock.row(said, guid)

    def _number_of(self, certificate: Certificate) -> int:
        return set_of(certificate, [each.anchors.identity_cas for each in self.sets])
