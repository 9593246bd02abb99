"""pqsec permissions: write, convert and learn permissions in YAML, import SROS2 policies."""

from datetime import timedelta
from pathlib import Path

import click

from pqsec_pki.cli import _help, _permissions_learn, _policy, _printing, _settings
from pqsec_pki.cli._document_commands import DocumentCommands
from pqsec_pki.documents import (
    DomainSet,
    Permissions,
    lasting,
    new_permissions,
    permissions_from_yaml,
    permissions_to_yaml,
    ros,
    sros2,
)
from pqsec_pki.errors import UsageError, meant

_domains_option = click.option(
    "--domain",
    "domains",
    default="0",
    show_default=True,
    help="Allow these DDS domains: 0, or 0-3, or 0,5.",
)


@_help.group()
@_settings.command_options
def permissions() -> None:
    """Write and convert permissions documents in YAML, and import SROS2 policies."""


@permissions.command(
    examples={
        "Write permissions for a ROS 2 node": "pqsec permissions new /camera -o camera.yaml",
        "Write permissions for a DDS program on two domains": (
            "pqsec permissions new /sensor --dds --domain 0,5 -o sensor.yaml"
        ),
    },
    exit_codes={
        0: "the document is written",
        3: "the file exists, or cannot be written",
    },
)
@click.argument("names", nargs=-1, required=True, metavar="NAME...")
@_domains_option
@_policy.validity_option
@click.option(
    "--dds", is_flag=True, help="Write DDS topics only, for participants that are not ROS 2 nodes."
)
@_policy.output_options
@_settings.command_options
def new(  # noqa: PLR0913 -- one for each option, by name
    names: tuple[str, ...],
    domains: str,
    validity: timedelta,
    output: Path | None,
    *,
    dds: bool,
    force: bool,
) -> None:
    """Write commented permissions in YAML, to edit.

    NAME is a participant's enclave path, such as /talker, and also the name of its ROS 2
    node. The node gets the topics that it needs to start. Add the topics, services and
    actions that it may use.
    """
    if not dds:
        _require_nodes(names)
    duration = _policy.duration_text(validity)
    document = new_permissions(list(names), DomainSet.parse(domains), duration, nodes=not dds)
    _policy.put(document, output, force=force)


@permissions.command(
    "import",
    examples={
        "Convert a policy, and add what Jazzy nodes need": (
            "pqsec permissions import robot.policy.xml --complete -o robot.yaml"
        ),
    },
    exit_codes={
        0: "the document is written",
        1: "POLICY is not valid",
        3: "POLICY cannot be read, or the file cannot be written",
    },
)
@click.argument("policy", type=_settings.FILE)
@click.option(
    "--enclave", "wanted", multiple=True, metavar="PATH", help="Import only this enclave."
)
@_domains_option
@_policy.validity_option
@click.option(
    "--complete", is_flag=True, help="Add the topics that ROS 2 Jazzy nodes need to start."
)
@click.option(
    "--root",
    type=_settings.FOLDER,
    help="Allow includes from this folder. [default: the folder of POLICY]",
)
@_policy.output_options
@_settings.command_options
def import_(  # noqa: PLR0913, PLR0917 -- one for each option, by name
    policy: Path,
    wanted: tuple[str, ...],
    domains: str,
    validity: timedelta,
    root: Path | None,
    output: Path | None,
    *,
    complete: bool,
    force: bool,
) -> None:
    """Convert an SROS2 policy to YAML.

    POLICY is a file such as robot.policy.xml. The permissions are the same that SROS2
    generates. Includes are read from the folder of POLICY only.
    """
    enclaves = _wanted(sros2.read_policy(policy, root=root), wanted)
    not_before, not_after = lasting(_settings.now(), validity)
    value = sros2.permissions_of(
        enclaves,
        domains=DomainSet.parse(domains),
        not_before=not_before,
        not_after=not_after,
        node_minimum=complete,
    )
    if not complete:
        _warn(enclaves)
    _policy.put(permissions_to_yaml(value), output, force=force)


def _require_nodes(names: tuple[str, ...]) -> None:
    try:
        for name in names:
            ros.node_minimum(name)
    except UsageError as error:
        hint = f"{error.hint}; or use --dds if it is not a ROS 2 node"
        raise UsageError(str(error), hint=hint) from None


def _wanted(
    enclaves: tuple[sros2.PolicyProfiles, ...], names: tuple[str, ...]
) -> tuple[sros2.PolicyProfiles, ...]:
    there = [enclave.path for enclave in enclaves]
    if missing := [name for name in names if name not in there]:
        raise UsageError(
            f"the policy has no enclave {missing[0]}",
            hint=meant(missing[0], there) or f"it has {', '.join(there)}",
        )
    return tuple(enclave for enclave in enclaves if not names or enclave.path in names)


def _warn(enclaves: tuple[sros2.PolicyProfiles, ...]) -> None:
    for enclave in enclaves:
        if topics := sros2.lacking(enclave):
            others = f" and {len(topics) - 1} more topic(s)" if len(topics) > 1 else ""
            _printing.note(
                f"{enclave.path} lacks {topics[0]}{others}, which a Jazzy node needs to start:"
                " --complete adds them"
            )


permissions.add_command(_permissions_learn.learn)
DocumentCommands(
    from_yaml=lambda data: permissions_from_yaml(data, now=_settings.now()),
    to_yaml=permissions_to_yaml,
    from_xml=Permissions.from_xml,
).add_to(permissions)
