"""Makes a domain file of keystores and policies, so that `plan` finds no change in them.

Participants with the same rights share a role, and names that count become a pattern.
"""

from collections import Counter
from collections.abc import Container, Hashable, Iterable, Iterator, Sequence
from dataclasses import field
from datetime import datetime, timedelta
from functools import cached_property
from pathlib import Path
from typing import TypeVar

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import exists, is_folder
from pqsec_pki.algorithms import PROFILES
from pqsec_pki.approvals import ApprovalPolicy
from pqsec_pki.documents import PRESETS, DefaultAction, DomainSet, Governance
from pqsec_pki.documents.parts_yaml import (
    domains_as_yaml,
    dump,
    governance_as_yaml,
    rules_as_yaml,
)
from pqsec_pki.domain._approvals import approvals_as_yaml
from pqsec_pki.domain._keystore_sources import keystore_source, other_keystore_source
from pqsec_pki.domain._name_patterns import patterns_of
from pqsec_pki.domain._policy_sources import document_source, is_sros2_policy, sros2_policy_source
from pqsec_pki.domain._shared_rules import FoundParticipant, SharedRules, labels, shared_rules
from pqsec_pki.domain._sources import ImportSource, LeftOut
from pqsec_pki.domain.reading import DEFAULT_CA_VALIDITY, desired_in
from pqsec_pki.errors import UsageError, shown
from pqsec_pki.keystore import SETTINGS, Keystore, matching

Value = TypeVar("Value", bound=Hashable)


@dataclass(frozen=True, slots=True)
class Imported:
    """A domain file, and what is not in it."""

    document: bytes = field(repr=False)
    """YAML, UTF-8."""
    participants: tuple[str, ...]
    roles: tuple[str, ...]
    left_out: tuple[LeftOut, ...]
    notes: tuple[str, ...]


def import_domain(sources: Sequence[Path], *, now: datetime, domains: DomainSet) -> Imported:
    """The domain file for all that is in the sources: keystores and policies.

    `domains` are those of SROS2 policies, which name none. UsageError for a participant with
    different permissions in two sources, and for two different governance documents; errors
    as of `source_at`, and InvalidDocumentError for what a domain file cannot have.
    """
    return imported([source_at(each, now=now, domains=domains) for each in sources])


def source_at(path: Path, *, now: datetime, domains: DomainSet) -> ImportSource:
    """What is in a keystore, in a keystore of SROS2, or in a policy.

    `domains` are those of SROS2 policies, which name none. What keystores sign is verified with
    their permissions CA. FileError, MalformedError, InvalidDocumentError or VerificationError
    for a source that cannot be read; KeystoreError for another folder.
    """
    if exists(path / SETTINGS):
        return keystore_source(Keystore.open(path), now)
    if is_folder(path):
        return other_keystore_source(path, now)
    if path.suffix == ".xml" and is_sros2_policy(path):
        return sros2_policy_source(path, domains, now)
    return document_source(path, now)


def imported(sources: Sequence[ImportSource]) -> Imported:
    """The domain file for what was read."""
    participants = _each_once(found for source in sources for found in source.participants)
    governance = _only_governance(sources)
    groups = shared_rules(participants)
    named_groups = _groups(sources, {each.name for each in participants})
    document = _Writer(sources, participants, governance, groups, named_groups).document()
    desired_in(document, Path("domain.yaml"))  # refuses what `plan` would refuse
    notes = [note for source in sources for note in source.notes]
    if governance is None:
        notes.append("the sources have no governance: the file has the preset strict")
    return Imported(
        document,
        participants=tuple(each.name for each in participants),
        roles=tuple(labels(groups.values())),
        left_out=tuple(each for source in sources for each in source.left_out),
        notes=tuple(notes),
    )


def _each_once(participants: Iterable[FoundParticipant]) -> list[FoundParticipant]:
    """The participants by name. UsageError if one has different permissions in two sources."""
    found: dict[str, FoundParticipant] = {}
    for each in participants:
        first = found.setdefault(each.name, each)
        if (first.rules, first.default) != (each.rules, each.default):
            raise UsageError(
                f"{each.name} has different permissions in {first.source} and {each.source}",
                hint="name one of them only",
            )
    return sorted(found.values(), key=lambda each: each.name)


def _groups(sources: Iterable[ImportSource], names: Container[str]) -> dict[str, list[str]]:
    """The members of each group that are imported, of all sources together."""
    found: dict[str, set[str]] = {}
    for key, members in (pair for source in sources for pair in source.groups.items()):
        found.setdefault(key, set()).update(name for name in members if name in names)
    return {key: sorted(members) for key, members in sorted(found.items()) if members}


def _only_governance(sources: Iterable[ImportSource]) -> Governance | None:
    given = [each for each in sources if each.governance]
    others = [each for each in given if each.governance != given[0].governance]
    if others:
        raise UsageError(
            f"{given[0].path} and {others[0].path} have different governance",
            hint="a domain has one governance: import the sources one by one",
        )
    return given[0].governance if given else None


