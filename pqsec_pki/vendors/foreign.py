"""Stacks of other installed packages: the entry points `pqsec.exporters`.

An entry point has the name of its stack, and is an `Exporter` with a `writer`. pqsec looks for it
only if none of its own stacks has that name.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache, partial
from pathlib import Path, PurePosixPath
from typing import Any

from pqsec_pki._packages import fault, foreign_errors, offered, package_of, the_only
from pqsec_pki.errors import PqsecError, UsageError
from pqsec_pki.stacks import OtherStack, Stack
from pqsec_pki.vendors.enclave import StackEnclave
from pqsec_pki.vendors.exporters import Exporter, Writer
from pqsec_pki.vendors.exports import Export, Options

GROUP = "pqsec.exporters"


def foreign_stacks() -> list[str]:
    """The names of their stacks; nothing is loaded."""
    return [each.name for each in offered(GROUP)]


@cache
def exporter_of(name: str) -> Exporter:
    """The row of that name, in small letters; UsageError if no package has one."""
    entries = offered(GROUP, name)
    if not entries:
        raise UsageError(
            f"no stack named {name!r}", hint=f"known: {', '.join([*Stack, *foreign_stacks()])}"
        )
    entry = the_only(entries, "stack")
    package = package_of(entry)
    words = f"the package {package} cannot add the stack {name!r}"
    with foreign_errors(words):
        row: Any = entry.load()
        wrong = next(_faults_of_row(row, name), None)
    if wrong:
        raise fault(words, wrong)
    added: Exporter = replace(row, writer=partial(_guarded, package, row.writer))
    return added


def _faults_of_row(row: Any, name: str) -> Iterator[str]:
    """What is wrong with it; after the first, others may fail."""
    if not isinstance(row, Exporter):
        yield f"a {type(row).__name__} is not an Exporter"
    if not isinstance(row.stack, OtherStack) or row.stack != name:
        yield f"its stack is not OtherStack({name!r}, ...)"
    if not callable(row.writer):
        yield "it has no writer"


def _guarded(package: str, write: Writer, enclave: StackEnclave, options: Options) -> Export:
    """What it writes, with a warning; an export that has the passphrase is private."""
    words = f"the exporter of the package {package} failed"
    with foreign_errors(words, PqsecError):
        made: Any = write(enclave, options)
        wrong = next(_faults_of_export(made), None)
    if wrong:
        raise fault(words, wrong)
    warning = f"written by code of the package {package}, not of pqsec, which did not run it"
    private = made.is_private or options.password is not None
    checked: Export = replace(made, warnings=(*made.warnings, warning), is_private=private)
    return checked


def _faults_of_export(made: Any) -> Iterator[str]:
    """What is wrong with it; raises too, if its fields are of other types."""
    if not isinstance(made, Export):
        yield f"a {type(made).__name__} is not an Export"
    if not isinstance(next(iter(made.files.values()), None), str):
        yield "its first file is not a text"
    for name, source in made.files.items():
        path = PurePosixPath(name)
        if ".." in path.parts or path.is_absolute() or not path.name:
            yield f"the file {name!r} is not below its folder"
        if not isinstance(source, Path):
            source.encode()
    for text in (*made.steps, *made.notes, *made.warnings, *sum(made.environment.items(), ())):
        text.encode()
