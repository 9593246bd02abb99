"""Whom who-may asks about: the participants of a keystore, or of permissions documents."""

import stat
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path

from pqsec_pki._files import exists, is_folder, walk
from pqsec_pki.access import Action, Interpretation, Question
from pqsec_pki.access.matrix import Member
from pqsec_pki.cli import _printing, _settings
from pqsec_pki.cli._documents import (
    Document,
    anchors_of,
    document_at,
    governance_in,
    identity_of,
    own_governance,
    own_permissions,
    shared_governance,
)
from pqsec_pki.documents import DomainRange, DomainSet, Governance, Permissions, parse_subject
from pqsec_pki.errors import (
    FileError,
    MalformedError,
    MissingError,
    PqsecError,
    UsageError,
    VerificationError,
    located,
)
from pqsec_pki.keystore import SETTINGS, Keystore
from pqsec_pki.problems import Code, Problem

_SIGNED_FIRST = (".p7s", ".xml", ".yaml", ".yml")


@dataclass(frozen=True, slots=True)
class Fleet:
    """Participants, and the governance that they share."""

    governance: Governance
    members: list[Member]
    refused: dict[str, str]
    """Who is left out, and why: no stack would believe its documents."""


def fleet_of(
    paths: tuple[Path, ...], governance: Path | None, now: datetime, reading: Interpretation
) -> Fleet:
    """Of a keystore, of files, or of folders of files; without any, of the user's keystore.

    Of a keystore, who has no grant by `reading` is left out.

    UsageError if it is not clear which governance counts, FileError if there is nobody.
    """
    root = paths[0] if paths else _settings.keystore_path()
    if not paths or (len(paths) == 1 and exists(root / SETTINGS)):
        if governance:
            raise UsageError("--governance is for files; a keystore has its own")
        return _in_keystore(Keystore.open(root), now, reading)
    return _in_files(paths, governance, now)


def _in_keystore(keystore: Keystore, now: datetime, reading: Interpretation) -> Fleet:
    anchors = anchors_of(keystore, now)
    check = partial(anchors.verified, now=now)
    governance = shared_governance(keystore, check)
    members, refused = list[Member](), dict[str, str]()
    for name in (*keystore.names(), *keystore.incomplete()):
        try:
            subject = identity_of(keystore, name, anchors, now).subject_name
            own = own_permissions(keystore, name, now, check)
            with located(own.path):
                _refuse_ungranted(own.value, subject, now, reading)
            if own_governance(keystore, name, governance, check) != governance.value:
                raise VerificationError("it has a governance of its own, unlike the others")
        except PqsecError as error:
            _refuse_unreadable(error)
            refused[name] = str(error)
        else:
            members.append(Member(name=name, subject=subject, permissions=own.value))
    return Fleet(governance.value, members, refused)


def _refuse_ungranted(
    permissions: Permissions, subject: str, now: datetime, reading: Interpretation
) -> None:
    """VerificationError if none of the grants is the subject's."""
    question = Question(subject=subject, domain=0, action=Action.JOIN, now=now)
    if reading.grant_for(permissions, question) is None:
        raise VerificationError(Problem(f"nothing in them is granted to {subject}", Code.NO_GRANT))


def _in_files(paths: Iterable[Path], governance: Path | None, now: datetime) -> Fleet:
    documents, refused = _documents(paths, now)
    found = [(each.path, each.value) for each in documents if isinstance(each.value, Permissions)]
    if not found:
        raise FileError("there is no permissions document", hint="name files, or their folder")
    if governance:
        documents = [each for each in documents if isinstance(each.value, Permissions)]
        documents.append(governance_in(governance))
    governing = [each.value for each in documents if isinstance(each.value, Governance)]
    if len(set(governing)) > 1:
        raise UsageError(
            "there is more than one governance document", hint="say which: --governance FILE"
        )
    if not governing:
        _printing.note("there is no governance document: taken as if it controlled everything")
        governing = [Governance.protected(DomainSet(parts=(DomainRange(first=0),)))]
    if any(each.signed for each in documents):
        _printing.note("who signed the documents was not checked")
    members = list(_members(found, refused))
    return Fleet(governing[0], members, refused)


def _documents(paths: Iterable[Path], now: datetime) -> tuple[list[Document], dict[str, str]]:
    """Those that can be read, and why others in folders cannot."""
    found: list[Document] = []
    refused: dict[str, str] = {}
    for path, is_named in _files(paths):
        try:
            found.append(document_at(path, now))
        except PqsecError as error:
            if is_named:
                raise
            _refuse_unreadable(error)
            refused[str(path)] = str(error)
    return found, refused


def _members(found: list[tuple[Path, Permissions]], refused: dict[str, str]) -> Iterator[Member]:
    """Each subject of each document; with the file where it is in several."""
    subjects = [
        (path, permissions, subject)
        for path, permissions in found
        for subject in dict.fromkeys(each.subject_name for each in permissions.grants)
    ]
    times = Counter(subject for *_, subject in subjects)
    for path, permissions, subject in subjects:
        name = subject if times[subject] == 1 else f"{subject} ({path})"
        try:
            parse_subject(subject)
        except MalformedError as error:
            refused[name] = str(error)
        else:
            yield Member(name=name, subject=subject, permissions=permissions)


def _files(paths: Iterable[Path]) -> Iterator[tuple[Path, bool]]:
    """The files, and whether the user named each; of x.p7s and x.xml in a folder the signed."""
    for path in paths:
        if not is_folder(path):
            yield path, True
            continue
        by_name: dict[Path, Path] = {}
        every = sorted(folder / name for folder, names in walk(path) for name in names)
        ours = (each for ending in _SIGNED_FIRST for each in every if each.suffix == ending)
        for each in filter(_is_regular, ours):
            by_name.setdefault(each.with_suffix(""), each)
        yield from ((each, False) for each in sorted(by_name.values()))


def _is_regular(path: Path) -> bool:
    """Whether it is neither a folder nor a pipe that would never end; reading tells the rest."""
    try:
        return stat.S_ISREG(path.stat().st_mode)
    except OSError:
        return True


def _refuse_unreadable(error: PqsecError) -> None:
    """Whom a closed file is about may have any right: an answer without them is not one."""
    if isinstance(error, FileError) and not isinstance(error, MissingError):
        raise error
