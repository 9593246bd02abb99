"""The rights that a change of documents, or of a keystore, grants and removes."""

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import is_folder, read
from pqsec_pki.access import Change, Difference, permissions_diff
from pqsec_pki.access.governance_diff import governance_diff
from pqsec_pki.documents import Governance, Permissions
from pqsec_pki.errors import UsageError
from pqsec_pki.keystore import Keystore, refuse_other_governance, refuse_other_permissions
from pqsec_pki.policy.loading import Loaded, document_at, kind_of
from pqsec_pki.policy.participants import own_governance, own_permissions, shared_governance


@dataclass(frozen=True, slots=True)
class DocumentDifference:
    """The differences of a document."""

    about: str
    difference: Difference
    owner: str = ""
    """The participant, if the document is not shared with others; else empty."""

    def to_json(self) -> list[dict[str, object]]:
        """One object for each change."""
        return [{"document": self.about, **_as_json(each)} for each in self.difference.changes]


def differences_between(old: Path, new: Path, now: datetime) -> list[DocumentDifference]:
    """The differences between two documents, or two keystores. Signatures are not checked.

    FileError if one cannot be read; UsageError for a file and a folder, or documents of
    different kinds; VerificationError if the sets of credentials of a keystore say different
    things.
    """
    if is_folder(old) != is_folder(new):
        read(new if is_folder(old) else old)  # it may not exist
        raise UsageError(f"one of {old} and {new} is a folder, and the other a file")
    return list(_of_keystores(old, new, now) if is_folder(old) else _of_files(old, new, now))


def _of_files(old: Path, new: Path, now: datetime) -> Iterator[DocumentDifference]:
    before, after = document_at(old, now), document_at(new, now)
    one, other = before.value, after.value
    if isinstance(one, Governance) and isinstance(other, Governance):
        difference = governance_diff(one, other)
    elif isinstance(one, Permissions) and isinstance(other, Permissions):
        difference = permissions_diff(one, other)
    else:
        kinds = kind_of(before), kind_of(after)
        raise UsageError(f"{old} is a {kinds[0]} document, and {new} is a {kinds[1]} document")
    yield DocumentDifference(kind_of(before).value, difference)


def _of_keystores(old: Path, new: Path, now: datetime) -> Iterator[DocumentDifference]:
    before, after = _KeystorePolicy.of(old), _KeystorePolicy.of(new)
    shared = before.governance.value, after.governance.value
    yield DocumentDifference("governance", governance_diff(*shared))
    for name in sorted(before.names | after.names):
        documents = (each.permissions_of(name, now) for each in (before, after))
        yield DocumentDifference(f"permissions of {name}", permissions_diff(*documents))
        own = before.governance_of(name), after.governance_of(name)
        if own != shared and name in after.names:
            yield DocumentDifference(f"governance of {name}", governance_diff(*own), name)


@dataclass(frozen=True, slots=True)
class _KeystorePolicy:
    """The documents of a keystore."""

    keystore: Keystore
    names: frozenset[str]
    governance: Loaded[Governance]
    """The shared governance."""

    @classmethod
    def of(cls, root: Path) -> "_KeystorePolicy":
        keystore = Keystore.open(root)
        refuse_other_governance(keystore)
        return cls(keystore, frozenset(keystore.names()), shared_governance(keystore, None))

    def permissions_of(self, name: str, now: datetime) -> Permissions | None:
        if name not in self.names:
            return None
        refuse_other_permissions(self.keystore, name)
        return own_permissions(self.keystore, name, now, None).value

    def governance_of(self, name: str) -> Governance:
        """The participant's own governance if there is one, else the shared one."""
        if name not in self.names:
            return self.governance.value
        return own_governance(self.keystore, name, self.governance, None)


def _as_json(change: Change) -> dict[str, object]:
    return {
        "sense": change.sense.value,
        "as": change.interpretation,
        "subject": change.subject or None,
        "actions": [action.value for action in change.actions],
        "topics": [topics.to_json() for topics in change.topics],
        "where": change.domains,
        "text": change.text,
    }
