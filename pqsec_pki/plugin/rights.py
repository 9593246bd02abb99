"""What participants may do: signed documents, and what they say of one subject."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from typing import ClassVar

from pqsec_pki.access import SPEC, Action, Question, Viewpoint
from pqsec_pki.credentials import TrustAnchors
from pqsec_pki.documents import (
    Criteria,
    DomainRule,
    Governance,
    Grant,
    PermissionRule,
    Permissions,
    TopicRule,
)
from pqsec_pki.errors import VerificationError
from pqsec_pki.problems import Code


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rights:
    """What a participant may do, local or remote, in the eyes of a local one."""

    subject: str
    domain: int
    governance: Governance
    permissions: Permissions
    side: ClassVar[Viewpoint]
    """Who asks what the subject may: its own stack or a peer."""

    @property
    def domain_rule(self) -> DomainRule:
        """VerificationError if governance does not name the domain."""
        rule = self.governance.rule_for(self.domain)
        if rule is None:
            words = f"no governance rule names domain {self.domain}"
            raise VerificationError(words, code=Code.NO_DOMAIN_RULE)
        return rule

    def topic_rule(self, topic: str) -> TopicRule:
        """VerificationError if no rule covers the topic."""
        for rule in self.domain_rule.topic_rules:
            if SPEC.governs(rule.topic_expression, topic):
                return rule
        raise VerificationError(
            f"no topic rule of governance covers '{topic}' on domain {self.domain}"
        )

    def question(
        self, domain: int, action: Action, now: datetime, topic: str | None = None
    ) -> Question:
        """May the subject do that? UsageError for a name that cannot be one."""
        return Question(subject=self.subject, domain=domain, action=action, now=now, topic=topic)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LocalRights(Rights):
    """Those of a local participant."""

    anchors: TrustAnchors
    """Whose signatures on documents count, its peers' too."""
    message: bytes = field(repr=False)
    """The signed permissions document."""
    identity: int
    """The handle of the identity."""
    side: ClassVar[Viewpoint] = Viewpoint.OWN


@dataclass(frozen=True, slots=True, eq=False)
class RemoteRights(Rights):
    """Those of a peer."""

    side: ClassVar[Viewpoint] = Viewpoint.PEER


def end_of(grant: Grant, anchors: TrustAnchors) -> int:
    """The first second since 1970 when the grant is no longer in force, or one of those who
    sign documents is no longer good."""
    end = min(grant.not_after, *(each.not_after for each in anchors.signers))
    return int((end + timedelta(seconds=1)).timestamp())


def anywhere(permissions: Permissions) -> Permissions:
    """What they say of topics alone: allowed in one partition is allowed, denied in one is not."""
    return Permissions(grants=tuple(map(_grant_anywhere, permissions.grants)))


def _grant_anywhere(grant: Grant) -> Grant:
    return replace(grant, rules=tuple(map(_rule_anywhere, grant.rules)))


def _rule_anywhere(rule: PermissionRule) -> PermissionRule:
    return replace(
        rule,
        publish=tuple(_criteria_anywhere(rule, rule.publish)),
        subscribe=tuple(_criteria_anywhere(rule, rule.subscribe)),
        relay=tuple(_criteria_anywhere(rule, rule.relay)),
    )


def _criteria_anywhere(rule: PermissionRule, criteria: tuple[Criteria, ...]) -> Iterator[Criteria]:
    for each in criteria:
        if rule.allow or not (each.partitions or each.data_tags):
            yield replace(each, partitions=(), data_tags=())
