"""The participants for who-may: from a keystore, or from permissions documents."""

import stat
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import nullcontext
from dataclasses import field
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TypeGuard

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import exists, is_folder, walk
from pqsec_pki._progress import counted
from pqsec_pki.access import Action, DocumentOwner, Interpretation, Question
from pqsec_pki.credentials import TrustAnchors
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
from pqsec_pki.keystore import (
    SETTINGS,
    CurrentFiles,
    Keystore,
    expanded,
    public_files,
    refuse_other_governance,
    refuse_other_permissions,
)
from pqsec_pki.policy.loading import Document, Loaded, document_at, governance_in
from pqsec_pki.policy.participants import (
    PolicyInput,
    identity_of,
    own_governance,
    own_permissions,
    shared_governance,
    valid_anchors,
)
from pqsec_pki.problems import Code, Problem

_SIGNED_FIRST = (".p7s", ".xml", ".yaml", ".yml")


@dataclass(frozen=True, slots=True)
class Fleet:
    """Participants and their shared governance."""

    governance: Governance
    members: list[DocumentOwner]
    refused: dict[str, str]
    """Participants or files that are left out, and why: no stack would accept the documents."""
    notes: tuple[str, ...] = ()
    """What was assumed, or not checked."""
    inputs: dict[str, PolicyInput] = field(default_factory=dict, repr=False)
    """Each member's documents as read, for the place of a rule."""
    keystore: Keystore | None = field(default=None, repr=False)

    def named(self, names: Iterable[str]) -> list[str]:
        """The names, each once; for a pattern or a group the members that it matches.

        Files have no groups. Errors as of `Keystore.named`.
        """
        known = [member.name for member in self.members]
        return self.keystore.named(names, known) if self.keystore else expanded(names, known, {})


def fleet_of(
    paths: tuple[Path, ...], governance: Path | None, now: datetime, *readings: Interpretation
) -> Fleet:
    """From one keystore, or from files and folders of files.

    UsageError if the governance is ambiguous, FileError if there are no permissions.
    """
    if len(paths) == 1 and exists(paths[0] / SETTINGS):
        if governance:
            raise UsageError("--governance is for files: a keystore has its own governance")
        return fleet_in(Keystore.open(paths[0]), now, *readings)
    return _in_files(paths, governance, now)


def fleet_in(
    keystore: Keystore,
    now: datetime,
    *readings: Interpretation,
    anchors: TrustAnchors | None = None,
    compared: bool = True,
) -> Fleet:
    """The participants of a keystore; those without a grant by any of `readings` are left out.

    `anchors` are those of the keystore, if they were read before. KeystoreError if the governance,
    the list or a CA is not the current one (`CurrentFiles`), unless it is not to be `compared`, or
    this user may not read the ledger. VerificationError if the governance of another set of
    credentials says something else; a participant whose permissions do so is refused.
    """
    refuse_other_governance(keystore)
    with CurrentFiles.if_readable(keystore) if compared else nullcontext() as current:
        if current:
            current.refuse_others_of_all()
        return _fleet_of(keystore, now, readings, anchors or keystore.anchors, current)


def _fleet_of(
    keystore: Keystore,
    now: datetime,
    readings: tuple[Interpretation, ...],
    anchors: TrustAnchors,
    current: CurrentFiles | None,
) -> Fleet:
    anchors = valid_anchors(anchors, now)
    check = partial(anchors.verified, now=now)
    governance = shared_governance(keystore, check, any_markup=True)
    members, refused = list[DocumentOwner](), dict[str, str]()
    inputs = dict[str, PolicyInput]()
    names, linked = keystore.names_of_all(), dict[str, bytes]()
    for name in counted(names, len(names), "participants"):
        try:
            files = public_files(keystore.folder, name, linked)
            certificate = identity_of(keystore, name, anchors, now, files)
            subject = certificate.subject_name
            own = own_permissions(keystore, name, now, check, files, any_markup=True)
            refuse_other_permissions(keystore, name)
            with located(own.path):
                _refuse_ungranted(own.value, subject, now, readings)
            if own_governance(keystore, name, governance, check, files) != governance.value:
                raise VerificationError("its governance differs from the governance of the others")
            if current:
                current.refuse_others(name, files)
        except PqsecError as error:
            _refuse_unreadable(error)
            refused[name] = str(error)
        else:
            members.append(DocumentOwner(name=name, subject=subject, permissions=own.value))
            inputs[name] = PolicyInput(
                who=name,
                subject=subject,
                governance=governance,
                permissions=own,
                not_after=min(certificate.not_after, anchors.not_after),
            )
    return Fleet(governance.value, members, refused, inputs=inputs, keystore=keystore)


