"""pqsec who-may: show which participants may publish and subscribe to each topic."""

from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path

import click

from pqsec_pki.access import (
    MAX_NAME,
    Interpretation,
    Placed,
    domains_said,
    interpretations_named,
)
from pqsec_pki.cli import _completion, _formats, _help, _pager, _printing, _ros_patterns, _settings
from pqsec_pki.cli._printing import printable
from pqsec_pki.cli._stack_version import StackVersion
from pqsec_pki.cli._who_may_forms import FORMS, flow_lines
from pqsec_pki.documents import DomainSet, ros
from pqsec_pki.errors import MissingError, UsageError
from pqsec_pki.keystore import nearest
from pqsec_pki.policy import (
    Fleet,
    Flow,
    WhoMay,
    fleet_in,
    fleet_of,
    flows,
    who_may_by_each,
)

_COLUMNS = ("topic", "domains", "pattern", "asked", "publish", "subscribe", "partitions")
_FLOW_COLUMNS = ("from", "to", "domains", "topics", "ros", "partitions")


@_help.command(
    "who-may",
    examples={
        "Show all topics of the keystore": "pqsec who-may",
        "Show who may use a ROS 2 topic": "pqsec who-may --ros-topic /chatter",
        "Show who may call a ROS 2 service, and who serves it": (
            "pqsec who-may --ros-service /reset"
        ),
        "Show what a group can send, and which participants receive it": (
            "pqsec who-may --matrix --participant '/fleet/*'"
        ),
        "Draw a graph": "pqsec who-may --format dot",
        "Write a table for a spreadsheet": "pqsec who-may --format csv",
    },
    exit_codes={
        0: "the table is printed",
        1: "a CA or document is not valid",
        3: "the keystore or a file cannot be read",
    },
)
@click.argument("paths", nargs=-1, type=_settings.PATH, metavar="[PATH]...")
@click.option(
    "--topic",
    "topics",
    multiple=True,
    help="Show only this DDS topic, or the topics that this pattern matches.",
    shell_complete=_completion.topics,
)
@click.option(
    "--ros-topic",
    "--ros-publish",
    "--ros-subscribe",
    "ros_topics",
    multiple=True,
    help="Show only this ROS 2 topic or pattern.",
    shell_complete=_completion.ros_topics,
)
@click.option(
    "--ros-service",
    "--ros-client",
    "ros_services",
    multiple=True,
    metavar="NAME",
    help="Show only this ROS 2 service: its requests and replies; or a pattern.",
)
@click.option(
    "--ros-action",
    "--ros-action-server",
    "--ros-action-client",
    "ros_actions",
    multiple=True,
    metavar="NAME",
    help="Show only the topics of this ROS 2 action, or of a pattern.",
)
@click.option(
    "--ros-node",
    "ros_nodes",
    multiple=True,
    metavar="NODE",
    help="Show only the topics that this ROS 2 node needs to start.",
)
@click.option(
    "--ros-parameters",
    "ros_parameters",
    multiple=True,
    metavar="NODE",
    help="Show only who may read and set the parameters of this ROS 2 node.",
)
@click.option(
    "--participant",
    "participants",
    multiple=True,
    metavar="NAME",
    help="Show only what this participant may use, or those of '/robot1/*' or @hall1.",
    shell_complete=_completion.participants,
)
@click.option(
    "--matrix",
    is_flag=True,
    help="Show what each participant can send: a row for each sender and its receivers.",
)
@click.option(
    "--domain", "domains", help="Show these DDS domains: 0, or 0-3, or 0,5.  [default: all]"
)
@click.option(
    "--partition",
    "partitions",
    multiple=True,
    help="Show who may use an endpoint in this partition; repeatable.  [default: the default"
    " partition, and others where somebody may do more]",
)
@click.option(
    "--governance", type=_settings.FILE, help="With PATHs: read this governance document."
)
@click.option(
    "--as",
    "stack",
    type=StackVersion(),
    default="spec",
    show_default=True,
    help="Answer as this stack interprets the documents, or this version of it.",
)
@_formats.option("dot", "md")
@_pager.option
@_settings.command_options
def who_may(  # noqa: PLR0913, PLR0917 -- one for each option, by name
    paths: tuple[Path, ...],
    topics: tuple[str, ...],
    ros_topics: tuple[str, ...],
    ros_services: tuple[str, ...],
    ros_actions: tuple[str, ...],
    ros_nodes: tuple[str, ...],
    ros_parameters: tuple[str, ...],
    participants: tuple[str, ...],
    domains: str | None,
    partitions: tuple[str, ...],
    governance: Path | None,
    stack: str,
    form: str,
    *,
    matrix: bool,
) -> None:
    """Show which participants may publish and subscribe to each topic.

    PATH is a keystore, a permissions document (.p7s, .xml, .yaml), or a folder with
    permissions documents; without it, the keystore of -k. Without --topic, all topics in
    the rules are shown. --matrix shows instead which participant can send what to which.
    """
    now = _settings.now()
    where = None if domains is None else DomainSet.parse(domains)
    versions = interpretations_named(stack)
    fleet = _fleet(paths, governance, now, versions)
    form = _formats.chosen(form)
    if matrix and form in {"dot", "md"}:
        raise UsageError("--matrix is printed as table, json or csv")
    chosen = _chosen(fleet, participants)
    named = _of_ros(ros_topics, ros_services, ros_actions, ros_nodes, ros_parameters)
    wanted = (*topics, *dict.fromkeys(named))
    if "" in wanted:
        raise UsageError("the topic is empty")
    found = who_may_by_each(
        fleet, wanted, domains=where, partitions=partitions, now=now, versions=versions
    )
    _note_doubts(found)
    if chosen:
        found = found.of(chosen)
    _note_differences(found)
    if matrix:
        _show_matrix(form, found, chosen)
        return
    _formats.emit(
        form,
        found.to_json() if form == _formats.JSON else {},
        FORMS[form](found.rows, len(fleet.members)),
        columns=_COLUMNS,
        items=map(_flat, found.rows_as_json(), found.rows),
    )


