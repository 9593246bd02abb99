"""pqsec who-may: who may publish and subscribe to what?"""

import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import click

from pqsec_pki.access import READINGS, reading_named
from pqsec_pki.access.matrix import Row, topics_named
from pqsec_pki.access.matrix import who_may as ask
from pqsec_pki.cli import _printing, _settings
from pqsec_pki.cli._documents import plain
from pqsec_pki.cli._fleet import Fleet, fleet_of
from pqsec_pki.documents import ros
from pqsec_pki.errors import UsageError

_PATH = type(_settings.FILE)(path_type=Path, readable=False)
_MOST = 6
"""Names in a cell of the table for a terminal."""
_MARKDOWN = re.compile(r"([\\`*_\[\]<>|~&$#!])")


@click.command("who-may")
@click.argument("paths", nargs=-1, type=_PATH, metavar="[PATH]...")
@click.option("--topic", "topics", multiple=True, help="Only this DDS topic, or pattern.")
@click.option("--ros-topic", "ros_topics", multiple=True, help="Only this ROS 2 topic: /chatter.")
@click.option(
    "--domain", type=click.IntRange(0), default=0, show_default=True, help="On this DDS domain."
)
@click.option("--governance", type=_settings.FILE, help="With PATHs: the governance document.")
@click.option(
    "--as",
    "stack",
    type=click.Choice([each.name for each in READINGS]),
    default="spec",
    show_default=True,
    help="As this stack reads the documents.",
)
@click.option(
    "--format",
    "form",
    type=click.Choice(["table", "json", "dot", "md"]),
    default="table",
    show_default=True,
)
@_settings.command_options
def who_may(  # noqa: PLR0913, PLR0917 -- one for each option, by name
    paths: tuple[Path, ...],
    topics: tuple[str, ...],
    ros_topics: tuple[str, ...],
    domain: int,
    governance: Path | None,
    stack: str,
    form: str,
) -> None:
    """Tell who may publish and subscribe to what.

    Of the keystore, or of PATHs: a keystore, permissions documents (.p7s, .xml, .yaml), or
    folders of them. Without --topic, of all topics that rules name.
    """
    now = _settings.now()
    fleet = fleet_of(paths, governance, now)
    for name, reason in fleet.refused.items():
        _printing.note(f"{plain(name)} is left out: {plain(reason)}")
    if fleet.governance.rule_for(domain) is None:
        _printing.note(f"the governance does not name domain {domain}: nobody can join there")
    wanted = (*topics, *map(ros.topic, ros_topics)) or topics_named(fleet.members)
    if "" in wanted:
        raise UsageError("a topic has a name")
    rows = ask(
        fleet.governance,
        fleet.members,
        wanted,
        domain=domain,
        now=now,
        reading=reading_named(stack),
    )
    form = "json" if _settings.settings().json else form
    _settings.settings().json = form == "json"
    _printing.emit(_as_json(fleet, rows, domain, stack), _FORMS[form](rows, len(fleet.members)))


# Printing


def _as_json(fleet: Fleet, rows: Sequence[Row], domain: int, stack: str) -> dict[str, object]:
    return {
        "domain": domain,
        "as": stack,
        "participants": [member.name for member in fleet.members],
        "left_out": fleet.refused,
        "topics": [
            {
                "topic": row.topic,
                "pattern": row.is_pattern,
                "asked": row.asked,
                "publish": list(row.publishers),
                "subscribe": list(row.subscribers),
            }
            for row in rows
        ],
    }


def _table(rows: Sequence[Row], count: int) -> Iterator[str]:
    def cell(names: tuple[str, ...]) -> str:
        if len(names) == count > _MOST:
            return f"all {count}"
        more = f" and {len(names) - _MOST} more" if len(names) > _MOST else ""
        return ", ".join(map(plain, names[:_MOST])) + more or "-"

    heads = ("topic", "may publish", "may subscribe")
    cells = ((_topic(row), cell(row.publishers), cell(row.subscribers)) for row in rows)
    yield from _printing.table(heads, cells)


def _topic(row: Row) -> str:
    if not row.is_pattern:
        return plain(row.topic)
    return f"{plain(row.topic)} (asked: {plain(row.asked) if row.asked else 'no topic was found'})"


def _markdown(rows: Sequence[Row], _count: int) -> Iterator[str]:
    def cell(text: str) -> str:
        return _MARKDOWN.sub(r"\\\1", text)

    yield "| Topic | May publish | May subscribe |"
    yield "|---|---|---|"
    for row in rows:
        names = (", ".join(map(plain, each)) for each in (row.publishers, row.subscribers))
        yield f"| {' | '.join(map(cell, (_topic(row), *names)))} |"


def _dot(rows: Sequence[Row], _count: int) -> Iterator[str]:
    """Publishers -> topic -> subscribers; names stand in labels only."""
    used = (name for row in rows for name in (*row.publishers, *row.subscribers))
    nodes = {name: f"p{number}" for number, name in enumerate(dict.fromkeys(used))}
    yield "digraph who_may {"
    yield "  rankdir=LR;"
    for name, node in nodes.items():
        yield f"  {node} [label={_label(plain(name))}];"
    for number, row in enumerate(rows):
        yield f"  t{number} [shape=box, label={_label(_topic(row))}];"
        yield from (f"  {nodes[name]} -> t{number};" for name in row.publishers)
        yield from (f"  t{number} -> {nodes[name]};" for name in row.subscribers)
    yield "}"


def _label(text: str) -> str:
    """A quoted string of dot, in which `\\` and `&` begin escapes."""
    for special, escaped in (("&", "&amp;"), ("\\", "\\\\"), ('"', '\\"')):
        text = text.replace(special, escaped)
    return f'"{text}"'


_FORMS: dict[str, Callable[[Sequence[Row], int], Iterator[str]]] = {
    "table": _table,
    "json": lambda _rows, _count: iter(()),
    "dot": _dot,
    "md": _markdown,
}
