"""pqsec diff: show which rights a policy change grants and removes."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import click

from pqsec_pki.access import SPEC, Sense
from pqsec_pki.cli import _help, _pager, _printing, _settings
from pqsec_pki.policy import DocumentDifference, differences_between

_PATH = type(_settings.FILE)(path_type=Path, readable=False)


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
@_pager.option
@_settings.command_options
def diff(old: Path, new: Path) -> int:
    """Show the rights that a policy change grants and removes.

    OLD and NEW are two governance or two permissions documents (.xml, .p7s, .yaml), or two
    keystores. Signatures are not checked.
    """
    parts = differences_between(old, new, _settings.now())
    changes = [change for part in parts for change in part.difference.changes]
    value = {
        "same": not changes,
        "complete": note_incomplete(parts),
        "changes": [each for part in parts for each in part.to_json()],
    }
    _printing.emit(value, difference_lines(parts))
    return 1 if changes else 0


def note_incomplete(parts: Sequence[DocumentDifference]) -> bool:
    """Whether the differences are complete; a note if not."""
    complete = all(part.difference.complete for part in parts)
    if not complete:
        _printing.note(
            "too many patterns overlap to compare all: the changes shown are correct, but there may"
            " be more"
        )
    return complete


def difference_lines(parts: Sequence[DocumentDifference]) -> Iterator[str]:
    """The changes of rights and protection as text, those that grant first."""
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
            yield f"  {_printing.printable(f'{owner}: {text}' if owner else text)}"