def _of_ros(
    topics: tuple[str, ...],
    services: tuple[str, ...],
    actions: tuple[str, ...],
    nodes: tuple[str, ...],
    configured: tuple[str, ...],
) -> Iterator[str]:
    """The DDS topics of these ROS 2 names; of `configured` those for parameters."""
    yield from map(_ros_patterns.topic, topics)
    for name in services:
        yield from _ros_patterns.both(_ros_patterns.service_server(name))
    for name in actions:
        yield from _ros_patterns.both(_ros_patterns.action_server(name))
    for name in nodes:
        yield from _ros_patterns.both(ros.node_minimum(name))
    for name in configured:
        yield from _parameters(name)


def _flat(value: dict[str, object], row: Placed | Flow) -> dict[str, object]:
    """The object of a row for CSV, with its partitions in words."""
    return value | {"partitions": row.row.where if isinstance(row, Placed) else row.where}


def _note_doubts(found: WhoMay) -> None:
    """Notes about participants without an answer, unknown topics, ungoverned domains and partitions
    that were not searched."""
    for each in (found, *found.others):
        for name, reason in each.unanswered.items():
            words = f"no answer by {each.interpretation.title} for {printable(name)}"
            _printing.note(f"{words}: {printable(reason)}")
    for name, reason in found.crashes.items():
        _printing.note(f"{printable(name)}: {printable(reason)}")
    rows = (row for each in (found, *found.others) for row in each.rows)
    used = {each.row.topic for each in rows if each.is_used}.union(found.too_long)
    for topic, instead in found.unknown.items():
        nobody = "" if topic in used else ", so nobody may use it"
        is_ros = not instead and ros.is_ros_name(topic)
        fix = f"ROS 2 nodes use {ros.topic(topic)}: --ros-topic {topic}" if is_ros else instead
        more = f"; {fix}" if fix else ""
        _printing.note(f"no rule names {printable(topic)}{nobody}{more}")
    if found.too_long:
        names = _printing.few([f"{each[:20]}..." for each in found.too_long])
        _printing.note(f"RTPS allows a topic {MAX_NAME} characters: no answer for {names}")
    if not found.complete:
        _printing.note(
            "the partitions of the rules are too many patterns to search: a right that is only in"
            " some partitions may be missing; ask with --partition"
        )
    if found.ungoverned:
        words = domains_said(found.ungoverned)
        _printing.note(f"the governance does not name {words}: no participant can join it")


def _note_differences(found: WhoMay) -> None:
    """A note for each version of the stack that decides differently."""
    for other in found.others:
        if topics := found.differing(other):
            title, name = other.interpretation.title, other.interpretation.name
            words = _printing.few(list(map(printable, topics)))
            _printing.note(f"{title} decides differently about {words}: ask with --as {name}")


def _fleet(
    paths: tuple[Path, ...],
    governance: Path | None,
    now: datetime,
    versions: Sequence[Interpretation],
) -> Fleet:
    """The participants, with a note for each assumption and for each that is left out."""
    if governance and not paths:
        raise UsageError("--governance is for files: a keystore has its own governance")
    try:
        fleet = (
            fleet_of(paths, governance, now, *versions)
            if paths
            else fleet_in(_settings.open_keystore(), now, *versions)
        )
    except MissingError as error:
        error.hint = error.hint or (
            "a topic is named with --topic or --ros-topic, a participant with --participant"
        )
        raise
    for text in fleet.notes:
        _printing.note(text)
    for name, reason in fleet.refused.items():
        _printing.note(f"{printable(name)} is left out: {printable(reason)}")
    return fleet


def _parameters(node: str) -> tuple[str, ...]:
    client = ros.parameter_client(node)
    return tuple(each for pair in zip(*client, strict=True) for each in pair)


def _chosen(fleet: Fleet, names: tuple[str, ...]) -> list[str]:
    """The participants that the names mean. UsageError for one that has no documents here."""
    known = [member.name for member in fleet.members]
    found = fleet.named(names)
    for name in found:
        if name not in known:
            raise UsageError(
                f"there is no participant {printable(name)} here",
                hint=nearest(name, known) or "`pqsec status` lists the participants",
            )
    return found


def _show_matrix(form: str, found: WhoMay, chosen: list[str]) -> None:
    """Print what each participant can send and to which, for the chosen ones if there are any."""
    wanted = set(chosen)
    shown = [
        each
        for each in flows(found.rows)
        if not wanted or each.sender in wanted or not wanted.isdisjoint(each.receivers)
    ]
    value = {key: kept for key, kept in found.to_json().items() if key != "topics"}
    _formats.emit(
        form,
        {**value, "flows": shown},
        flow_lines(shown),
        columns=_FLOW_COLUMNS,
        items=(_flat(each.to_json(), each) for each in shown),
    )
