"""pqsec diff: show which rights a policy change grants and removes."""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import click

from pqsec_pki._files import is_folder
from pqsec_pki.access import SPEC
from pqsec_pki.access.change import Change, Difference, Sense
from pqsec_pki.access.diff import permissions_diff
from pqsec_pki.access.governance_diff import governance_diff
from pqsec_pki.cli import _help, _printing, _settings
from pqsec_pki.cli._documents import (
    Loaded,
    document_at,
    kind_of,
    own_governance,
    own_permissions,
    plain,
    shared_governance,
)
from pqsec_pki.documents import Governance, Permissions
from pqsec_pki.errors import UsageError
from pqsec_pki.keystore import Keystore

_PATH = type(_settings.FILE)(path_type=Path, readable=False)


@dataclass(frozen=True, slots=True)
class _Part:
    """The differences of a document."""

    about: str
    difference: Difference
    owner: str = ""
    """The participant, if the document is not shared with others; else empty."""


@_help.command(
    examples={
        "Compare an edited document with the signed one": (
            "pqsec diff robots/enclaves/talker/permissions.p7s talker.yaml"
        ),
        "Compare two keystores": "pqsec diff robots.old robots",
    },
    exit_codes={
        0: "no change of rights or protection",
        1: "there are changes, or a document is not valid",
        3: "a file or keystore cannot be read",
    },
)
@click.argument("old", type=_PATH)
@click.argument("new", type=_PATH)
@_settings.command_options
def diff(old: Path, new: Path) -> int:
    """Show the rights that a policy change grants and removes.

    OLD and NEW are two governance or two permissions documents (.xml, .p7s, .yaml), or two
    keystores. Signatures are not checked.
    """
    now = _settings.now()
    if is_folder(old) != is_folder(new):
        raise UsageError(f"one of {old} and {new} is a folder, and the other a file")
    parts = list(_keystores(old, new, now) if is_folder(old) else _files(old, new, now))
    changes = [change for part in parts for change in part.difference.changes]
    if not all(part.difference.complete for part in parts):
        _printing.note(
            "too many patterns overlap to compare all: the changes shown are correct, but there may"
            " be more"
        )
    value = {
        "same": not changes,
        "complete": all(part.difference.complete for part in parts),
        "changes": [
            {"document": part.about, **_as_json(change)}
            for part in parts
            for change in part.difference.changes
        ],
    }
    _printing.emit(value, _lines(parts))
    return 1 if changes else 0


def _files(old: Path, new: Path, now: datetime) -> Iterator[_Part]:
    before, after = document_at(old, now), document_at(new, now)
    one, other = before.value, after.value
    if isinstance(one, Governance) and isinstance(other, Governance):
        difference = governance_diff(one, other)
    elif isinstance(one, Permissions) and isinstance(other, Permissions):
        difference = permissions_diff(one, other)
    else:
        kinds = kind_of(before), kind_of(after)
        raise UsageError(f"{old} is a {kinds[0]} document, and {new} is a {kinds[1]} document")
    yield _Part(kind_of(before).value, difference)


def _keystores(old: Path, new: Path, now: datetime) -> Iterator[_Part]:
    before, after = _KeystorePolicy.of(old), _KeystorePolicy.of(new)
    shared = before.governance.value, after.governance.value
    yield _Part("governance", governance_diff(*shared))
    for name in sorted(before.names | after.names):
        documents = (each.permissions_of(name, now) for each in (before, after))
        yield _Part(f"permissions of {name}", permissions_diff(*documents))
        own = before.governance_of(name), after.governance_of(name)
        if own != shared and name in after.names:
            yield _Part(f"governance of {name}", governance_diff(*own), name)


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
        return cls(keystore, frozenset(keystore.names()), shared_governance(keystore, None))

    def permissions_of(self, name: str, now: datetime) -> Permissions | None:
        if name not in self.names:
            return None
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
        "topics": [
            {
                "name": topics.name,
                "extent": topics.extent.value,
                "such_as": topics.such_as or None,
                "but": list(topics.but),
            }
            for topics in change.topics
        ],
        "where": change.domains,
        "text": change.text,
    }


def _lines(parts: list[_Part]) -> Iterator[str]:
    changes = [change for part in parts for change in part.difference.changes]
    if not changes:
        same = all(part.difference.same_text for part in parts)
        reason = "" if same else "; the documents differ in form or order only"
        yield f"no change of rights or protection{reason}"
    elif all(change.interpretation != SPEC.name for change in changes):
        yield "no change by the standard, but in stacks that interpret the documents differently"
    for sense in Sense:
        alike = [
            (change.subject or part.owner, change.text)
            for part in parts
            for change in part.difference.changes
            if change.sense is sense
        ]
        if alike:
            yield f"{sense}:"
        for owner, text in alike:
            yield f"  {plain(f'{owner}: {text}' if owner else text)}"
