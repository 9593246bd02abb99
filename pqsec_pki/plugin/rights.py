"""What participants may do: signed documents, and what they say of one subject."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from typing import ClassVar, Self

from pqsec_pki.access import SPEC, Action, Question, Side
from pqsec_pki.algorithms import Family
from pqsec_pki.certificates import Certificate, verify_authority
from pqsec_pki.documents import (
    Criteria,
    DomainRule,
    Governance,
    Grant,
    Permissions,
    Rule,
    TopicRule,
)
from pqsec_pki.errors import VerificationError
from pqsec_pki.plugin import credentials
from pqsec_pki.plugin.credentials import Properties
from pqsec_pki.smime import Require, verify

_CA = "dds.sec.access.permissions_ca"


@dataclass(frozen=True, slots=True)
class Signers:
    """Who signs documents here: the permissions CA, and who countersigns."""

    ca: Certificate
    alternative: Certificate | None

    @classmethod
    def load(cls, properties: Properties) -> Self:
        """The configured CA, and `*.alt.cert.pem` beside it."""
        source = properties.source(_CA)
        name = source.path.name if source.path else ""
        other = name.replace(".cert.pem", ".alt.cert.pem")
        beside = source.beside(other) if other != name else None
        second = credentials.certificate_at(replace(source, path=beside)) if beside else None
        return cls(credentials.certificate_at(source), second)

    @property
    def end(self) -> datetime:
        """When the first of them is no longer good."""
        return min(each.not_after for each in (self.ca, self.alternative) if each)

    def document(self, message: bytes, now: datetime) -> bytes:
        """What they signed; VerificationError if they did not."""
        verify_authority(self.ca, now=now)
        require = Require.ANY
        if self.alternative:
            verify_authority(self.alternative, now=now)
            require = Require.BOTH
        elif self.ca.public_key.algorithm.family is Family.PQ:
            require = Require.PQ
        found = verify(
            message, self.ca, alternative_ca=self.alternative, require=require, pinned=True
        )
        return found.document


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rights:
    """What a participant may do, local or remote, in the eyes of a local one."""

    subject: str
    domain: int
    governance: Governance
    permissions: Permissions
    side: ClassVar[Side]
    """Who asks what the subject may: its own stack or a peer."""

    @property
    def domain_rule(self) -> DomainRule:
        """VerificationError if governance does not name the domain."""
        rule = self.governance.rule_for(self.domain)
        if rule is None:
            raise VerificationError(f"no governance rule names domain {self.domain}")
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

    def end(self, now: datetime, signers: Signers) -> int:
        """The first second since 1970 when the subject's grant is no longer in force, or
        one of those who signed it is no longer good."""
        grant = SPEC.grant_for(self.permissions, self.question(self.domain, Action.JOIN, now))
        if grant is None:
            raise VerificationError(f"no grant is for {self.subject}")
        if not SPEC.in_force(grant, now):
            raise VerificationError(
                f"grant '{grant.name}' is good from {grant.not_before} to {grant.not_after} only"
            )
        end = min(grant.not_after, signers.end)
        return int((end + timedelta(seconds=1)).timestamp())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Own(Rights):
    """Those of a local participant."""

    signers: Signers
    message: bytes = field(repr=False)
    """The signed permissions document."""
    identity: int
    """The handle of the identity."""
    side: ClassVar[Side] = Side.OWN


@dataclass(frozen=True, slots=True, eq=False)
class Theirs(Rights):
    """Those of a peer."""

    side: ClassVar[Side] = Side.PEER


def anywhere(permissions: Permissions) -> Permissions:
    """What they say of topics alone: allowed in one partition is allowed, denied in one is not."""
    return Permissions(grants=tuple(map(_grant_anywhere, permissions.grants)))


def _grant_anywhere(grant: Grant) -> Grant:
    return replace(grant, rules=tuple(map(_rule_anywhere, grant.rules)))


def _rule_anywhere(rule: Rule) -> Rule:
    return replace(
        rule,
        publish=tuple(_criteria_anywhere(rule, rule.publish)),
        subscribe=tuple(_criteria_anywhere(rule, rule.subscribe)),
        relay=tuple(_criteria_anywhere(rule, rule.relay)),
    )


def _criteria_anywhere(rule: Rule, criteria: tuple[Criteria, ...]) -> Iterator[Criteria]:
    for each in criteria:
        if rule.allow or not (each.partitions or each.data_tags):
            yield replace(each, partitions=(), data_tags=())
