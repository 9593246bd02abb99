"""The domain file: YAML, with roles in the words of permissions and lists of participants.

    validity: 90d
    roles:
      robot:
        publish: [rt$name/pose]
    participants:
      - name: /fleet/robot{001..100}
        role: robot
      - csv: visitors.csv

Every error names the file and the line.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import timedelta
from functools import partial
from pathlib import Path
from string import Template
from typing import Any

from pqsec_pki._assets import asset
from pqsec_pki._files import read as read_file
from pqsec_pki.algorithms import PROFILES
from pqsec_pki.documents import (
    PRESETS,
    DomainSet,
    Governance,
    governance_from_yaml,
    preset_named,
)
from pqsec_pki.documents.parts_yaml import (
    Item,
    Readers,
    Table,
    Text,
    boolean,
    chosen,
    domains,
    duration,
    each,
    fields,
    governance_in,
    one_or_more,
    peeked,
    read,
    refused,
    table,
    text,
)
from pqsec_pki.domain._blanks import OWN, blanks_in, digest_of, without
from pqsec_pki.domain._members import Entry, members_of
from pqsec_pki.domain.desired import ROLE_KEYS, Desired, Role, rules_of, validity_in
from pqsec_pki.errors import located

YEAR = timedelta(days=365)


def read_domain(path: Path) -> Desired:
    """What the file, and those it names, want.

    InvalidDocumentError, located, with all that is wrong in a file; FileError for one that
    cannot be read.
    """
    data = read_file(path)
    with located(path):
        said = read(data, _domain)
    governance = said["governance"]
    if isinstance(governance, _GovernanceFile):
        governance = governance.read(path.parent)
    with located(path):
        members = members_of(path, said["participants"], said)
        return Desired(
            path=path,
            governance=governance,
            members=members,
            **{key: said[key] for key in _KEPT},
        )


def new_domain(name: str) -> bytes:
    """A commented domain file for people to edit; `name` is that of the CAs."""
    template = Template(asset("templates", "domain.yaml").read_text("utf-8"))
    return template.substitute(name=name).encode()


_KEPT = ("name", "profile", "domains", "ca_validity", "renew_before", "prune")


def _domain(item: Item) -> dict[str, Any]:
    default_domains = peeked(item, "domains", domains, DomainSet.of(0))
    # Without them where they have mistakes: those are told, and not that roles are missing.
    unknown: dict[str, Role] | None = None if "roles" in table(item).entries else {}
    roles = peeked(item, "roles", _roles, unknown)
    readers: Readers = {
        "name": text,
        "profile": partial(chosen, names=[profile.name for profile in PROFILES]),
        "domains": domains,
        "ca_validity": validity_in,
        "validity": validity_in,
        "renew_before": duration,
        "governance": partial(_governance, default_domains),
        "roles": _roles,
        "participants": partial(each, reader=partial(_entry, roles)),
        "prune": boolean,
    }
    said = fields(item, readers)
    said.setdefault("governance", PRESETS[0].governance(default_domains))
    return {**_DEFAULTS, "domains": default_domains, **said}


_DEFAULTS: Mapping[str, Any] = {
    "name": "",
    "profile": None,
    "ca_validity": 10 * YEAR,
    "validity": YEAR,
    "renew_before": None,
    "participants": (),
    "prune": False,
}


# Governance


@dataclass(frozen=True, slots=True)
class _GovernanceFile:
    """It stands in a file of its own, XML or YAML."""

    name: str

    def read(self, folder: Path) -> Governance:
        path = folder / self.name
        data = read_file(path)
        with located(path):
            if path.suffix == ".xml":
                return Governance.from_xml(data)
            return governance_from_yaml(data)


def _governance(default_domains: DomainSet, item: Item) -> Governance | _GovernanceFile:
    """A preset's name, the name of a file, or what would stand in one."""
    if isinstance(item, Text):
        name = chosen(item, [preset.name for preset in PRESETS])
        return preset_named(name).governance(default_domains)
    if "file" in table(item).entries:
        return _GovernanceFile(fields(item, {"file": text})["file"])
    return governance_in(item, default_domains)


# Roles and participants


def _as_it_is(item: Item) -> Item:
    """What a role says is read once its blanks are filled."""
    return item


_SAID: Readers = {"domains": domains, "validity": validity_in}
_ROLE: Readers = dict.fromkeys(ROLE_KEYS, _as_it_is) | _SAID


def _roles(item: Item) -> dict[str, Role]:
    found = table(item)
    readers: Mapping[str, Callable[[Item], Role]] = {
        key: partial(_role, key) for key in found.entries
    }
    return fields(found, readers)


def _role(label: str, item: Item) -> Role:
    said = fields(item, _ROLE)
    return _made(label, without(table(item), _SAID), said)


def _made(label: str, item: Table, said: Mapping[str, Any]) -> Role:
    if not item.entries:
        raise refused(item, "allows nothing: give it publish, subscribe, nodes or rules")
    blanks = blanks_in(item)
    if not blanks:
        rules_of(item, DomainSet.of(0))  # what it allows, wherever that will be
    return Role(
        label=label,
        item=item,
        blanks=blanks,
        digest=digest_of(item),
        domains=said.get("domains"),
        validity=said.get("validity"),
    )


def _entry(roles: Mapping[str, Role] | None, item: Item) -> Entry:
    """One item of `participants`: names, and the role they have or what they may do."""
    readers: Readers = {
        "name": partial(one_or_more, reader=_with_line),
        "csv": text,
        "list": text,
        "role": text if roles is None else partial(_named_role, roles),
        "values": _values,
    }
    said = fields(item, readers | _ROLE)
    sources = [key for key in ("name", "csv", "list") if key in said]
    if len(sources) != 1:
        raise refused(item, "an item has one of the keys name, csv and list")
    own = without(table(item), [*readers, *_SAID])
    if own.entries and "role" in said:
        raise refused(item, "it has a role, so what it may do stands there")
    if own.entries:
        said["role"] = _made("its own", own, said)
    if "role" not in said and "csv" not in said:
        raise refused(item, "what it may do is missing: a role, or publish, subscribe, nodes")
    return Entry(item.line, roles=roles or {}, said=said)


def _with_line(item: Item) -> tuple[str, int]:
    return text(item), item.line


def _named_role(roles: Mapping[str, Role], item: Item) -> Role:
    if not roles:
        raise refused(item, "there are no roles in the file")
    return roles[chosen(item, roles)]


def _values(item: Item) -> dict[str, str]:
    found = table(item)
    taken = [key for key, _ in found.entries.values() if key.text in OWN]
    if taken:
        raise refused(taken[0], f"${taken[0].text} is known already")
    return fields(found, dict.fromkeys(found.entries, text))
