"""From the items of a domain file to its participants, each once."""

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import timedelta
from difflib import get_close_matches
from pathlib import Path
from sys import intern
from typing import Any

from pqsec_pki.documents.parts_yaml import Readers, Text, chosen, domains, refused, text
from pqsec_pki.domain._listing import (
    MAX_PARTICIPANTS,
    MAX_PROBLEMS,
    Listed,
    gathered,
    names_in_csv,
    names_in_list,
)
from pqsec_pki.domain._placeholders import OWN, fit
from pqsec_pki.domain.desired import Member, Role, validity_in
from pqsec_pki.enrolment import flat_name
from pqsec_pki.errors import InvalidDocumentError, located, shown
from pqsec_pki.problems import Problem

_NOTHING: Mapping[str, str] = {}
_COLUMNS: Readers = {"domains": domains, "validity": validity_in, "request": text}
"""What a row may say beside its name and role."""
_PATTERN = re.compile(r"[*?\[\\]")
"""What POSIX fnmatch takes for more than itself."""
_ALMOST = 0.8
"""Of difflib's measure: domain and Validity, but not site."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One item of `participants`, as it was read."""

    line: int
    roles: Mapping[str, Role]
    """All there are: a CSV file may name them."""
    said: Mapping[str, Any]

    def listed(self, folder: Path) -> tuple[Path | None, list[Listed]]:
        """The names it stands for, and the file that they are in if it is another."""
        if "csv" in self.said:
            path = folder / self.said["csv"]
            return path, names_in_csv(path)
        if "list" in self.said:
            path = folder / self.said["list"]
            return path, names_in_list(path)
        return None, gathered(self.said["name"])


def members_of(
    source: Path, entries: Iterable[Entry], said: Mapping[str, Any]
) -> dict[str, Member]:
    """All participants by name; `said` is what the file says for all of them.

    InvalidDocumentError where one comes twice, lacks a value or has a bad one.
    """
    gatherer = _Gatherer(source, said)
    for entry in entries:
        gatherer.gather(entry)
    one_of_each_role = {member.role: member for member in gatherer.members.values()}
    for member in one_of_each_role.values():
        member.spec()  # so that a slip in a role shows before anything is made
    return gatherer.members


class _Gatherer:
    """Participants so far, and where each was found."""

    def __init__(self, source: Path, said: Mapping[str, Any]) -> None:
        self._source = source
        self._said = said
        self._places: dict[str, str] = {}
        self._requests: dict[Path, str] = {}
        self.members: dict[str, Member] = {}

    def gather(self, entry: Entry) -> None:
        path, listed = entry.listed(self._source.parent)
        problems: list[Problem] = []
        with located(path or self._source):
            _refuse_slips(listed[:1], entry)
            for each in listed:
                try:
                    self._add(each, entry, f"{path}: " if path else "")
                except InvalidDocumentError as error:
                    problems += error.problems
            if problems:
                raise InvalidDocumentError(problems[:MAX_PROBLEMS])

    def _add(self, each: Listed, entry: Entry, file: str) -> None:
        if place := self._places.get(each.name):
            raise refused(each.line, f"{each.name} comes twice, first in {place}")
        if len(self.members) == MAX_PARTICIPANTS:
            raise refused(each.line, f"more than {MAX_PARTICIPANTS} participants")
        self._places[each.name] = intern(f"{file}line {each.line}")
        self.members[each.name] = member = self._member(each, entry)
        if member.request:
            first = self._requests.setdefault(member.request, each.name)
            if first != each.name:
                message = f"{first} and {each.name} cannot have one request; name a folder,"
                raise refused(each.line, f"{message} with one called like each: a+b.csr for /a/b")

    def _member(self, each: Listed, entry: Entry) -> Member:
        said = {**entry.said, **_columns(each, entry.roles)}
        role: Role | None = said.get("role")
        if role is None:
            raise refused(each.line, f"{each.name} has no role")
        return Member(
            name=each.name,
            role=role,
            domains=said.get("domains") or role.domains or self._said["domains"],
            validity=self._validity(each, said.get("validity") or role.validity),
            values=_values(each, role, said.get("values", _NOTHING)),
            source=self._source,
            request=self._request(each.name, said.get("request")),
        )

    def _request(self, name: str, said: str | None) -> Path | None:
        """A file, or in a folder the one that is called like the participant."""
        if not said:
            return None
        path = self._source.parent / said
        is_folder = said.endswith("/") or os.path.isdir(path)  # noqa: PTH112 -- never raises
        return path / f"{flat_name(name)}.csr" if is_folder else path

    def _validity(self, each: Listed, own: timedelta | None) -> timedelta:
        validity: timedelta = own or self._said["validity"]
        notice: timedelta | None = self._said["renew_before"]
        if notice is not None and notice >= validity:
            message = f"{each.name} would be due when it is made: renew_before is not shorter"
            raise refused(each.line, f"{message} than its validity")
        return validity


def _refuse_slips(first: Iterable[Listed], entry: Entry) -> None:
    """A column that fills no blank, and is called almost like one that counts for its row."""
    own = entry.said.get("role")
    roles = (*entry.roles.values(), *([own] if own else []))
    placeholders = {blank for role in roles for blank in role.placeholders}
    for column in (column for each in first for column in each.columns):
        meant = get_close_matches(column.lower(), ("role", *_COLUMNS), 1, _ALMOST)
        if meant and column not in {"role", *_COLUMNS, *placeholders}:
            raise refused(1, f"no role has ${shown(column)}; is the column '{meant[0]}' meant?")


def _values(each: Listed, role: Role, of_entry: Mapping[str, str]) -> Mapping[str, str]:
    """Of what is known, that which the role asks for."""
    wanted = role.placeholders.difference(OWN)
    if not wanted:
        return _NOTHING
    known = {**of_entry, **each.columns}
    missing = sorted(f"${name}" for name in wanted - known.keys())
    if missing:
        message = f"{each.name}: its role ({role.label}) asks for {', '.join(missing)}"
        raise refused(each.line, message)
    for name in wanted & each.columns.keys():
        _refuse_pattern(name, Text(each.line, each.columns[name], plain=False))
    return {name: known[name] for name in wanted}


def _refuse_pattern(column: str, value: Text) -> None:
    """Who keeps an inventory does not decide that a robot may use the topics of all."""
    if found := _PATTERN.search(fit(value)):
        message = f"'{shown(value.text)}' in column '{shown(column)}' has a {found[0]}"
        raise refused(value, f"{message}: patterns stand in a role, or in `values`")


def _columns(each: Listed, roles: Mapping[str, Role]) -> dict[str, Any]:
    """What a row says of role, domains, validity and request; an empty value says nothing."""
    readers: Readers = {"role": lambda item: roles[chosen(item, roles)], **_COLUMNS}
    return {
        key: reader(Text(each.line, each.columns[key], plain=False))
        for key, reader in readers.items()
        if each.columns.get(key)
    }
