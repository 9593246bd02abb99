"""Reads policies as sources of a domain file: permissions, governance and SROS2 policies."""

from contextlib import suppress
from datetime import datetime, timedelta
from pathlib import Path
from shlex import quote

from pqsec_pki._files import read
from pqsec_pki.certificates import MAX_COMMON_NAME
from pqsec_pki.documents import DomainSet, Governance, Permissions, lasting, read_tree, sros2
from pqsec_pki.domain._sources import ImportSource, common_name_in, lifetime
from pqsec_pki.errors import PqsecError, UsageError, located
from pqsec_pki.keystore import regular_name
from pqsec_pki.policy import document_at


def document_source(path: Path, now: datetime) -> ImportSource:
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
    """Add a participant for each subject. MalformedError for a text that is not a subject name."""
    for subject, named in {each.subject_name: each.name for each in permissions.grants}.items():
        grants = permissions.grants_for(subject)
        name = _participant_name(common_name_in(subject), named)
        if not name:
            source.leave_out(subject, "is not the name of a participant", refused=True)
        else:
            lasts = lifetime(grants[0].not_before, grants[0].not_after)
            source.add(name, grants, now, lasts)


def sros2_policy_source(path: Path, domains: DomainSet, now: datetime) -> ImportSource:
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
            f" node needs to start: `pqsec permissions import --complete {quote(str(path))} -o"
            " complete.yaml` adds them; then import that file"
        )
    _add_subjects(source, permissions, now)
    return source


def is_sros2_policy(path: Path) -> bool:
    with suppress(PqsecError):
        return read_tree(read(path)).root.tag == "policy"
    return False


def _participant_name(*texts: str) -> str:
    """The first that can be a participant's name; empty if none can."""
    for text in texts:
        with suppress(UsageError):
            if len(name := regular_name(text)) <= MAX_COMMON_NAME:
                return name
    return ""
