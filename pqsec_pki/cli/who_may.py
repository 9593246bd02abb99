"""pqsec who-may: show which participants may publish and subscribe to each topic."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import click

from pqsec_pki.access import (
    INTERPRETATIONS,
    Interpretation,
    Placed,
    TopicRow,
    domains_said,
    interpretation_named,
)
from pqsec_pki.cli import _completion, _help, _printing, _settings
from pqsec_pki.cli._printing import printable
from pqsec_pki.documents import DomainSet, ros
from pqsec_pki.errors import UsageError, meant
from pqsec_pki.policy import (
    Fleet,
    WhoMay,
    fleet_in,
    fleet_of,
    flows,
    rows_of,
    who_may_use,
)

_MOST = 6
"""The most names in a cell of the text table."""
_PATTERN = re.compile(r"[*?\[]")
_MARKDOWN = re.compile(r"([\\`*_\[\]<>|~&$#!])")


@_help.command(
    "who-may",
    examples={
        "Show all topics of the keystore": "pqsec who-may",
        "Show who may use a ROS 2 topic": "pqsec who-may --ros-topic /chatter",
        "Show who may call a ROS 2 service, and who serves it": (
            "pqsec who-may --ros-service /reset"
        ),
        "Show what a group can send to whom": ("pqsec who-may --matrix --participant '/fleet/*'"),
        "Draw a graph": "pqsec who-may --format dot",
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
    "ros_topics",
    multiple=True,
    help="Show only this ROS 2 topic or pattern.",
    shell_complete=_completion.ros_topics,
)
@click.option(
    "--ros-service",
    "ros_services",
    multiple=True,
    metavar="NAME",
    help="Show only this ROS 2 service: its requests and replies; or a pattern.",
)
@click.option(
    "--ros-action",
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
    help="Show only the parameters of this ROS 2 node: who may read and set them.",
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
    help="Show who can send what to whom: a row for each sender and its receivers.",
)
@click.option(
    "--domain", "domains", help="Show these DDS domains: 0, or 0-3, or 0,5.  [default: all]"
)
@click.option(
    "--governance", type=_settings.FILE, help="With PATHs: read this governance document."
)
@click.option(
    "--as",
    "stack",
    type=click.Choice([each.name for each in INTERPRETATIONS]),
    default="spec",
    show_default=True,
    help="Answer as this stack interprets the documents.",
)
@click.option(
    "--format",
    "form",
    type=click.Choice(["table", "json", "dot", "md"]),
    default="table",
    show_default=True,
    help="Print in this format.",
)
@_settings.command_options
def who_may(  # noqa: PLR0913, PLR0917 -- one for each option, by name
    paths: tuple[Path, ...],
    topics: tuple[str, ...],
    ros_topics: tuple[str, ...],
    ros_services: tuple[str, ...],
    ros_actions: tuple[str, ...],
    ros_nodes: tuple[str, ...],
    participants: tuple[str, ...],
    domains: str | None,
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
    interpretation = interpretation_named(stack)
    fleet = _fleet(paths, governance, now, interpretation)
    for text in fleet.notes:
        _printing.note(text)
    for name, reason in fleet.refused.items():
        _printing.note(f"{printable(name)} is left out: {printable(reason)}")
    if matrix and form not in {"table", "json"}:
        raise UsageError("--matrix is printed as table or json")
    chosen = _chosen(fleet, participants)
    wanted = (
        *topics,
        *map(_ros_topic, ros_topics),
        *(each for name in ros_services for each in _ros_service(name)),
        *(each for name in ros_actions for each in _ros_action(name)),
        *(each for name in ros_nodes for each in _ros_parameters(name)),
    )
    if "" in wanted:
        raise UsageError("the topic is empty")
    found = who_may_use(fleet, wanted, domains=where, now=now, interpretation=interpretation)
    for topic, instead in found.unknown.items():
        _printing.note(f"no rule names {printable(topic)}{'; ' if instead else ''}{instead}")
    if found.ungoverned:
        _printing.note(
            f"the governance does not name {domains_said(found.ungoverned)}: no participant can"
            " join it"
        )
    form = "json" if _settings.settings().json else form
    _settings.settings().json = form == "json"
    if chosen:
        found = replace(found, rows=rows_of(found.rows, chosen))
    if matrix:
        _show_matrix(found, chosen)
    else:
        _printing.emit(found.to_json(), _FORMS[form](found.rows, len(fleet.members)))


def _fleet(
    paths: tuple[Path, ...], governance: Path | None, now: datetime, interpretation: Interpretation
) -> Fleet:
    if paths:
        return fleet_of(paths, governance, now, interpretation)
    if governance:
        raise UsageError("--governance is for files: a keystore has its own governance")
    return fleet_in(_settings.open_keystore(), now, interpretation)


def _ros_topic(name: str) -> str:
    """The DDS topic of a ROS 2 name, or the DDS pattern of a ROS 2 pattern."""
    if name.startswith("/") and _PATTERN.search(name):
        return f"rt{name}"
    return ros.topic(name)


def _ros_service(name: str) -> tuple[str, ...]:
    """The topics of a service, or the DDS patterns of a ROS 2 pattern."""
    if name.startswith("/") and _PATTERN.search(name):
        return f"rq{name}Request", f"rr{name}Reply"
    return ros.service_topics(name)


def _ros_action(name: str) -> tuple[str, ...]:
    if name.startswith("/") and _PATTERN.search(name):
        return tuple(f"r{kind}{name}/_action/*" for kind in "qrt")
    return ros.action_topics(name)


def _ros_parameters(node: str) -> tuple[str, ...]:
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
                hint=meant(name, known) or "`pqsec status` lists the participants",
            )
    return found


# Printing


def _show_matrix(found: WhoMay, chosen: list[str]) -> None:
    """Print who can send what to whom, to or from the chosen ones if there are any."""
    wanted = set(chosen)
    shown = [
        each
        for each in flows(found.rows)
        if not wanted or each.sender in wanted or not wanted.isdisjoint(each.receivers)
    ]
    headers = ("from", "to", "domain", "what")
    cells = (
        (printable(each.sender), _names(each.receivers), str(each.domains), _topics(each.topics))
        for each in shown
    )
    value = {key: kept for key, kept in found.to_json().items() if key != "topics"}
    _printing.emit({**value, "flows": shown}, _printing.table(headers, cells))


def _topics(topics: tuple[str, ...]) -> str:
    """In the words of ROS 2, where they have any."""
    return _names(tuple(map(ros.said, topics)))


def _names(names: tuple[str, ...]) -> str:
    more = f" and {len(names) - _MOST} more" if len(names) > _MOST else ""
    return ", ".join(map(printable, names[:_MOST])) + more


def _table(rows: Sequence[Placed], count: int) -> Iterator[str]:
    def cell(names: tuple[str, ...]) -> str:
        if len(names) == count > _MOST:
            return f"all {count}"
        return _names(names) or "-"

    headers = ("topic", "domain", "may publish", "may subscribe")
    cells = (
        (_topic(each.row), str(each.domains), cell(each.row.publishers), cell(each.row.subscribers))
        for each in rows
    )
    yield from _printing.table(headers, cells)


def _topic(row: TopicRow) -> str:
    if not row.is_pattern:
        return printable(row.topic)
    sample = f"as for {printable(row.asked)}" if row.asked else "no topic that it matches was found"
    return f"{printable(row.topic)} (pattern, {sample})"


def _markdown(rows: Sequence[Placed], _count: int) -> Iterator[str]:
    def cell(text: str) -> str:
        return _MARKDOWN.sub(r"\\\1", text)

    yield "| Topic | Domain | May publish | May subscribe |"
    yield "|---|---|---|---|"
    for each in rows:
        who = (
            ", ".join(map(printable, them)) for them in (each.row.publishers, each.row.subscribers)
        )
        yield f"| {' | '.join(map(cell, (_topic(each.row), str(each.domains), *who)))} |"


def _dot(rows: Sequence[Placed], _count: int) -> Iterator[str]:
    """A graph from publishers to topics to subscribers. Names are only in labels."""
    used = (name for each in rows for name in (*each.row.publishers, *each.row.subscribers))
    nodes = {name: f"p{number}" for number, name in enumerate(dict.fromkeys(used))}
    yield "digraph who_may {"
    yield "  rankdir=LR;"
    for name, node in nodes.items():
        yield f"  {node} [label={_label(printable(name))}];"
    for number, each in enumerate(rows):
        label = _label(f"{_topic(each.row)} (domain {each.domains})")
        yield f"  t{number} [shape=box, label={label}];"
        yield from (f"  {nodes[name]} -> t{number};" for name in each.row.publishers)
        yield from (f"  t{number} -> {nodes[name]};" for name in each.row.subscribers)
    yield "}"


def _label(text: str) -> str:
    """A quoted string of the dot language; escapes `\\`, `&` and quotes."""
    for special, escaped in (("&", "&amp;"), ("\\", "\\\\"), ('"', '\\"')):
        text = text.replace(special, escaped)
    return f'"{text}"'


_FORMS: dict[str, Callable[[Sequence[Placed], int], Iterator[str]]] = {
    "table": _table,
    "json": lambda _rows, _count: iter(()),
    "dot": _dot,
    "md": _markdown,
}
