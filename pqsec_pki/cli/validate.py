"""pqsec validate: check documents against their schemas."""

from pathlib import Path
from typing import Any

import click

from pqsec_pki.cli import _help, _printing, _settings
from pqsec_pki.errors import InvalidDocumentError, MalformedError
from pqsec_pki.policy import valid_kind


@_help.command(
    examples={
        "Check two documents": (
            "pqsec validate robots/enclaves/governance.xml robots/enclaves/talker/permissions.p7s"
        ),
    },
    exit_codes={
        0: "all documents are valid",
        1: "a document is not valid",
        3: "a file cannot be read",
    },
)
@click.argument(
    "files",
    nargs=-1,
    required=True,
    type=_settings.FILE,
    metavar="FILE...",
)
@_settings.command_options
def validate(files: tuple[Path, ...]) -> None:
    """Check governance and permissions documents against their schemas.

    FILE is XML, a signed file with XML inside, or YAML. The kind of document is detected.
    Signatures are not checked: use `pqsec verify`.
    """
    results = [_validated(file) for file in files]
    lines = []
    for result in results:
        if result["valid"]:
            lines.append(f"{result['file']}: valid {result['kind']} document")
        lines += [f"{result['file']}: {problem['text']}" for problem in result["problems"]]
    _printing.emit({"files": results}, lines)
    if not all(result["valid"] for result in results):
        click.get_current_context().exit(1)


def _validated(file: Path) -> dict[str, Any]:
    try:
        kind = valid_kind(file, _settings.now())
    except InvalidDocumentError as error:
        problems = [
            {"line": each.line, "element": each.element, "rule": each.message, "text": str(each)}
            for each in error.problems
        ]
        return {"file": str(file), "valid": False, "kind": None, "problems": problems}
    except MalformedError as error:
        text = error.words_at(file)
        problem = {"line": None, "element": None, "rule": text, "text": text}
        return {"file": str(file), "valid": False, "kind": None, "problems": [problem]}
    return {"file": str(file), "valid": True, "kind": kind.value, "problems": []}
