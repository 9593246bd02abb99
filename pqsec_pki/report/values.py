"""The sections of a report, as values. Names of participants, topics and files are as read."""

from datetime import datetime
from enum import StrEnum

from pqsec_pki._dataclass import dataclass
from pqsec_pki.keystore import ListDelivery, RobotState, State
from pqsec_pki.lint import Severity
from pqsec_pki.migration import MigrationPlan

FORMAT = 1
"""The format of the JSON, which --compare reads."""


@dataclass(frozen=True, slots=True)
class Gap:
    """What the report lacks, because it could not be read or is not valid."""

    section: str
    """The section, as in its heading."""
    reason: str


class HolderExtent(StrEnum):
    """Which members of a group may use the topics of a row."""

    ALL = "all"
    OWN = "own"
    """For each topic, the members whose name is in it."""
    OTHERS = "others"
    """For each topic, all members except those whose name is in it."""
    SOME = "some"


@dataclass(frozen=True, slots=True, kw_only=True)
class ParticipantGroup:
    """Participants whose permissions differ only in their names. It may have one member."""

    label: str
    """The common form of its members' names; `{name}` stands for the part that differs."""
    members: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Holder:
    """A group, or some of it, that may publish or subscribe to the topics of a row."""

    group: ParticipantGroup
    extent: HolderExtent
    members: tuple[str, ...]
    """For SOME, who; else empty."""
    reason: str
    """Why it is allowed, for the first member and the first topic."""
    place: str
    """The file and line of the rule that decided; empty if a part of no document did."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RightsRow:
    """Topics that the same participants may use, on some domains."""

    label: str
    """The topic, or the topics' common name; what differs is `{name}`."""
    topics: tuple[str, ...]
    is_pattern: bool
    domains: str
    publishers: tuple[Holder, ...]
    subscribers: tuple[Holder, ...]
    partitions: str = ""
    """In words; empty for the default partition."""

    @property
    def where(self) -> str:
        """The domains and partitions."""
        return _where(self.domains, self.partitions)


@dataclass(frozen=True, slots=True)
class Right:
    """What one participant may do with one topic."""

    participant: str
    action: str
    """publish or subscribe."""
    topic: str
    domains: str
    partitions: str = ""
    """In words; empty for the default partition."""

    @property
    def where(self) -> str:
        """The domains and partitions."""
        return _where(self.domains, self.partitions)

    def __str__(self) -> str:
        return f"{self.participant} may {self.action} {self.topic} on {self.where}"


