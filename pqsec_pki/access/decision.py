"""The answer to a question about access."""

from enum import StrEnum
from typing import Self, TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents import (
    Crash,
    Criteria,
    DomainRule,
    Grant,
    Kind,
    PermissionRule,
    ProtectionKind,
    TopicRule,
)
from pqsec_pki.problems import Problem


@dataclass(frozen=True, slots=True)
class Markup:
    """A value with a comment, a CDATA section or a processing instruction in it."""

    document: Kind
    line: int | None


Part: TypeAlias = DomainRule | TopicRule | Grant | PermissionRule | Markup
"""A part of a document that can decide; each has its line."""


class Verdict(StrEnum):
    """The answer to a question about access; only for `yes` it is allowed."""

    YES = "yes"
    NO = "no"
    CRASHES = "crashes"
    """The stack's process ends when it uses the documents, its own or a peer's."""
    READERS_DIFFER = "readers differ"
    """Stacks read another value where the documents have markup in one."""

    @property
    def is_known(self) -> bool:
        """Whether the stack answers."""
        return self in {Verdict.YES, Verdict.NO}


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
    """The verdict, and why.

    `decided_by` is the part of a document that decided: a rule, or a grant with its
    validity or its default. It is None if the answer is no because a part is missing.
    `criteria` are the criteria of the rule that applied, if it has any. `protection` is None
    if no governance rule covers the question.
    """

    verdict: Verdict
    reason: str
    decided_by: Part | None = None
    criteria: Criteria | None = None
    protection: Protection | None = None

    @property
    def allowed(self) -> bool:
        """Whether the verdict is yes."""
        return self.verdict is Verdict.YES

    @property
    def yes_or_no(self) -> bool | None:
        """Yes or no; None if the verdict is neither."""
        return self.allowed if self.verdict.is_known else None


def yes(reason: str, by: Part | None = None, criteria: Criteria | None = None) -> Decision:
    return Decision(verdict=Verdict.YES, reason=reason, decided_by=by, criteria=criteria)


def no(reason: str, by: Part | None = None, criteria: Criteria | None = None) -> Decision:
    return Decision(verdict=Verdict.NO, reason=reason, decided_by=by, criteria=criteria)


def crashes(found: Crash, title: str) -> Decision:
    """The answer of the stack that `title` names."""
    return Decision(
        verdict=Verdict.CRASHES,
        reason=f"{found.shape.what} crashes {title}; {found.shape.fix}",
        decided_by=found.part,
        criteria=found.criteria,
    )


def readers_differ(document: Kind, markup: Problem) -> Decision:
    """The answer of every stack, about documents that are not read alike."""
    return Decision(
        verdict=Verdict.READERS_DIFFER,
        reason=f"<{markup.element}>: {markup.message}",
        decided_by=Markup(document, markup.line),
    )
