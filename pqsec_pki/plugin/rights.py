"""What participants may do: signed documents, applied to one subject."""

from collections.abc import Iterator
from dataclasses import field, replace
from datetime import datetime, timedelta
from typing import ClassVar

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access import SPEC, Action, Question, Viewpoint
from pqsec_pki.certificates import Certificate
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
from pqsec_pki.handshake import set_of
from pqsec_pki.problems import Code


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rights:
    """What a local or remote participant may do, as a local one decides it."""

    subject: str
    domain: int
    governance: Governance
    permissions: Permissions
    side: ClassVar[Viewpoint]
    """Who decides about the subject: its own stack or a peer."""

    @property
    def domain_rule(self) -> DomainRule:
        """The domain rule; VerificationError if the governance does not name the domain."""
        rule = self.governance.rule_for(self.domain)
        if rule is None:
            words = f"no governance rule names domain {self.domain}"
            raise VerificationError(words, code=Code.NO_DOMAIN_RULE)
        return rule

    def topic_rule(self, topic: str) -> TopicRule:
        """The topic rule; VerificationError if no rule covers the topic."""
        for rule in self.domain_rule.topic_rules:
            if SPEC.governs(rule.topic_expression, topic):
                return rule
        raise VerificationError(
            f"no topic rule of governance covers '{topic}' on domain {self.domain}"
        )

    def question(
        self, domain: int, action: Action, now: datetime, topic: str | None = None
    ) -> Question:
        """The access question for the subject. UsageError for an invalid topic name."""
        return Question(subject=self.subject, domain=domain, action=action, now=now, topic=topic)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LocalRights(Rights):
    """The rights of a local participant."""

    anchors: tuple[TrustAnchors, ...]
    """The trust anchors of each of its sets of credentials, which verify its documents and those of
    peers with certificates of that set."""
    message: bytes = field(repr=False)
    """The signed permissions document."""
    identity: int
    """The handle of the identity."""
    side: ClassVar[Viewpoint] = Viewpoint.OWN

    def anchors_for(self, certificate: Certificate) -> TrustAnchors:
        """Those of the set that a peer's certificate belongs to, which the handshake verified."""
        return self.anchors[set_of(certificate, [each.identity_cas for each in self.anchors])]


@dataclass(frozen=True, slots=True, eq=False)
class RemoteRights(Rights):
    """The rights of a peer."""

    side: ClassVar[Viewpoint] = Viewpoint.PEER


def end_of(grant: Grant, anchors: TrustAnchors) -> int:
    """The first second (of Unix time) when the grant, or a certificate that signs documents, is no
    longer valid."""
    end = min(grant.not_after, *(each.not_after for each in anchors.signers))
    return int((end + timedelta(seconds=1)).timestamp())


def anywhere(permissions: Permissions) -> Permissions:
    """The rules for topics alone: what is allowed in one partition is allowed, and rules that deny
    only in some partitions are left out."""
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
