"""Reads the sources of a domain file: keystores, permissions, governance and SROS2 policies."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path

from pqsec_pki._files import exists, is_folder, read
from pqsec_pki.certificates import BACKDATE
from pqsec_pki.documents import (
    DomainSet,
    Governance,
    Grant,
    Permissions,
    lasting,
    parse_subject,
    read_tree,
    sros2,
)
from pqsec_pki.domain._listing import MAX_NAME
from pqsec_pki.domain._shared_rules import FoundParticipant
from pqsec_pki.domain.desired import LONGEST
from pqsec_pki.errors import FileError, MissingError, PqsecError, UsageError, located
from pqsec_pki.keystore import (
    SETTINGS,
    Files,
    Keystore,
    Overlap,
    ParticipantState,
    layout,
    load_certificate,
    regular_name,
    status,
)
from pqsec_pki.lifecycle import adoptable
from pqsec_pki.policy import document_at

_HOUR = timedelta(hours=1)
_CA_NAME = " Identity CA"
"""What the name of a keystore's identity CA ends with."""


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A participant that was not imported, and why."""

    name: str
    why: str
    refused: bool
    """Whether its files are wrong, or a domain file cannot say what they say."""


@dataclass(slots=True)
class ImportSource:
    """What was found in one source."""

    path: Path
    participants: list[FoundParticipant] = field(default_factory=list)
    left_out: list[LeftOut] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    governance: Governance | None = None
    ca_name: str = ""
    """Without ` Identity CA`; empty if the CAs are named otherwise."""
    profile: str = ""
    ca_validity: timedelta | None = None

    def add(
        self,
        name: str,
        grants: Sequence[Grant],
        now: datetime,
        validity: timedelta,
        *,
        key_elsewhere: bool = False,
    ) -> None:
        """Add a participant with the first of its grants that is in force at `now`."""
        grant = next((each for each in grants if each.not_before <= now <= each.not_after), None)
        if not grants:
            self.leave_out(name, "no grant is for its subject", refused=True)
        elif grant is None:
            self.leave_out(name, "its permissions are not in force")
        elif not grant.rules:
            self.leave_out(name, "its grant has no rule, only a default", refused=True)
        else:
            if len(grants) > 1:
                self.notes.append(f"{name} has {len(grants)} grants: the first in force counts")
            found = (name, grant.rules, grant.default, validity, str(self.path), key_elsewhere)
            self.participants.append(FoundParticipant(*found))

    def leave_out(self, name: str, why: str, *, refused: bool = False) -> None:
        """Note a participant that is not imported."""
        self.left_out.append(LeftOut(name, why, refused))


def source_at(path: Path, *, now: datetime, domains: DomainSet) -> ImportSource:
    """What is in a keystore, in a keystore of SROS2, or in a policy.

    `domains` are those of SROS2 policies, which name none. What keystores sign is verified with
    their permissions CA. FileError, MalformedError, InvalidDocumentError or VerificationError
    for a source that cannot be read; KeystoreError for another folder.
    """
    if exists(path / SETTINGS):
        return _of_keystore(Keystore.open(path), now)
    if is_folder(path):
        return _of_other_keystore(path, now)
    if path.suffix == ".xml" and _is_sros2_policy(path):
        return _of_sros2_policy(path, domains, now)
    return _of_document(path, now)


def lifetime(not_before: datetime, not_after: datetime) -> timedelta:
    """The validity with which these times were made, in whole hours."""
    whole = not_after - not_before
    hours = round((whole - BACKDATE if whole > BACKDATE else whole) / _HOUR)
    return min(max(hours, 1) * _HOUR, LONGEST)


# Keystores


def _of_keystore(keystore: Keystore, now: datetime) -> ImportSource:
    source = _with_shared(keystore)
    ca = keystore.identity_ca
    source.ca_validity = lifetime(ca.not_before, ca.not_after)
    states = {
        each.name: each for each in status(keystore, now=now, compare_files=True).participants
    }
    overlap = Overlap.of(keystore) is not None
    for name in sorted({*states, *keystore.names()}):
        held = states.get(name)
        if held is None:
            source.leave_out(name, "is not in the ledger", refused=True)
        elif why := next(_why_not(held, now, overlap=overlap), None):
            refused = held.files in {Files.OTHER_CERTIFICATE, Files.OTHER_PERMISSIONS}
            source.leave_out(name, why, refused=refused)
        else:
            elsewhere = held.requested and not keystore.has_key(name)
            _add_signed(source, keystore, name, now, key_elsewhere=elsewhere)
    return source


def _of_other_keystore(root: Path, now: datetime) -> ImportSource:
    found = adoptable(root, now=now)
    source = _with_shared(found.keystore)
    if not found.fitting:
        source.profile = ""
    for name in found.keystore.names():
        if name in found.revoked:
            source.leave_out(name, "was revoked")
        elif name not in found.participants:
            why = found.refused.get(f"{layout.enclave_folder(name)}/{layout.CERTIFICATE}")
            source.leave_out(name, why or "its certificate is refused", refused=True)
        else:
            _add_signed(source, found.keystore, name, now)
    return source


def _with_shared(keystore: Keystore) -> ImportSource:
    """The governance, profile and name of CAs. VerificationError for a bad signature."""
    with located(keystore.root / layout.ENCLAVES / layout.GOVERNANCE):
        signed = keystore.issuing_cas.signed(keystore.governance)
        governance = Governance.from_xml(signed.document)
    ca = _common_name(keystore.identity_ca.subject_name)
    return ImportSource(
        keystore.root,
        governance=governance,
        ca_name=ca.removesuffix(_CA_NAME) if ca.endswith(_CA_NAME) else "",
        profile=keystore.profile.name,
    )


def _why_not(held: ParticipantState, now: datetime, *, overlap: bool) -> Iterator[str]:
    """Why the file should not have the participant."""
    if held.revoked:
        yield "was revoked"
    if held.files is Files.GONE:
        yield "its certificate is missing"
    if held.files is Files.OTHER_CERTIFICATE:
        yield "its certificate is not the one issued last"
    if held.issued_by_previous_ca and not overlap:
        yield "its CA was replaced"
    if held.not_after < now:
        yield "expired"
    if held.files is Files.OTHER_PERMISSIONS:
        yield "its permissions are not the ones signed last"


def _add_signed(
    source: ImportSource,
    keystore: Keystore,
    name: str,
    now: datetime,
    *,
    key_elsewhere: bool = False,
) -> None:
    """Add a participant by its certificate and its permissions, with their signatures verified."""
    folder = keystore.root / layout.enclave_folder(name)
    try:
        certificate = load_certificate(folder / layout.CERTIFICATE)
        with located(folder / layout.PERMISSIONS):
            signed = keystore.issuing_cas.signed(read(folder / layout.PERMISSIONS))
            permissions = Permissions.from_xml(signed.document)
            grants = permissions.grants_for(certificate.subject_name)
    except PqsecError as error:
        if isinstance(error, FileError) and not isinstance(error, MissingError):
            raise  # the file may be right
        source.leave_out(name, str(error), refused=True)
        return
    if certificate.not_after < now:
        source.leave_out(name, "expired")
        return
    validity = lifetime(certificate.not_before, certificate.not_after)
    source.add(name, grants, now, validity, key_elsewhere=key_elsewhere)


# Policies


def _of_document(path: Path, now: datetime) -> ImportSource:
    loaded = document_at(path, now)
    source = ImportSource(path)
    if loaded.signed:
        source.notes.append(f"{path}: its signature was not checked")
    if isinstance(loaded.value, Governance):
        source.governance = loaded.value
    else:
        with located(path):
            _add_subjects(source, loaded.value, now)
    return source


def _add_subjects(source: ImportSource, permissions: Permissions, now: datetime) -> None:
    """Add a participant for each subject. MalformedError for a text that is no subject name."""
    for subject, named in {each.subject_name: each.name for each in permissions.grants}.items():
        grants = permissions.grants_for(subject)
        name = _participant_name(_common_name(subject), named)
        if not name:
            source.leave_out(subject, "is not the name of a participant", refused=True)
        else:
            lasts = lifetime(grants[0].not_before, grants[0].not_after)
            source.add(name, grants, now, lasts)


def _of_sros2_policy(path: Path, domains: DomainSet, now: datetime) -> ImportSource:
    enclaves = sros2.read_policy(path)
    not_before, not_after = lasting(now, timedelta(days=365))
    permissions = sros2.permissions_of(
        enclaves, domains=domains, not_before=not_before, not_after=not_after
    )
    source = ImportSource(path)
    lacking = [each.path for each in enclaves if sros2.lacking(each)]
    if lacking:
        source.notes.append(
            f"{path}: {lacking[0]}{' and others' * (len(lacking) > 1)} lacks topics that a Jazzy"
            " node needs to start: import what `pqsec permissions import --complete` writes"
        )
    _add_subjects(source, permissions, now)
    return source


def _is_sros2_policy(path: Path) -> bool:
    with suppress(PqsecError):
        return read_tree(read(path)).root.tag == "policy"
    return False


def _common_name(subject: str) -> str:
    """The CN; empty if there is none. MalformedError for a text that is no subject name."""
    parts = [pair for part in parse_subject(subject) for pair in part]
    return next((value for kind, value in parts if kind == "CN"), "")


def _participant_name(*texts: str) -> str:
    """The first that can be a participant's name; empty if none can."""
    for text in texts:
        with suppress(UsageError):
            if len(name := regular_name(text)) <= MAX_NAME:
                return name
    return ""
