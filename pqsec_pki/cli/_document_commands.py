"""The commands that governance and permissions documents both have: render and read."""

from collections.abc import Callable
from pathlib import Path
from typing import Generic, Protocol, TypeVar

import click

from pqsec_pki import _files
from pqsec_pki._dataclass import dataclass
from pqsec_pki.cli import _help, _settings
from pqsec_pki.cli._policy import output_options, put
from pqsec_pki.errors import located
from pqsec_pki.smime import document_in, is_signed


class PolicyValue(Protocol):
    """A governance or permissions value."""

    def to_xml(self) -> bytes:
        """The XML document that stacks read."""


Value = TypeVar("Value", bound=PolicyValue)


@dataclass(frozen=True, kw_only=True)
class DocumentCommands(Generic[Value]):
    """The commands of one kind of document."""

    from_yaml: Callable[[bytes], Value]
    to_yaml: Callable[[Value], bytes]
    from_xml: Callable[[bytes], Value]
    warn: Callable[[Value], None] = lambda _: None

    def add_to(self, group: click.Group) -> None:
        """Add render and read to the group with the document's name."""
        name = str(group.name)
        for command in (self._render(name), self._read(name)):
            group.add_command(command)

    def _render(self, name: str) -> click.Command:
        @_help.command(
            examples={"Write the XML": f"pqsec {name} render {name}.yaml -o {name}.xml"},
            exit_codes={
                0: "the XML is written",
                1: "FILE is not valid",
                3: "a file cannot be read or written",
            },
        )
        @click.argument("file", type=_settings.FILE)
        @output_options
        @_settings.command_options
        def render(file: Path, output: Path | None, *, force: bool) -> None:
            """Convert YAML to the XML that DDS stacks read.

            Every mistake in FILE is reported with its line, and nothing is written then. Sign the
            result with `pqsec sign-governance` or `pqsec sign-permissions`.
            """
            data = _files.read(file)
            with located(file):
                value = self.from_yaml(data)
                document = value.to_xml()
            self.warn(value)
            put(document, output, force=force)

        return render

    def _read(self, name: str) -> click.Command:
        @_help.command(
            examples={"Read a signed document": f"pqsec {name} read {name}.p7s"},
            exit_codes={
                0: "the YAML is written",
                1: "the document is not valid",
                3: "a file cannot be read or written",
            },
        )
        @click.argument("file", type=_settings.FILE)
        @output_options
        @_settings.command_options
        def read(file: Path, output: Path | None, *, force: bool) -> None:
            """Convert a document, signed or not, to YAML.

            Signatures are not checked: use `pqsec verify`.
            """
            data = _files.read(file)
            with located(file):
                plain = document_in(data) if is_signed(data) else data
                document = self.to_yaml(self.from_xml(plain))
            put(document, output, force=force)

        return read
