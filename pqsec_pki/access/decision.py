"""The answer to a question about access."""

from typing import Self, TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents import (
    Criteria,
    DomainRule,
    Grant,
    PermissionRule,
    ProtectionKind,
    TopicRule,
)

Part: TypeAlias = DomainRule | TopicRule | Grant | PermissionRule
"""A part of a document that can decide; each has its line."""

_HOW = {
    ProtectionKind.NONE: "in the clear: anyone on the network can read and forge it",
    ProtectionKind.SIGN: "signed: anyone on the network can read it, only members can make it",
    ProtectionKind.ENCRYPT: "encrypted: only members can read it and make it",
    ProtectionKind.SIGN_WITH_ORIGIN_AUTHENTICATION: (
        "signed by its origin: anyone on the network can read it, only the sender can make it"
    ),
    ProtectionKind.ENCRYPT_WITH_ORIGIN_AUTHENTICATION: (
        "encrypted and signed by its origin: only members can read it, only the sender can make it"
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Protection:
    """What governance adds to traffic that is allowed (DDS-Security 1.1, 9.4.1.2).

    For a topic: the protection of its payload (`data`), its submessages (`metadata`), its
    discovery data (`discovery`) and its liveliness messages (`liveliness`). For a whole domain
    `data` and `metadata` are None. `rtps` is the protection of every whole message of the
    domain. With `allow_unauthenticated_participants`, participants without credentials may
    use what is not protected.
    """

    data: ProtectionKind | None
    metadata: ProtectionKind | None
    discovery: ProtectionKind
    liveliness: ProtectionKind
    rtps: ProtectionKind
    allow_unauthenticated_participants: bool

    @classmethod
    def of(cls, domain: DomainRule, topic: TopicRule | None = None) -> Self:
        """The protection by a domain rule and, for a topic, by its topic rule."""
        off = ProtectionKind.NONE
        announced = topic is None or topic.enable_discovery_protection
        alive = topic is None or topic.enable_liveliness_protection
        return cls(
            data=topic.data_protection_kind if topic else None,
            metadata=topic.metadata_protection_kind if topic else None,
            discovery=domain.discovery_protection_kind if announced else off,
            liveliness=domain.liveliness_protection_kind if alive else off,
            rtps=domain.rtps_protection_kind,
            allow_unauthenticated_participants=domain.allow_unauthenticated_participants,
        )

    @property
    def words(self) -> tuple[str, ...]:
        """A line of text for each kind of protection."""
        kinds = {
            "payload": self.data,
            "submessages": self.metadata,
            "discovery": self.discovery,
            "liveliness": self.liveliness,
            "whole messages": self.rtps,
        }
        lines = [f"{what}: {_HOW[kind]}" for what, kind in kinds.items() if kind is not None]
        allowed = self.allow_unauthenticated_participants
        may = "may use what is not protected" if allowed else "may not take part"
        return *lines, f"participants without credentials: {may}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """Yes or no, and why.

    `decided_by` is the part of a document that decided: a rule, or a grant with its
    validity or its default. It is None if the answer is no because a part is missing.
    `criteria` are the criteria of the rule that applied, if it has any. `protection` is None
    if no governance rule covers the question.
    """

    allowed: bool
    reason: str
    decided_by: Part | None = None
    criteria: Criteria | None = None
    protection: Protection | None = None


def yes(reason: str, by: Part | None = None, criteria: Criteria | None = None) -> Decision:
    return Decision(allowed=True, reason=reason, decided_by=by, criteria=criteria)


def no(reason: str, by: Part | None = None, criteria: Criteria | None = None) -> Decision:
    return Decision(allowed=False, reason=reason, decided_by=by, criteria=criteria)
