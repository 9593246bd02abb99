"""The wanted state of a domain: its CAs, its governance, and its participants with roles."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import field
from datetime import UTC, datetime, timedelta
from functools import cached_property, lru_cache
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki.approvals import ApprovalPolicy
from pqsec_pki.documents import (
    DefaultAction,
    DomainSet,
    Governance,
    Grant,
    PermissionRule,
    grant_crashes,
)
from pqsec_pki.documents.parts_yaml import (
    ALLOWED,
    Item,
    Readers,
    YamlMapping,
    duration,
    one_of,
    readable_problems,
    refused,
    rules_in,
)
from pqsec_pki.domain._placeholders import filled, own_values
from pqsec_pki.domain.devices import Device
from pqsec_pki.errors import InvalidDocumentError, located
from pqsec_pki.lifecycle import ParticipantSpec

EDITION = 1
"""The version of the meaning of roles. It is increased when the same text gives other rules,
so that permissions are signed again."""

_ALWAYS = (datetime(1970, 1, 1, tzinfo=UTC), datetime(2261, 1, 1, tzinfo=UTC))
"""Permissions end with the certificate; a grant of a role sets no other limit."""

LONGEST = timedelta(days=200 * 365)
"""The longest validity: certificates end in 2261 at the latest."""

ROLE_KEYS = (*ALLOWED, "rules", "default")
"""The keys of a role, as in permissions in YAML."""


@dataclass(frozen=True, slots=True, eq=False)
class Role:
    """The permissions that several participants share; roles are compared by identity."""

    label: str
    item: YamlMapping = field(repr=False)
    """The mapping of the role, with ROLE_KEYS only."""
    placeholders: frozenset[str]
    """The names of its placeholders."""
    digest: str
    domains: DomainSet | None
    validity: timedelta | None

    def grant(self, name: str, domains: DomainSet, values: Mapping[str, str]) -> Grant:
        """The grant for `name` in this role; InvalidDocumentError with the lines at fault."""
        if self.placeholders:
            rules, default = rules_of(filled(self.item, {**values, **own_values(name)}), domains)
        else:
            rules, default = _read_once(self, domains)
        grant = Grant(
            name=name,
            subject_name=f"CN={name}",
            not_before=_ALWAYS[0],
            not_after=_ALWAYS[1],
            rules=rules,
            default=default,
        )
        if crashes := [each.problem for each in grant_crashes((grant,))]:
            raise InvalidDocumentError(crashes)
        return grant


@dataclass(frozen=True, slots=True)
class Member:
    """The wanted state of a participant."""

    name: str
    role: Role = field(repr=False)
    domains: DomainSet
    validity: timedelta
    values: Mapping[str, str]
    """Values of its role's placeholders, without the placeholders that each participant has."""
    source: Path
    """The domain file, for errors in its role."""
    request: Path | None = None
    """The path of its request, which may not exist yet; None if its keys are made here."""
    by_order: bool = False
    """Whether the request must be in an order of a registration authority, within its grant."""
    device: Device | None = None
    """The device whose certificate lets it enrol at the server; None without one."""

    @property
    def config_digest(self) -> str:
        """SHA-256, in hex, of its permissions' source: it changes when its permissions do."""
        return _config_digest(self.role.digest, self.domains, tuple(sorted(self.values.items())))

    def spec(self) -> ParticipantSpec:
        """The input of `issue` and `sign_permissions`; InvalidDocumentError for a bad role."""
        with located(self.source):
            grant = readable_problems(lambda: self.role.grant(self.name, self.domains, self.values))
        return ParticipantSpec(
            name=self.name,
            domains=self.domains,
            validity=self.validity,
            grants=(grant,),
            config_digest=self.config_digest,
        )


@dataclass(frozen=True)
class Desired:
    """The content of a domain file."""

    path: Path
    name: str
    """The name of the CAs; empty if the file has none."""
    profiles: tuple[str, ...]
    """That of each set of credentials, in order. Empty for those of the keystore, or the default of
    a new one."""
    domains: DomainSet
    ca_validity: timedelta
    renew_before: timedelta | None
    """None for a third of a certificate's validity."""
    governance: Governance
    roles: Mapping[str, Role]
    """Roles by name."""
    members: Mapping[str, Member]
    """Members by name."""
    groups: Mapping[str, tuple[str, ...]]
    """Members by the group's name, sorted."""
    stock: tuple[str, ...]
    """Names and patterns of those who may be met with the first set of credentials, sorted."""
    prune: bool
    """Whether to revoke participants that are not in the file."""
    stacks: tuple[str, ...]
    """The stacks of the robots, such as `cyclonedds` or `fastdds-3.1`, for `migrate plan`."""
    migrate_from: str | None
    """The profile that `apply` changes to the one of `profiles`; None for no such change."""
    approvals: ApprovalPolicy | None
    """Whose approvals changes need; None if they need none."""
    sha256: str
    """SHA-256 of the domain file itself."""

    @property
    def request_files(self) -> list[Path]:
        """The files with the keys of participants, without orders, which are signed."""
        found = [each.request for each in self.members.values() if not each.by_order]
        return [each for each in found if each is not None]

    @cached_property
    def governance_digest(self) -> str:
        """SHA-256, in hex: it changes when the governance does."""
        return hashlib.sha256(repr(self.governance).encode()).hexdigest()

    @property
    def examples(self) -> list[ParticipantSpec]:
        """One participant of each role, for what roles have in common."""
        one_of_each = {member.role: member for member in self.members.values()}
        return [member.spec() for member in one_of_each.values()]

    @property
    def ungoverned(self) -> list[int]:
        """Domains of participants that the governance does not have."""
        wanted = {domain for each in self._domain_sets for domain in each.ids()}
        return sorted(each for each in wanted if self.governance.rule_for(each) is None)

    @property
    def _domain_sets(self) -> set[DomainSet]:
        return {member.domains for member in self.members.values()}


@lru_cache(maxsize=256)
def _read_once(role: Role, domains: DomainSet) -> tuple[tuple[PermissionRule, ...], DefaultAction]:
    return rules_of(role.item, domains)


def validity_in(item: Item) -> timedelta:
    """Read a validity; InvalidDocumentError if it is longer than a certificate's can be."""
    found = duration(item)
    if found > LONGEST:
        raise refused(item, "certificates end in 2261 at the latest: 200y is the longest")
    return found


def rules_of(item: Item, domains: DomainSet) -> tuple[tuple[PermissionRule, ...], DefaultAction]:
    """The rules of an item without placeholders, and its default action."""
    common: Readers = {"default": lambda value: one_of(DefaultAction, value)}
    rules, settings = rules_in(domains, item, common)
    if not rules:
        raise refused(item, "it has no rule, so it allows nothing")
    return rules, settings.get("default", DefaultAction.DENY)


@lru_cache(maxsize=1024)
def _config_digest(digest: str, domains: DomainSet, values: tuple[tuple[str, str], ...]) -> str:
    # Without the participant's name: the ledger line has it too.
    content = json.dumps([EDITION, digest, str(domains), values])
    return hashlib.sha256(content.encode()).hexdigest()
