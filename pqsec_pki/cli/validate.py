"""pqsec validate: check documents against their schemas, and what people write in YAML."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from pqsec_pki._files import read
from pqsec_pki.cli import _help, _printing, _settings
from pqsec_pki.errors import InvalidDocumentError, MalformedError
from pqsec_pki.policy import valid_kind

_SUFFIXES = {".yaml", ".yml"}
_DOMAIN = re.compile(
    rb"(?m)^(name|profile|governance|roles|participants|groups|approvals|ca_validity|renew_before"
    rb"|prune|stacks|migrate_from)[ \t]*:"
)
_SERVE = re.compile(rb"(?m)^(url|listen|tls|keystore)[ \t]*:")
"""Keys at the top that the other kinds do not have."""


@_help.command(
    examples={
        "Check two documents": (
            "pqsec validate robots/enclaves/governance.xml robots/enclaves/talker/permissions.p7s"
        ),
        "Check a domain file whenever it is saved": "pqsec validate domain.yaml",
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

    FILE is XML, a signed file with XML inside, or YAML; also domain.yaml and serve.yaml. The kind
    of document is detected. Signatures are not checked: use `pqsec verify`.
    """
    results = [_validated(file) for file in files]
    lines = []
    for result in results:
        if result["valid"]:
            lines.append(f"{result['file']}: valid {result['kind']} document")
        lines += [f"{problem['file']}: {problem['text']}" for problem in result["problems"]]
    _printing.emit({"files": results}, lines)
    if not all(result["valid"] for result in results):
        click.get_current_context().exit(1)


def _validated(file: Path) -> dict[str, Any]:
    try:
        kind = _kind(file)
    except InvalidDocumentError as error:
        return {"file": str(file), "valid": False, "kind": None, "problems": [*_told(error, file)]}
    except MalformedError as error:
        text = error.words_at(file)
        problem = {"file": str(file), "line": None, "element": None, "rule": text, "text": text}
        return {"file": str(file), "valid": False, "kind": None, "problems": [problem]}
    return {"file": str(file), "valid": True, "kind": kind, "problems": []}


def _kind(file: Path) -> str:
    """What is in the file, which is valid; with domain.yaml, the files that it names too."""
    if file.suffix in _SUFFIXES:
        data = read(file)
        if _DOMAIN.search(data):
            from pqsec_pki.domain import read_domain  # noqa: PLC0415 -- it loads all of a domain

            read_domain(file)
            return "domain"
        if _SERVE.search(data):
            from pqsec_pki.server import read_settings  # noqa: PLC0415 -- likewise

            read_settings(file)
            return "serve"
    return valid_kind(file, _settings.now()).value


def _told(error: InvalidDocumentError, file: Path) -> Iterator[dict[str, Any]]:
    for each in error.problems:
        yield {
            "file": error.where or str(file),
            "line": each.line,
            "element": each.element,
            "rule": each.message,
            "text": str(each),
        }
