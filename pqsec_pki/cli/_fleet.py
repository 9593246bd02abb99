"""Whom who-may asks about: the participants of a keystore, or of permissions documents."""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from pqsec_pki.access.matrix import Member
from pqsec_pki.cli import _common
from pqsec_pki.cli._documents import (
    Loaded,
    governance_in,
    identity,
    judge_in,
    kind_of,
    own_permissions,
    permissions_in,
    shared_governance,
)
from pqsec_pki.documents import DomainRange, DomainSet, Governance, Kind, Permissions, parse_subject
from pqsec_pki.errors import FileError, MalformedError, PqsecError, UsageError
from pqsec_pki.keystore import Keystore

_SETTINGS = "pqsec.json"
_SIGNED_FIRST = (".p7s", ".xml", ".yaml", ".yml")


@dataclass(frozen=True, slots=True)
class Fleet:
    """Participants, and the governance that they share."""

    governance: Governance
    members: list[Member]
    refused: dict[str, str]
    """Who is left out, and why: no stack would believe its documents."""


def fleet_of(paths: tuple[Path, ...], governance: Path | None, now: datetime) -> Fleet:
    """Of a keystore, of files, or of folders of files; without any, of the user's keystore.

    UsageError if it is not clear which governance counts, FileError if there is nobody.
    """
    if not paths:
        paths = (_common.keystore_path(),)
    if len(paths) == 1 and (paths[0] / _SETTINGS).is_file():
        if governance:
            raise UsageError("--governance is for files; a keystore has its own")
        return _in_keystore(Keystore.open(paths[0]), now)
    return _in_files(paths, governance, now)


def _in_keystore(keystore: Keystore, now: datetime) -> Fleet:
    judge = judge_in(keystore, now)
    governance = shared_governance(keystore, judge)
    members, refused = list[Member](), dict[str, str]()
    for name in keystore.names():
        try:
            subject = identity(keystore, name, now).subject_name
            permissions = own_permissions(keystore, name, now, judge).value
        except PqsecError as error:
            refused[name] = str(error)
        else:
            members.append(Member(name=name, subject=subject, permissions=permissions))
    return Fleet(governance.value, members, refused)


def _in_files(paths: Iterable[Path], governance: Path | None, now: datetime) -> Fleet:
    found: list[Loaded[Permissions]] = []
    governing = [governance_in(governance)] if governance else []
    refused: dict[str, str] = {}
    for path, is_named in _files(paths):
        try:
            if kind_of(path) is Kind.PERMISSIONS:
                found.append(permissions_in(path, now))
            elif not governance:
                governing.append(governance_in(path))
        except PqsecError as error:
            if is_named:
                raise
            refused[str(path)] = str(error)
    if not found:
        raise FileError("there is no permissions document", hint="name files, or their folder")
    if len({each.value for each in governing}) > 1:
        raise UsageError(
            "there is more than one governance document", hint="say which: --governance FILE"
        )
    if not governing:
        _common.note("there is no governance document: taken as if it controlled everything")
    if any(each.signed for each in found) or any(each.signed for each in governing):
        _common.note("who signed the documents was not checked")
    everywhere = Governance.protected(DomainSet(parts=(DomainRange(first=0),)))
    members = list(_members(found, refused))
    return Fleet(governing[0].value if governing else everywhere, members, refused)


def _members(documents: list[Loaded[Permissions]], refused: dict[str, str]) -> Iterator[Member]:
    """Each subject of each document; with the file where it is in several."""
    subjects = [dict.fromkeys(each.subject_name for each in one.value.grants) for one in documents]
    times = Counter(subject for one in subjects for subject in one)
    for document, subject in (
        (document, each) for document, one in zip(documents, subjects, strict=True) for each in one
    ):
        name = subject if times[subject] == 1 else f"{subject} ({document.path})"
        try:
            parse_subject(subject)
        except MalformedError as error:
            refused[name] = str(error)
        else:
            yield Member(name=name, subject=subject, permissions=document.value)


def _files(paths: Iterable[Path]) -> Iterator[tuple[Path, bool]]:
    """The files, and whether the user named each; of x.p7s and x.xml in a folder the signed."""
    for path in paths:
        if not path.is_dir():
            yield path, True
            continue
        by_name: dict[Path, Path] = {}
        every = (each for ending in _SIGNED_FIRST for each in sorted(path.rglob(f"*{ending}")))
        for each in every:
            by_name.setdefault(each.with_suffix(""), each)
        yield from ((each, False) for each in sorted(by_name.values()))
