"""pqsec validate: check documents against their schemas, and what people write in YAML."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pqsec_pki._files import read
from pqsec_pki.cli import _help, _printing, _settings, _targets
from pqsec_pki.errors import InvalidDocumentError, MalformedError
from pqsec_pki.policy import valid_kind
from pqsec_pki.stacks import Stack

if TYPE_CHECKING:
    from pqsec_pki.lint import Finding

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
        "Check whether two stacks take a document of another program": (
            "pqsec validate --target connext,cyclonedds robots/enclaves/governance.p7s"
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
@_targets.option("Check instead whether these stacks take the documents, as far as is known")
@_settings.command_options
def validate(files: tuple[Path, ...], targets: tuple[Stack, ...]) -> None:
    """Check governance and permissions documents against their schemas.

    FILE is XML, a signed file with XML inside, or YAML; also domain.yaml and serve.yaml. The kind
    of document is detected. Signatures are not checked: use `pqsec verify`.
    """
    results = [_validated(file, targets) for file in files]
    lines = []
    for result in results:
        if result["valid"]:
            lines.append(f"{result['file']}: valid {result['kind']} document")
        lines += [f"{problem['file']}: {problem['text']}" for problem in result["problems"]]
    _printing.emit({"files": results}, lines)
    if not all(result["valid"] for result in results):
        click.get_current_context().exit(1)


def _validated(file: Path, targets: tuple[Stack, ...]) -> dict[str, Any]:
    try:
        kind = _kind(file)
        if not targets or file.suffix in _SUFFIXES:
            return {"file": str(file), "valid": True, "kind": kind, "problems": []}
        return _judged(file, targets, [])
    except InvalidDocumentError as error:
        told = [*_told(error, file)]
        if file.suffix not in _SUFFIXES:
            if targets:
                return _judged(file, targets, told)
            _note_takers(file)
        return {"file": str(file), "valid": False, "kind": None, "problems": told}
    except MalformedError as error:
        text = error.words_at(file)
        problem = {"file": str(file), "line": None, "element": None, "rule": text, "text": text}
        return {"file": str(file), "valid": False, "kind": None, "problems": [problem]}


def _judged(
    file: Path, targets: tuple[Stack, ...], by_schema: list[dict[str, Any]]
) -> dict[str, Any]:
    """What these stacks are known to take; what the schema says of a file that is neither kind."""
    from pqsec_pki.lint import Severity, check  # noqa: PLC0415 -- it loads all rules

    report = check([file], now=_settings.now(), targets=targets)
    kind = next((each.kind for each in report.inventory.documents), None)
    problems = [
        _of_finding(each, file)
        for each in report.findings
        if each.severity is Severity.ERROR and each.rule.family == "documents"
    ] or ([] if kind else by_schema)
    return {"file": str(file), "valid": not problems, "kind": kind, "problems": problems}


def _note_takers(file: Path) -> None:
    """A note for each stack that is known to take the document, although it is not valid."""
    from pqsec_pki.lint import take_inventory  # noqa: PLC0415 -- likewise

    for document in take_inventory([file], now=_settings.now()).documents:
        for stack in document.taken_by:
            command = f"pqsec validate --target {stack} {shlex.quote(str(file))}"
            _printing.note(f"{stack.product} takes more than the schema allows: `{command}`")


def _of_finding(finding: "Finding", file: Path) -> dict[str, Any]:
    place = f"line {finding.line}: " if finding.line else ""
    text = f"{place}{finding.message} ({finding.rule.id}{finding.stacks_in_brackets})"
    found = {"line": finding.line, "element": None, "rule": finding.message}
    return {"file": str(file), **found, "text": text}


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
    kind, problems = valid_kind(file, _settings.now())
    for each in problems:
        _printing.note(f"{file}: it cannot be signed: {each}")
    return kind.value


def _told(error: InvalidDocumentError, file: Path) -> Iterator[dict[str, Any]]:
    for each in error.problems:
        yield {
            "file": error.where or str(file),
            "line": each.line,
            "element": each.element,
            "rule": each.message,
            "text": str(each),
        }
