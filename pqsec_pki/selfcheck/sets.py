"""The sides of a handshake of participants with several sets, by the plugin's policy.

Each has all sets of the keystore, or, as a stock stack, the first one only. The initiator chooses
the set of its Request, and the replier that of its Reply, as pqsec's plugin does.
"""

from collections.abc import Sequence
from dataclasses import replace

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import Profile
from pqsec_pki.handshake import IdentityToken, StockPeers, initiates, set_to_ask_with
from pqsec_pki.selfcheck.session import SessionSide, SideSets


@dataclass(frozen=True, slots=True)
class PartyInSets:
    """A participant in each set that it has, that of stock stacks first."""

    profiles: tuple[Profile, ...]
    sides: tuple[SessionSide, ...]

    @classmethod
    def of(cls, profiles: Sequence[Profile], sides: Sequence[SessionSide]) -> "PartyInSets":
        """The same, with one GUID in all sets."""
        guid = sides[0].guid
        return cls(tuple(profiles), tuple(each.with_guid(guid) for each in sides))

    @property
    def guid(self) -> bytes:
        """16 bytes."""
        return self.sides[0].guid

    @property
    def token(self) -> IdentityToken:
        """What discovery announces."""
        first, last = self.sides[0], self.sides[-1]
        own = first.terms.own
        if first.stack.is_stock:
            return IdentityToken.of(own.certificate, own.ca)
        names = [each.name for each in self.profiles]
        policy = last.terms.policy
        return IdentityToken.announced(
            own.certificate, own.ca, policy.agreements, policy.versions, names
        )

    def meeting(self, peer: "PartyInSets", stock: StockPeers) -> tuple[SessionSide, Profile]:
        """Its side as it asks that peer, which can still answer with another set; with the profile.

        VerificationError if the peer's name does not belong to its GUID.
        """
        if len(self.sides) == 1:
            return self.sides[0], self.profiles[0]
        names = tuple(each.name for each in self.profiles)
        row = stock.row(peer.token, peer.guid)
        certificate = self.sides[-1].terms.own.certificate
        number = set_to_ask_with(row, peer.token, names[-1], certificate)
        sets = SideSets(profiles=names, sides=self.sides, row=row)
        return replace(self.sides[number], sets=sets), self.profiles[number]


def sides_by_policy(
    one: PartyInSets, other: PartyInSets, stock: StockPeers
) -> tuple[SessionSide, SessionSide, Profile]:
    """Initiator and replier, and the profile of the set that the initiator asks with."""
    first, second = (one, other) if initiates(one.guid, other.guid) else (other, one)
    initiator, profile = first.meeting(second, stock)
    return initiator, second.meeting(first, stock)[0], profile