@dataclass(frozen=True)
class _Writer:
    """Writes the file; its defaults are the domains and validity of most participants."""

    sources: Sequence[ImportSource]
    participants: Sequence[FoundParticipant]
    governance: Governance | None
    groups: dict[SharedRules, list[FoundParticipant]]
    """Participants with the same rules, which share a role."""
    named_groups: dict[str, list[str]]
    """The groups of keystores."""

    @cached_property
    def domains(self) -> DomainSet:
        of_all = [each.domains for each in self.participants if each.domains]
        of_rules = (
            [each.domains for each in self.governance.domain_rules[:1]] if self.governance else []
        )
        for found in (of_all, of_rules):
            if common := _most_common(each for each in found if each.is_read_alike):
                return common
        return DomainSet.of(0)

    @cached_property
    def validity(self) -> timedelta | None:
        return _most_common(each.validity for each in self.participants)

    def document(self) -> bytes:
        names = ", ".join(shown(str(each.path)) for each in self.sources)
        head = f"# Imported by `pqsec domain import` from {names}.\n"
        parts = [dump(self._settings()), dump({"governance": self._governance()})]
        found = labels(self.groups.values())
        roles = {label: _role(role) for label, role in zip(found, self.groups, strict=True)}
        if roles:
            parts.append(dump({"roles": roles}))
        parts.append(b"".join(self._participants(found)))
        if self.named_groups:
            written = {key: patterns_of(names) for key, names in self.named_groups.items()}
            parts.append(dump({"groups": written}))
        if stock := self._stock():
            parts.append(dump({"stock": stock}))
        parts += [dump({"approvals": approvals_as_yaml(each)}) for each in self._approvals()]
        return head.encode() + b"\n".join(parts)

    def _stock(self) -> list[str]:
        """The names and patterns of keystores that stand for somebody who is imported."""
        names = [each.name for each in self.participants]
        given = sorted({each for source in self.sources for each in source.stock})
        return [each for each in given if matching(each, names)]

    def _approvals(self) -> list[ApprovalPolicy]:
        """What the keystores demand; UsageError if it is not the same."""
        found = {each.approvals.text: each.approvals for each in self.sources if each.approvals}
        if len(found) > 1:
            raise UsageError(
                "the keystores demand different approvals", hint="import them one by one"
            )
        return [*found.values()]

    def _settings(self) -> dict[str, object]:
        settings: dict[str, object] = {}
        if name := _only(each.ca_name for each in self.sources):
            settings["name"] = name
        profiles = _only(each.profiles for each in self.sources) or ()
        if profiles and {*profiles} <= {each.name for each in PROFILES}:
            settings["profile"] = profiles[0] if len(profiles) == 1 else [*profiles]
        settings["domains"] = domains_as_yaml(self.domains)
        if self.validity:
            settings["validity"] = _duration(self.validity)
        ca_validity = _only(each.ca_validity for each in self.sources)
        if ca_validity and ca_validity != DEFAULT_CA_VALIDITY:
            settings["ca_validity"] = _duration(ca_validity)
        return settings

    def _governance(self) -> object:
        """The name of a preset, with its domains if it needs them; else the whole content."""
        if self.governance is None:
            return PRESETS[0].name
        own = self.governance.domain_rules[0].domains
        for preset in PRESETS:
            if preset.governance(self.domains) == self.governance:
                return preset.name
            if preset.governance(own) == self.governance:
                return {"preset": preset.name, "domains": domains_as_yaml(own)}
        return governance_as_yaml(self.governance)

    def _participants(self, found: Sequence[str]) -> Iterator[bytes]:
        if not self.participants:
            yield dump({"participants": []})
            return
        yield b"participants:\n"
        for label, members in zip(found, self.groups.values(), strict=True):
            alike: dict[tuple[object, ...], list[FoundParticipant]] = {}
            for each in members:
                terms = (each.domains, each.validity, each.key_elsewhere)
                alike.setdefault(terms, []).append(each)
            for some in alike.values():
                yield self._item(label, some)

    def _item(self, label: str, members: Sequence[FoundParticipant]) -> bytes:
        """An item of `participants`, for members with the same terms."""
        patterns, first = patterns_of(each.name for each in members), members[0]
        item: dict[str, object] = {"name": patterns if len(patterns) > 1 else patterns[0]}
        item["role"] = label
        if first.domains not in {None, self.domains}:
            item["domains"] = domains_as_yaml(first.domains)
        if first.validity != self.validity:
            item["validity"] = _duration(first.validity)
        comment = b"  # The keys are on the robots.\n" if first.key_elsewhere else b""
        return comment + dump({"participants": [item]}).partition(b"\n")[2]


def _role(role: SharedRules) -> dict[str, object]:
    written = rules_as_yaml(role.rules, role.domains)
    if role.default is not DefaultAction.DENY:
        written["default"] = role.default.value
    return written


def _most_common(values: Iterable[Value]) -> Value | None:
    """The value that comes most often, of equals the first as text; None if there is none."""
    counted = Counter(values)
    return min(counted, key=lambda each: (-counted[each], str(each)), default=None)


def _only(values: Iterable[Value]) -> Value | None:
    """The value that all sources which have one agree on; None if they do not."""
    given = {each for each in values if each}
    return given.pop() if len(given) == 1 else None


def _duration(validity: timedelta) -> str:
    """The duration as the file has it: 1y, 90d or 12h."""
    hours = validity // timedelta(hours=1)
    for unit, size in (("y", 365 * 24), ("d", 24)):
        if hours % size == 0:
            return f"{hours // size}{unit}"
    return f"{hours}h"
