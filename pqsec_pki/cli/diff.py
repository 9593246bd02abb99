"""pqsec diff: what does a change of policy grant and take away?"""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import click

from pqsec_pki.access import SPEC
from pqsec_pki.access.change import Change, Difference, Sense
from pqsec_pki.access.diff import permissions_diff
from pqsec_pki.access.governance_diff import governance_diff
from pqsec_pki.cli import _common
from pqsec_pki.cli._documents import (
    governance_in,
    kind_of,
    own_permissions,
    permissions_in,
    plain,
    shared_governance,
)
from pqsec_pki.documents import Kind, Permissions
from pqsec_pki.errors import UsageError
from pqsec_pki.keystore import Keystore

_PATH = type(_common.FILE)(path_type=Path, readable=False)


@dataclass(frozen=True, slots=True)
class _Part:
    """What differs in a document, and whose it is."""

    about: str
    difference: Difference


@click.command()
@click.argument("old", type=_PATH)
@click.argument("new", type=_PATH)
@_common.command_options
def diff(old: Path, new: Path) -> int:
    """Tell what a change of policy grants and takes away.

    OLD and NEW are two governance or two permissions documents (.xml, .p7s, .yaml), or two
    keystores. Signatures are not looked at. The exit code is 0 if they allow the same, and
    1 if not.
    """
    now = _common.now()
    if old.is_dir() != new.is_dir():
        raise UsageError(f"{old} and {new} are a folder and a file")
    parts = list(_keystores(old, new, now) if old.is_dir() else _files(old, new, now))
    changes = [change for part in parts for change in part.difference.changes]
    if not all(part.difference.complete for part in parts):
        _common.note(
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
    _common.emit(value, _lines(parts))
    return 1 if changes else 0


def _files(old: Path, new: Path, now: datetime) -> Iterator[_Part]:
    kind, other = kind_of(old), kind_of(new)
    if kind is not other:
        raise UsageError(f"{old} is a {kind} document, and {new} a {other} one")
    if kind is Kind.GOVERNANCE:
        difference = governance_diff(governance_in(old).value, governance_in(new).value)
    else:
        before, after = permissions_in(old, now), permissions_in(new, now)
        difference = permissions_diff(before.value, after.value)
    yield _Part(kind.value, difference)


def _keystores(old: Path, new: Path, now: datetime) -> Iterator[_Part]:
    before, after = Keystore.open(old), Keystore.open(new)
    governances = (shared_governance(each, None).value for each in (before, after))
    yield _Part("governance", governance_diff(*governances))
    for name in sorted({*before.names(), *after.names()}):
        documents = (_own(each, name, now) for each in (before, after))
        yield _Part(f"permissions of {name}", permissions_diff(*documents))


def _own(keystore: Keystore, name: str, now: datetime) -> Permissions | None:
    if name not in keystore.names():
        return None
    return own_permissions(keystore, name, now, None).value


def _as_json(change: Change) -> dict[str, object]:
    return {
        "sense": change.sense.value,
        "as": change.reading,
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
    elif all(change.reading != SPEC.name for change in changes):
        yield "no change by the standard, but in stacks that read the documents otherwise"
    for sense in Sense:
        alike = [change for change in changes if change.sense is sense]
        if alike:
            yield f"{sense}:"
        for change in alike:
            subject = f"{change.subject}: " if change.subject else ""
            yield f"  {plain(subject + change.text)}"
