"""What the commands that take policies share: files in, files out, grants for names."""

from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Protocol, TypeVar

import click

from pqsec_pki import _files
from pqsec_pki._assets import asset
from pqsec_pki.cli import _printing, _settings
from pqsec_pki.documents import DomainSet, Grant, lasting, permissions_from_yaml, sros2
from pqsec_pki.errors import UsageError, located
from pqsec_pki.keystore import ParticipantSpec
from pqsec_pki.smime import document_in, is_signed


def output_options(command: _settings.Command) -> _settings.Command:
    """Add -o and --force to a command that writes one document."""
    for option in (
        click.option("--force", is_flag=True, help="Replace the file if it is there."),
        click.option(
            "-o", "--output", type=_settings.FILE, help="Where to write. [default: print]"
        ),
    ):
        command = option(command)
    return command


def put(document: bytes, output: Path | None, *, force: bool) -> None:
    """Write the document to the file, or print it."""
    text = document.decode()
    if output is None:
        _printing.emit({"document": text}, [text.removesuffix("\n")], verbatim=True)
        return
    _files.write(output, document, force=force)
    value = {"written": str(output), "bytes": len(document)}
    _printing.emit(value, [f"{output}  ({len(document)} bytes)"])


class Document(Protocol):
    """Governance or permissions, as values."""

    def to_xml(self) -> bytes:
        """The document that stacks read."""


Value = TypeVar("Value", bound=Document)


def add_commands(
    group: click.Group,
    from_yaml: Callable[[bytes], Value],
    to_yaml: Callable[[Value], bytes],
    from_xml: Callable[[bytes], Value],
    *,
    warn: Callable[[Value], None] = lambda _: None,
) -> None:
    """Add to the group what both kinds of documents have: render, read and schema."""

    @group.command()
    @click.argument("file", type=_settings.FILE)
    @output_options
    @_settings.command_options
    def render(file: Path, output: Path | None, *, force: bool) -> None:
        """Make the XML that DDS stacks read, of FILE in YAML.

        Every mistake in FILE is told with its line; nothing is written then. The sign
        command of this kind signs the result.
        """
        data = _files.read(file)
        with located(file):
            value = from_yaml(data)
            document = value.to_xml()
        warn(value)
        put(document, output, force=force)

    @group.command()
    @click.argument("file", type=_settings.FILE)
    @output_options
    @_settings.command_options
    def read(file: Path, output: Path | None, *, force: bool) -> None:
        """Make YAML of a document, signed or not.

        Signatures are not looked at: that is `pqsec verify`.
        """
        data = _files.read(file)
        with located(file):
            document = to_yaml(from_xml(document_in(data) if is_signed(data) else data))
        put(document, output, force=force)

    @group.command()
    @output_options
    @_settings.command_options
    def schema(output: Path | None, *, force: bool) -> None:
        """Write the JSON Schema of the YAML, for editors."""
        text = asset("schemas", f"{group.name}.schema.json").read_bytes()
        put(text, output, force=force)


NAMELESS = "/"
"""Where SROS2 writes down nodes that were run without --enclave; no participant's name."""
_RUN_ANEW = (
    "run each process with its own `--ros-args --enclave /NAME`, and have SROS2 write it anew"
)


def names_in(policy: Path, *, now: datetime) -> tuple[str, ...]:
    """Everybody whom the policy has grants for; UsageError if nobody can be called so."""
    if policy.suffix == ".xml":
        found = [enclave.path for enclave in sros2.read_policy(policy)]
    else:
        found = [grant.name for grant in _yaml_grants(policy, now)]
    names = tuple(name for name in dict.fromkeys(found) if name != NAMELESS)
    if not names:
        raise UsageError(f"{policy} has grants for {NAMELESS} alone", hint=_RUN_ANEW)
    if len(names) < len(set(found)):
        _printing.note(f"{policy} also has grants for {NAMELESS}, which nobody gets: {_RUN_ANEW}")
    return names


def granted(specs: list[ParticipantSpec], policy: Path, *, now: datetime) -> list[ParticipantSpec]:
    """The wishes with their grants of the policy; UsageError for a name it does not have."""
    grants = _grants_in(policy, specs[0], now)  # all wishes have one validity
    return [_with_grants(spec, grants, policy) for spec in specs]


def _grants_in(policy: Path, spec: ParticipantSpec, now: datetime) -> tuple[Grant, ...]:
    """All grants; those of SROS2, which say neither, for the wish's domains and validity."""
    if policy.suffix == ".xml":
        not_before, not_after = lasting(now, spec.validity)
        enclaves = sros2.read_policy(policy)
        return sros2.permissions_of(
            enclaves, domains=spec.domains, not_before=not_before, not_after=not_after
        ).grants
    return _yaml_grants(policy, now)


def _yaml_grants(policy: Path, now: datetime) -> tuple[Grant, ...]:
    data = _files.read(policy)
    with located(policy):
        return permissions_from_yaml(data, now=now).grants


def _with_grants(spec: ParticipantSpec, grants: tuple[Grant, ...], policy: Path) -> ParticipantSpec:
    own = tuple(grant for grant in grants if grant.name == spec.name)
    if not own:
        there = list(dict.fromkeys(grant.name for grant in grants))
        hint = f"it has {', '.join(there)}"
        hint += f" alone: {_RUN_ANEW}" if there == [NAMELESS] else ""
        raise UsageError(f"{policy} has no grant for {spec.name}", hint=hint)
    domains = [part for grant in own for rule in grant.rules for part in rule.domains.parts]
    return replace(
        spec, grants=own, domains=DomainSet(parts=tuple(domains)) if domains else spec.domains
    )
