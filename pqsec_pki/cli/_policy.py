"""Shared by commands with policies: read and write documents, find grants by name."""

from collections.abc import Container, Iterable
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import click

from pqsec_pki import _files, documents
from pqsec_pki._places import refuse_obeyed
from pqsec_pki.cli import _printing, _settings
from pqsec_pki.documents import DomainSet, Grant, lasting, ros
from pqsec_pki.errors import UsageError, located
from pqsec_pki.lifecycle import ParticipantSpec

SIGNED = "what the CAs sign"


def output_options(command: _settings.Command) -> _settings.Command:
    """Add -o and --force to a command that writes one document."""
    for option in (
        click.option("--force", is_flag=True, help="Replace an existing file."),
        click.option(
            "-o", "--output", type=_settings.FILE, help="Write to this file. [default: print]"
        ),
    ):
        command = option(command)
    return command


validity_option = click.option(
    "--validity",
    type=_settings.Duration(),
    default="1y",
    show_default=True,
    help="Grant the rights for this long: 1y, 26w, 90d or 12h.",
)


def put(document: bytes, output: Path | None, *, force: bool) -> None:
    """Write the document to the file, or print it."""
    text = document.decode()
    if output is None:
        _printing.emit({"document": text}, [text.removesuffix("\n")], verbatim=True)
        return
    _files.write(output, document, force=force)
    value = {"written": output, "bytes": len(document)}
    _printing.emit(value, [f"{output}  ({len(document)} bytes)"])


def duration_text(duration: timedelta) -> str:
    """The duration in YAML, such as 90d or 12h."""
    hours = int(duration / timedelta(hours=1))
    return f"{hours}h" if hours % 24 else f"{hours // 24}d"


UNNAMED = "/"
"""The enclave that SROS2 records for nodes without --enclave. Not a participant's name."""
_ENCLAVE_HINT = (
    "run each process with its own `--ros-args --enclave /NAME`, and generate the policy again"
)


def names_in(policy: Path, *, now: datetime) -> tuple[str, ...]:
    """The names that the policy has grants for. UsageError if there is none but `/`."""
    refuse_obeyed([policy], SIGNED)
    if policy.suffix == ".xml":
        found = [enclave.path for enclave in documents.sros2.read_policy(policy)]
    else:
        found = [grant.name for grant in _yaml_grants(policy, now)]
    names = tuple(name for name in dict.fromkeys(found) if name != UNNAMED)
    if not names:
        raise UsageError(f"{policy} has grants for {UNNAMED} only", hint=_ENCLAVE_HINT)
    if len(names) < len(set(found)):
        _printing.note(
            f"{policy} also has grants for {UNNAMED}, which are not used: {_ENCLAVE_HINT}"
        )
    return names


def with_grants(
    specs: list[ParticipantSpec], policy: Path, *, now: datetime
) -> list[ParticipantSpec]:
    """The specs with their grants. UsageError for a name without a grant in the policy."""
    grants = grants_in(policy, specs[0], now)  # all specs have the same validity
    if policy.suffix == ".xml":
        _note_completed(policy, {spec.name for spec in specs})
    found = [_with_grants(spec, grants, policy) for spec in specs]
    note_ros_names(grant for spec in found for grant in spec.grants)
    return found


def note_ros_names(grants: Iterable[Grant]) -> None:
    """Note in one line which DDS topics have the form of ROS 2 names: no ROS 2 node uses them."""
    rules = (rule for grant in grants for rule in grant.rules)
    criteria = (each for rule in rules for each in (*rule.publish, *rule.subscribe))
    topics = (topic for each in criteria for topic in each.topics)
    if found := list(dict.fromkeys(filter(ros.is_ros_name, topics))):
        _printing.note(
            f"DDS topics here: {_printing.few(found)}; ROS 2 nodes use {ros.topic(found[0])}: write"
            " that, or the ROS 2 name below `nodes`"
        )


def grants_in(policy: Path, spec: ParticipantSpec, now: datetime) -> tuple[Grant, ...]:
    """All grants; an SROS2 policy's are completed by what ROS 2 nodes need to start.

    SROS2 policies have no domains or validity: those of `spec` are used. FileError if another user
    could change the policy.
    """
    refuse_obeyed([policy], SIGNED)
    if policy.suffix == ".xml":
        not_before, not_after = lasting(now, spec.validity)
        enclaves = documents.sros2.read_policy(policy)
        return documents.sros2.permissions_of(
            enclaves,
            domains=spec.domains,
            not_before=not_before,
            not_after=not_after,
            node_minimum=True,
        ).grants
    return _yaml_grants(policy, now)


def _note_completed(policy: Path, names: Container[str]) -> None:
    """Note, in one line, which topics are allowed that the policy does not allow."""
    lacking = {
        each.path: documents.sros2.lacking(each)
        for each in documents.sros2.read_policy(policy)
        if each.path in names
    }
    if short := [name for name, topics in lacking.items() if topics]:
        first = lacking[short[0]]
        more = f" and {len(first) - 1} more" if len(first) > 1 else ""
        others = f", and {_printing.counted(len(short) - 1, 'other')}" if len(short) > 1 else ""
        _printing.note(
            f"{short[0]}{others}: also allowed what ROS 2 nodes need to start and {policy} does not"
            f" allow: {first[0]}{more}"
        )


def _yaml_grants(policy: Path, now: datetime) -> tuple[Grant, ...]:
    data = _files.read(policy)
    with located(policy):
        return documents.permissions_from_yaml(data, now=now).grants


def _with_grants(spec: ParticipantSpec, grants: tuple[Grant, ...], policy: Path) -> ParticipantSpec:
    own = tuple(grant for grant in grants if grant.name == spec.name)
    if not own:
        there = list(dict.fromkeys(grant.name for grant in grants))
        hint = f"it has {', '.join(there)}"
        hint += f" only: {_ENCLAVE_HINT}" if there == [UNNAMED] else ""
        raise UsageError(f"{policy} has no grant for {spec.name}", hint=hint)
    domains = [part for grant in own for rule in grant.rules for part in rule.domains.parts]
    return replace(
        spec, grants=own, domains=DomainSet(parts=tuple(domains)) if domains else spec.domains
    )
