"""pqsec diff: what does a change of policy grant and take away?"""

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
from pqsec_pki.cli import _printing, _settings
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
    """What differs in a document, and whose it is."""

    about: str
    difference: Difference
    whose: str = ""
    """The participant that has a document of its own where others share one."""


@click.command()
@click.argument("old", type=_PATH)
@click.argument("new", type=_PATH)
@_settings.command_options
def diff(old: Path, new: Path) -> int:
    """Tell what a change of policy grants and takes away.

    OLD and NEW are two governance or two permissions documents (.xml, .p7s, .yaml), or two
    keystores. Signatures are not looked at. The exit code is 0 if they allow the same, and
    1 if not.
    """
    now = _settings.now()
    if is_folder(old) != is_folder(new):
        raise UsageError(f"{old} and {new} are a folder and a file")
    parts = list(_keystores(old, new, now) if is_folder(old) else _files(old, new, now))
    changes = [change for part in parts for change in part.difference.changes]
    if not all(part.difference.complete for part in parts):
        _printing.note(
            "the patterns overlap in too many ways to try all: what is told is true, but there"
            " may be more"
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
        raise UsageError(f"{old} is a {kinds[0]} document, and {new} a {kinds[1]} one")
    yield _Part(kind_of(before).value, difference)


def _keystores(old: Path, new: Path, now: datetime) -> Iterator[_Part]:
    before, after = _Kept.of(old), _Kept.of(new)
    shared = before.governance.value, after.governance.value
    yield _Part("governance", governance_diff(*shared))
    for name in sorted(before.names | after.names):
        documents = (each.permissions_of(name, now) for each in (before, after))
        yield _Part(f"permissions of {name}", permissions_diff(*documents))
        own = before.governance_of(name), after.governance_of(name)
        if own != shared and name in after.names:
            yield _Part(f"governance of {name}", governance_diff(*own), name)


@dataclass(frozen=True, slots=True)
class _Kept:
    """What a keystore holds."""

    keystore: Keystore
    names: frozenset[str]
    governance: Loaded[Governance]
    """The one that all share."""

    @classmethod
    def of(cls, root: Path) -> "_Kept":
        keystore = Keystore.open(root)
        return cls(keystore, frozenset(keystore.names()), shared_governance(keystore, None))

    def permissions_of(self, name: str, now: datetime) -> Permissions | None:
        if name not in self.names:
            return None
        return own_permissions(self.keystore, name, now, None).value

    def governance_of(self, name: str) -> Governance:
        """Its own, if it has one."""
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
        yield f"no change in what is allowed and how it is protected{reason}"
    elif all(change.interpretation != SPEC.name for change in changes):
        yield "no change by the standard, but in stacks that read the documents otherwise"
    for sense in Sense:
        alike = [
            (change.subject or part.whose, change.text)
            for part in parts
            for change in part.difference.changes
            if change.sense is sense
        ]
        if alike:
            yield f"{sense}:"
        for whose, text in alike:
            yield f"  {plain(f'{whose}: {text}' if whose else text)}"