def _refuse_ungranted(
    permissions: Permissions, subject: str, now: datetime, readings: Iterable[Interpretation]
) -> None:
    """VerificationError if no grant is for the subject."""
    question = Question(subject=subject, domain=0, action=Action.JOIN, now=now)
    if all(each.grant_for(permissions, question) is None for each in readings):
        raise VerificationError(Problem(f"no grant is for {subject}", Code.NO_GRANT))


def _in_files(paths: Iterable[Path], governance: Path | None, now: datetime) -> Fleet:
    notes = list[str]()
    documents, refused = _documents(paths, now)
    found = list(filter(_has_permissions, documents))
    if not found:
        raise FileError(
            "there is no permissions document", hint="name files, or a folder with files"
        )
    if governance:
        documents = [*found, governance_in(governance, any_markup=True)]
    governing = list(filter(_has_governance, documents))
    if len({each.value for each in governing}) > 1:
        raise UsageError(
            "there is more than one governance document", hint="choose one: --governance FILE"
        )
    if not governing:
        notes.append(
            "there is no governance document: everything is assumed to be access-controlled"
        )
        assumed = Governance.protected(DomainSet(parts=(DomainRange(first=0),)))
        governing = [Loaded(Path(), assumed, signed=False, verified=False, before=0)]
    if any(each.signed for each in documents):
        notes.append("the signatures of the documents were not checked")
    inputs = {each.who: each for each in _inputs(found, governing[0], refused)}
    members = [
        DocumentOwner(name=name, subject=each.subject, permissions=each.permissions.value)
        for name, each in inputs.items()
    ]
    return Fleet(governing[0].value, members, refused, tuple(notes), inputs)


def _has_permissions(document: Document) -> TypeGuard[Loaded[Permissions]]:
    return isinstance(document.value, Permissions)


def _has_governance(document: Document) -> TypeGuard[Loaded[Governance]]:
    return isinstance(document.value, Governance)


def _documents(paths: Iterable[Path], now: datetime) -> tuple[list[Document], dict[str, str]]:
    """The documents that can be read; and for other files in folders, the reason."""
    found: list[Document] = []
    refused: dict[str, str] = {}
    for path, is_named in _files(paths):
        try:
            found.append(document_at(path, now, any_markup=True))
        except PqsecError as error:
            if is_named:
                raise
            _refuse_unreadable(error)
            refused[str(path)] = str(error)
    return found, refused


def _inputs(
    found: list[Loaded[Permissions]], governance: Loaded[Governance], refused: dict[str, str]
) -> Iterator[PolicyInput]:
    """Each subject of each document; its name has the file if several files have the subject."""
    subjects = [
        (document, subject)
        for document in found
        for subject in dict.fromkeys(each.subject_name for each in document.value.grants)
    ]
    times = Counter(subject for _, subject in subjects)
    for document, subject in subjects:
        name = subject if times[subject] == 1 else f"{subject} ({document.path})"
        try:
            parse_subject(subject)
        except MalformedError as error:
            refused[name] = str(error)
        else:
            yield PolicyInput(
                who=name, subject=subject, governance=governance, permissions=document
            )


def _files(paths: Iterable[Path]) -> Iterator[tuple[Path, bool]]:
    """Each file, and whether the user named it. In a folder, x.p7s is preferred to x.xml."""
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
    """Whether it is not a folder, pipe or device. True if unknown: reading gives the error."""
    try:
        return stat.S_ISREG(path.stat().st_mode)
    except OSError:
        return True


def _refuse_unreadable(error: PqsecError) -> None:
    """An unreadable file may grant any right: raise its error. Without it the answer is wrong."""
    if isinstance(error, FileError) and not isinstance(error, MissingError):
        raise error
