"""Reads the domain file: YAML, with roles as in permissions and lists of participants.

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

import hashlib
from collections.abc import Mapping
from datetime import timedelta
from functools import partial
from pathlib import Path
from shlex import quote
from string import Template
from typing import Any

from pqsec_pki._assets import asset
from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import read as read_file
from pqsec_pki.algorithms import PROFILES
from pqsec_pki.certificates import common_name
from pqsec_pki.documents import (
    PRESETS,
    DomainSet,
    Governance,
    governance_crashes,
    governance_from_yaml,
    preset_named,
)
from pqsec_pki.documents.parts_yaml import (
    Item,
    Readers,
    Text,
    boolean,
    build,
    chosen,
    domains_read_alike,
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
from pqsec_pki.domain._approvals import approvals_in
from pqsec_pki.domain._groups import groups_in, members_of_groups
from pqsec_pki.domain._members import members_of
from pqsec_pki.domain._profiles import profiles_in
from pqsec_pki.domain._roles import entry_in, roles_in
from pqsec_pki.domain._stock import stock_in, stock_names
from pqsec_pki.domain.desired import Desired, Role, validity_in
from pqsec_pki.errors import InvalidDocumentError, MissingError, located, shown
from pqsec_pki.stacks import Stack

YEAR = timedelta(days=365)
DEFAULT_CA_VALIDITY = 10 * YEAR
_STACKS = [each.value for each in Stack if each is not Stack.ROS2]


def read_domain(path: Path) -> Desired:
    """Read the domain file and the files that it names.

    InvalidDocumentError with the file and all its problems; FileError if a file cannot be read.
    """
    try:
        data = read_file(path)
    except MissingError as error:
        error.hint = f"`pqsec plan --init {quote(str(path))}` writes one to edit"
        raise
    return desired_in(data, path)


def desired_in(data: bytes, path: Path) -> Desired:
    """The content of the domain file at `path`, which names other files; errors as above."""
    with located(path):
        settings = read(data, _domain)
    governance = settings["governance"]
    if isinstance(governance, _GovernanceFile):
        governance = governance.read(path.parent)
    approvals = settings["approvals"]
    with located(path):
        policy = approvals.read(path.parent) if approvals else None
        members = members_of(path, settings["participants"], settings)
        return Desired(
            path=path,
            governance=governance,
            members=members,
            groups=members_of_groups(settings["groups"], members),
            profiles=settings["profile"],
            stock=stock_names(settings["stock"], members),
            approvals=policy,
            sha256=hashlib.sha256(data).hexdigest(),
            **{key: settings[key] for key in _KEPT},
        )


def new_domain(name: str) -> bytes:
    """A commented domain file for users to edit; `name` is the name of the CAs."""
    template = Template(asset("templates", "domain.yaml").read_text("utf-8"))
    return template.substitute(name=name).encode()


_KEPT = (
    *("name", "domains", "ca_validity", "renew_before", "prune"),
    *("stacks", "migrate_from", "roles"),
)


def _domain(item: Item) -> dict[str, Any]:
    default_domains = peeked(item, "domains", domains_read_alike, DomainSet.of(0))
    # None if the roles have mistakes: then only the mistakes are reported, not missing roles.
    unknown: dict[str, Role] | None = None if "roles" in table(item).entries else {}
    roles = peeked(item, "roles", roles_in, unknown)
    readers: Readers = {
        "name": _ca_name,
        "profile": profiles_in,
        "domains": domains_read_alike,
        "ca_validity": validity_in,
        "validity": validity_in,
        "renew_before": duration,
        "governance": partial(_governance, default_domains),
        "roles": roles_in,
        "participants": partial(each, reader=partial(entry_in, roles)),
        "groups": groups_in,
        "stock": stock_in,
        "approvals": approvals_in,
        "prune": boolean,
        "stacks": partial(one_or_more, reader=_stack),
        "migrate_from": partial(chosen, names=[profile.name for profile in PROFILES]),
    }
    settings = fields(item, readers)
    before = settings.get("migrate_from")
    if before and (len(settings.get("profile", ())) != 1 or before in settings["profile"]):
        raise refused(item, "`migrate_from` needs a `profile` to change to, which is another one")
    settings.setdefault("governance", PRESETS[0].governance(default_domains))
    return {**_DEFAULTS, "domains": default_domains, **settings}


_DEFAULTS: Mapping[str, Any] = {
    "name": "",
    "profile": (),
    "ca_validity": DEFAULT_CA_VALIDITY,
    "validity": YEAR,
    "renew_before": None,
    "roles": {},
    "participants": (),
    "groups": {},
    "stock": (),
    "approvals": None,
    "prune": False,
    "stacks": (),
    "migrate_from": None,
}


def _ca_name(item: Item) -> str:
    """A name that fits into the CAs' certificates."""
    name = text(item)
    build(item, common_name, name=f"{name} Permissions CA".strip())
    return name


def _stack(item: Item) -> str:
    """A stack, or versions of it that behave alike."""
    name = text(item)
    if name.partition("-")[0] not in _STACKS:
        raise refused(item, f"'{shown(name)}' is not a stack; known: {', '.join(_STACKS)}")
    return name


# Governance


@dataclass(frozen=True, slots=True)
class _GovernanceFile:
    """A governance in its own file, XML or YAML."""

    name: str

    def read(self, folder: Path) -> Governance:
        path = folder / self.name
        data = read_file(path)
        with located(path):
            is_xml = path.suffix == ".xml"
            return _safe(Governance.from_xml(data) if is_xml else governance_from_yaml(data))


def _governance(default_domains: DomainSet, item: Item) -> Governance | _GovernanceFile:
    """A preset, a file, or the content of a governance file."""
    if isinstance(item, Text):
        name = chosen(item, [preset.name for preset in PRESETS])
        return preset_named(name).governance(default_domains)
    if "file" in table(item).entries:
        return _GovernanceFile(fields(item, {"file": text})["file"])
    return _safe(governance_in(item, default_domains))


def _safe(governance: Governance) -> Governance:
    """The governance; InvalidDocumentError if it crashes a stack, before anything is changed."""
    if crashes := [each.problem for each in governance_crashes(governance.domain_rules)]:
        raise InvalidDocumentError(crashes)
    return governance
