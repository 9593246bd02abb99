"""What a domain shall be: its CAs, its governance, and each participant with its role."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import cached_property, lru_cache
from pathlib import Path

from pqsec_pki.documents import DefaultAction, DomainSet, Governance, Grant, Rule
from pqsec_pki.documents.parts_yaml import (
    ALLOWED,
    Item,
    Readers,
    Table,
    duration,
    one_of,
    refused,
    rules_in,
    told,
)
from pqsec_pki.domain._placeholders import filled, own_values
from pqsec_pki.errors import located
from pqsec_pki.keystore import ParticipantSpec

EDITION = 1
"""Of what roles mean. Counted up when the same words come to mean other rules, so that the
permissions made of them are signed again."""

_ALWAYS = (datetime(1970, 1, 1, tzinfo=UTC), datetime(2261, 1, 1, tzinfo=UTC))
"""Permissions end with the certificate; a grant of a role sets no other limit."""

_LONGEST = timedelta(days=200 * 365)

ROLE_KEYS = (*ALLOWED, "rules", "default")
"""What says what a participant may do, in the words of permissions in YAML."""


@dataclass(frozen=True, slots=True, eq=False)
class Role:
    """What several participants may do alike; two are one only if they are the same object."""

    label: str
    item: Table = field(repr=False)
    """Only ROLE_KEYS."""
    placeholders: frozenset[str]
    """What it leaves open."""
    digest: str
    domains: DomainSet | None
    validity: timedelta | None

    def grant(self, name: str, domains: DomainSet, values: Mapping[str, str]) -> Grant:
        """What `name` may do in this role; InvalidDocumentError with the lines at fault."""
        if self.placeholders:
            rules, default = rules_of(filled(self.item, {**values, **own_values(name)}), domains)
        else:
            rules, default = _read_once(self, domains)
        return Grant(
            name=name,
            subject_name=f"CN={name}",
            not_before=_ALWAYS[0],
            not_after=_ALWAYS[1],
            rules=rules,
            default=default,
        )


@dataclass(frozen=True, slots=True)
class Member:
    """A participant as it shall be."""

    name: str
    role: Role = field(repr=False)
    domains: DomainSet
    validity: timedelta
    values: Mapping[str, str]
    """For the blanks of its role, but those that any participant has."""
    source: Path
    """The domain file, for errors in its role."""
    request: Path | None = None
    """Where its own request is, or will be; None if its keys are made here."""

    @property
    def config_digest(self) -> str:
        """Differs whenever what it may do does: SHA-256, in hex."""
        return _config_digest(self.role.digest, self.domains, tuple(sorted(self.values.items())))

    def spec(self) -> ParticipantSpec:
        """What `issue` and `permit` take; InvalidDocumentError where the role is wrong for it."""
        with located(self.source):
            grant = told(lambda: self.role.grant(self.name, self.domains, self.values))
        return ParticipantSpec(
            name=self.name,
            domains=self.domains,
            validity=self.validity,
            grants=(grant,),
            config_digest=self.config_digest,
        )


@dataclass(frozen=True)
class Desired:
    """A domain file, read."""

    path: Path
    name: str
    """Of the CAs; empty if the file does not say."""
    profile: str | None
    """None for whatever the keystore has, or the default for a new one."""
    domains: DomainSet
    ca_validity: timedelta
    renew_before: timedelta | None
    """None for a third of a certificate's life."""
    governance: Governance
    members: Mapping[str, Member]
    """By name."""
    prune: bool
    """Whether to revoke participants that it does not name."""

    @cached_property
    def governance_digest(self) -> str:
        """Differs whenever the governance does."""
        return hashlib.sha256(repr(self.governance).encode()).hexdigest()

    @property
    def ungoverned(self) -> list[int]:
        """Domains where participants may be, and that the governance does not name."""
        wanted = {domain for each in self._domain_sets for domain in each.ids()}
        return sorted(each for each in wanted if self.governance.rule_for(each) is None)

    @property
    def _domain_sets(self) -> set[DomainSet]:
        return {member.domains for member in self.members.values()}


@lru_cache(maxsize=256)
def _read_once(role: Role, domains: DomainSet) -> tuple[tuple[Rule, ...], DefaultAction]:
    return rules_of(role.item, domains)


def validity_in(item: Item) -> timedelta:
    """A duration that a certificate can have."""
    found = duration(item)
    if found > _LONGEST:
        raise refused(item, "certificates end in 2261 at the latest: 200y is the longest")
    return found


def rules_of(item: Item, domains: DomainSet) -> tuple[tuple[Rule, ...], DefaultAction]:
    """The rules that an item without blanks says, and what holds where none does."""
    common: Readers = {"default": lambda value: one_of(DefaultAction, value)}
    rules, said = rules_in(domains, item, common)
    if not rules:
        raise refused(item, "no rule in it, so it allows nothing")
    return rules, said.get("default", DefaultAction.DENY)


@lru_cache(maxsize=1024)
def _config_digest(digest: str, domains: DomainSet, values: tuple[tuple[str, str], ...]) -> str:
    # Without the name: the mark stands in the ledger beside it.
    said = json.dumps([EDITION, digest, str(domains), values])
    return hashlib.sha256(said.encode()).hexdigest()
