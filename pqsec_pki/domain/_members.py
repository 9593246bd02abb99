"""Makes participants of the items of a domain file, each participant once."""

import os
import re
from collections.abc import Iterable, Mapping
from datetime import timedelta
from difflib import get_close_matches
from pathlib import Path
from sys import intern
from typing import Any

from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents.parts_yaml import (
    Item,
    Readers,
    Text,
    build,
    chosen,
    domains,
    refused,
    text,
)
from pqsec_pki.domain._listing import (
    MAX_PARTICIPANTS,
    MAX_PROBLEMS,
    ListedName,
    expanded,
    names_in_csv,
    names_in_list,
)
from pqsec_pki.domain._placeholders import OWN, fit
from pqsec_pki.domain.desired import Member, Role, validity_in
from pqsec_pki.domain.devices import Device
from pqsec_pki.enrolment import flat_name
from pqsec_pki.errors import InvalidDocumentError, located, shown
from pqsec_pki.problems import Problem


def device(item: Item) -> Device:
    """The device of a participant; InvalidDocumentError for another text."""
    return build(item, lambda: Device.of(text(item)))


_NOTHING: Mapping[str, str] = {}
_COLUMNS: Readers = {"domains": domains, "validity": validity_in, "request": text, "idevid": device}
"""The columns of a row besides name and role."""
_PATTERN = re.compile(r"[*?\[\\]")
"""The special characters of POSIX fnmatch."""
_ALMOST = 0.8
"""Ratio of difflib: it matches domain and Validity, but not site."""


@dataclass(frozen=True, slots=True)
class ParticipantItem:
    """One item of `participants`."""

    line: int
    roles: Mapping[str, Role]
    """All roles of the file: a CSV file may name them."""
    settings: Mapping[str, Any]
    """The values of the item's keys."""

    def listed(self, folder: Path) -> tuple[Path | None, list[ListedName]]:
        """The item's names, and the file that they are in if it is another file."""
        if "csv" in self.settings:
            path = folder / self.settings["csv"]
            return path, names_in_csv(path)
        if "list" in self.settings:
            path = folder / self.settings["list"]
            return path, names_in_list(path)
        return None, expanded(self.settings["name"])


def members_of(
    source: Path, entries: Iterable[ParticipantItem], settings: Mapping[str, Any]
) -> dict[str, Member]:
    """All participants by name; `settings` are the file's values for all of them.

    InvalidDocumentError for a duplicate, and for a missing or invalid value.
    """
    collector = _Collector(source, settings)
    for entry in entries:
        collector.add(entry)
    one_of_each_role = {member.role: member for member in collector.members.values()}
    for member in one_of_each_role.values():
        member.spec()  # reports a mistake in a role before anything is issued
    return collector.members


class _Collector:
    """Collects participants, and the place of each."""

    def __init__(self, source: Path, settings: Mapping[str, Any]) -> None:
        self._source = source
        self._settings = settings
        self._places: dict[str, str] = {}
        self.members: dict[str, Member] = {}

    def add(self, entry: ParticipantItem) -> None:
        path, listed = entry.listed(self._source.parent)
        problems: list[Problem] = []
        with located(path or self._source):
            _refuse_misspelled_columns(listed[:1], entry)
            for each in listed:
                try:
                    self._add_name(each, entry, f"{path}: " if path else "")
                except InvalidDocumentError as error:
                    problems += error.problems
            if problems:
                raise InvalidDocumentError(problems[:MAX_PROBLEMS])

    def _add_name(self, each: ListedName, entry: ParticipantItem, file: str) -> None:
        if place := self._places.get(each.name):
            raise refused(each.line, f"{each.name} appears twice, first in {place}")
        if len(self.members) == MAX_PARTICIPANTS:
            raise refused(each.line, f"more than {MAX_PARTICIPANTS} participants")
        self._places[each.name] = intern(f"{file}line {each.line}")
        self.members[each.name] = self._member(each, entry)

    def _member(self, each: ListedName, entry: ParticipantItem) -> Member:
        settings = {**entry.settings, **_columns(each, entry.roles)}
        role: Role | None = settings.get("role")
        if role is None:
            raise refused(each.line, f"{each.name} has no role")
        order = entry.settings.get("order")
        if order and settings.get("request"):
            raise refused(each.line, f"{each.name} has a request and an order")
        return Member(
            name=each.name,
            role=role,
            domains=settings.get("domains") or role.domains or self._settings["domains"],
            validity=self._validity(each, settings.get("validity") or role.validity),
            values=_values(each, role, settings.get("values", _NOTHING)),
            source=self._source,
            request=self._path(each.name, order or settings.get("request"), bool(order)),
            by_order=bool(order),
            device=settings.get("idevid"),
        )

    def _path(self, name: str, request: str | None, ordered: bool) -> Path | None:  # noqa: FBT001
        """The file, or the file with the participant's name in the folder."""
        if not request:
            return None
        path = self._source.parent / request
        is_folder = request.endswith("/") or os.path.isdir(path)  # noqa: PTH112 -- never raises
        kind = "order" if ordered else "csr"
        return path / f"{flat_name(name)}.{kind}" if is_folder else path

    def _validity(self, each: ListedName, own: timedelta | None) -> timedelta:
        validity: timedelta = own or self._settings["validity"]
        notice: timedelta | None = self._settings["renew_before"]
        if notice is not None and notice >= validity:
            message = f"{each.name} would be due when it is issued: renew_before must be shorter"
            raise refused(each.line, f"{message} than its validity")
        return validity


def _refuse_misspelled_columns(first: Iterable[ListedName], entry: ParticipantItem) -> None:
    """InvalidDocumentError for a column without a placeholder, named almost like a known one."""
    own = entry.settings.get("role")
    roles = (*entry.roles.values(), *([own] if own else []))
    placeholders = {each for role in roles for each in role.placeholders}
    for column in (column for each in first for column in each.columns):
        meant = get_close_matches(column.lower(), ("role", *_COLUMNS), 1, _ALMOST)
        if meant and column not in {"role", *_COLUMNS, *placeholders}:
            raise refused(1, f"no role has ${shown(column)}; is the column '{meant[0]}' meant?")


def _values(each: ListedName, role: Role, of_entry: Mapping[str, str]) -> Mapping[str, str]:
    """The values for the role's placeholders; InvalidDocumentError if one is missing."""
    needed = role.placeholders.difference(OWN)
    if not needed:
        return _NOTHING
    known = {**of_entry, **each.columns}
    missing = sorted(f"${name}" for name in needed - known.keys())
    if missing:
        message = f"{each.name}: its role ({role.label}) needs {', '.join(missing)}"
        raise refused(each.line, message)
    for name in needed & each.columns.keys():
        _refuse_pattern(name, Text(each.line, each.columns[name], plain=False))
    return {name: known[name] for name in needed}


def _refuse_pattern(column: str, value: Text) -> None:
    """InvalidDocumentError for a pattern: an inventory must not give a robot all topics."""
    if found := _PATTERN.search(fit(value)):
        message = f"'{shown(value.text)}' in column '{shown(column)}' has a {found[0]}"
        raise refused(value, f"{message}: patterns are allowed only in a role or in `values`")


def _columns(each: ListedName, roles: Mapping[str, Role]) -> dict[str, Any]:
    """A row's role, domains, validity and request; empty values are ignored."""
    readers: Readers = {"role": lambda item: roles[chosen(item, roles)], **_COLUMNS}
    return {
        key: reader(Text(each.line, each.columns[key], plain=False))
        for key, reader in readers.items()
        if each.columns.get(key)
    }