@dataclass(frozen=True, slots=True, kw_only=True)
class RightsSection:
    """Who may use which topic."""

    groups: tuple[ParticipantGroup, ...]
    rows: tuple[RightsRow, ...]
    every: tuple[Right, ...]
    """All rights, one by one, for JSON, CSV and comparisons."""
    topics: tuple[str, ...]
    """All topics and patterns that a rule names, also those that no participant may use."""
    refused: dict[str, str]
    """Participants whose documents are not valid -> why; they have no rights."""
    until: dict[str, datetime]
    """When the rights of each participant end."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ending:
    """Certificates, lists or documents of one kind that end on the same day."""

    kind: str
    at: datetime
    """The first of them."""
    names: tuple[str, ...]


class Strength(StrEnum):
    """What is left if there is a quantum computer."""

    BROKEN = "broken"
    UNKNOWN = "unknown"
    PARTLY = "partly"
    HOLDS = "holds"


@dataclass(frozen=True, slots=True, kw_only=True)
class Exposure:
    """One use of cryptography, and what a quantum computer does to it."""

    use: str
    """Such as `participants' identities`."""
    algorithm: str
    profile: str
    strength: Strength
    consequence: str
    names: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class FindingPlace:
    """Where a rule is violated."""

    path: str
    line: int | None
    message: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}" if self.line else self.path


@dataclass(frozen=True, slots=True, kw_only=True)
class FindingGroup:
    """All findings of one rule."""

    rule: str
    severity: Severity
    title: str
    why: str
    fix: str
    places: tuple[FindingPlace, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class FindingsSection:
    """The findings of `pqsec check`."""

    groups: tuple[FindingGroup, ...]
    files: int
    """How many files were read."""
    ignored: tuple[tuple[str, str, str], ...]
    """(rule, path, reason) of each suppressed finding."""

    def count(self, severity: Severity) -> int:
        """How many findings are of that severity."""
        return sum(len(each.places) for each in self.groups if each.severity == severity)


@dataclass(frozen=True, slots=True, kw_only=True)
class LedgerEvent:
    """Lines of the ledger that one command wrote, of one kind."""

    first: int
    """The number of its first line."""
    at: str
    operator: str
    what: str
    names: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class HandshakeSize:
    """Participants whose largest handshake message has the same size."""

    message: int
    """Bytes, as `certificate` and `permissions`."""
    certificate: int
    permissions: int
    profile: str
    """That of the set of credentials."""
    names: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ParticipantRow:
    """The state of one participant."""

    name: str
    state: State
    not_after: datetime
    profile: str
    domains: str
    serial: str
    superseded: tuple[datetime, ...]
    """The ends of certificates before this one that are still valid."""
    further: "tuple[ParticipantRow, ...]" = ()
    """Its certificates in the further sets of credentials; `state` is that of all sets."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AuthorityRow:
    """A CA, or the revocation list."""

    kind: str
    name: str
    state: State
    not_after: datetime
    algorithm: str
    """Empty for the list."""
    fingerprint: str
    """SHA-256 of the certificate's DER or of the list's file, in hex; empty if that is gone."""
    set_name: str = ""
    """The further set of credentials that it is of; empty for the first one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """Values with which others can compare the report."""

    head: str
    """The chain value of the ledger's last line."""
    lines: int
    audit: tuple[str, ...]
    """What is wrong with the ledger; empty if it is complete."""
    governance: str
    """SHA-256 of the signed governance of the first set of credentials, in hex."""
    further_governance: dict[str, str]
    """That of each further set, by its name."""
    approvals: str
    """How many of which people must approve which changes; empty if changes need no approvals."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """Everything that the page shows. A section that could not be made is None, with a gap."""

    keystore: str
    profile: str
    """That of the first set of credentials."""
    further_profiles: tuple[str, ...]
    """Those of the further sets."""
    at: datetime
    version: str
    command: str
    participants: tuple[ParticipantRow, ...] | None
    authorities: tuple[AuthorityRow, ...] | None
    rights: RightsSection | None
    endings: tuple[Ending, ...] | None
    exposures: tuple[Exposure, ...] | None
    migration: MigrationPlan | None
    """None without a gap if it was not asked for."""
    findings: FindingsSection | None
    events: tuple[LedgerEvent, ...] | None
    sizes: tuple[HandshakeSize, ...] | None
    robots: tuple[RobotState, ...] | None
    delivery: ListDelivery | None
    """Which robots lack the newest revocation list; None without a gap if there is no list."""
    evidence: Evidence | None
    gaps: tuple[Gap, ...]

    @property
    def profiles(self) -> tuple[str, ...]:
        """Those of all sets of credentials, that of the first one first."""
        return (self.profile, *self.further_profiles)

    def to_json(self) -> dict[str, object]:
        """The report for programs, and for --compare of a later one."""
        return {
            "format": "pqsec-report",
            "format_version": FORMAT,
            "keystore": self.keystore,
            "profile": self.profile,
            "further_profiles": self.further_profiles,
            "at": self.at,
            "pqsec": self.version,
            "command": self.command,
            "complete": not self.gaps,
            "gaps": self.gaps,
            "participants": self.participants,
            "authorities": self.authorities,
            "rights": self.rights and _rights(self.rights),
            "endings": self.endings,
            "exposures": self.exposures,
            "migration": self.migration,
            "findings": self.findings,
            "events": self.events,
            "handshake_sizes": self.sizes,
            "robots": self.robots and list(map(_robot, self.robots)),
            "delivery": self.delivery,
            "evidence": self.evidence,
        }


def _robot(each: RobotState) -> dict[str, object]:
    value = each.to_json()
    return {"name": each.name, "state": value.pop("robot"), **value}


def _where(domains: str, partitions: str) -> str:
    return f"{domains}, partition {partitions}" if partitions else domains


def _rights(rights: RightsSection) -> dict[str, object]:
    def holder(each: Holder) -> dict[str, object]:
        return {
            "group": each.group.label,
            "first_member": each.group.members[0],  # several groups may have one label
            "extent": each.extent,
            "members": each.members,
            "reason": each.reason,
            "place": each.place,
        }

    return {
        "groups": rights.groups,
        "rows": [
            {
                "label": each.label,
                "topics": len(each.topics),
                "domains": each.domains,
                "partitions": each.partitions,
                "publishers": list(map(holder, each.publishers)),
                "subscribers": list(map(holder, each.subscribers)),
            }
            for each in rights.rows
        ],
        "topics": rights.topics,
        "every": [
            [e.participant, e.action, e.topic, e.domains, e.partitions] for e in rights.every
        ],
        "left_out": rights.refused,
        "until": rights.until,
    }
