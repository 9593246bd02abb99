"""How who-may prints its answer: tables, Markdown, and a graph."""

import re
from collections.abc import Callable, Iterator, Sequence

from pqsec_pki.access import Placed, TopicRow
from pqsec_pki.cli import _printing
from pqsec_pki.cli._printing import printable
from pqsec_pki.documents import ros
from pqsec_pki.policy import Flow

_MOST = 6
"""The most names in a cell of the text table."""
_DEFAULT = "(default)"
"""The default partition, whose name is empty."""
_MARKDOWN = re.compile(r"([\\`*_\[\]<>|~&$#!])")


def flow_lines(flows: Sequence[Flow]) -> list[str]:
    """A table with a row for each sender and its receivers, in the words of ROS 2."""
    is_split = any(each.where for each in flows)
    cells = (
        (
            *(printable(each.sender), _names(each.receivers), str(each.domains)),
            *_where(each.where, is_split=is_split),
            _names(tuple(map(ros.said, each.topics))),
        )
        for each in flows
    )
    return _printing.table(("from", "to", "domain", *_header(is_split=is_split), "what"), cells)


def _header(*, is_split: bool) -> tuple[str, ...]:
    return ("partition",) * is_split


def _where(words: str, *, is_split: bool) -> tuple[str, ...]:
    """The cell with the partitions, if any row has some."""
    return (printable(words) or _DEFAULT,) * is_split


def _names(names: tuple[str, ...]) -> str:
    more = f" and {len(names) - _MOST} more" if len(names) > _MOST else ""
    return ", ".join(map(printable, names[:_MOST])) + more


def _table(rows: Sequence[Placed], count: int) -> Iterator[str]:
    def cell(names: tuple[str, ...]) -> str:
        if len(names) == count > _MOST:
            return f"all {count}"
        return _names(names) or "-"

    is_split = any(each.row.where for each in rows)
    headers = ("topic", "domain", *_header(is_split=is_split), "may publish", "may subscribe")
    cells = (
        (
            *(_topic(each.row), str(each.domains), *_where(each.row.where, is_split=is_split)),
            *(cell(each.row.publishers), cell(each.row.subscribers)),
        )
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

    is_split = any(each.row.where for each in rows)
    headers = ("Topic", "Domain", *("Partition",) * is_split, "May publish", "May subscribe")
    yield f"| {' | '.join(headers)} |"
    yield "|---" * len(headers) + "|"
    for each in rows:
        where = _where(each.row.where, is_split=is_split)
        who = (
            ", ".join(map(printable, them)) for them in (each.row.publishers, each.row.subscribers)
        )
        yield f"| {' | '.join(map(cell, (_topic(each.row), str(each.domains), *where, *who)))} |"


def _dot(rows: Sequence[Placed], _count: int) -> Iterator[str]:
    """A graph from publishers to topics to subscribers. Names are only in labels."""
    used = (name for each in rows for name in (*each.row.publishers, *each.row.subscribers))
    nodes = {name: f"p{number}" for number, name in enumerate(dict.fromkeys(used))}
    yield "digraph who_may {"
    yield "  rankdir=LR;"
    for name, node in nodes.items():
        yield f"  {node} [label={_label(printable(name))}];"
    for number, each in enumerate(rows):
        where = f", partition {printable(each.row.where)}" if each.row.where else ""
        label = _label(f"{_topic(each.row)} (domain {each.domains}{where})")
        yield f"  t{number} [shape=box, label={label}];"
        yield from (f"  {nodes[name]} -> t{number};" for name in each.row.publishers)
        yield from (f"  t{number} -> {nodes[name]};" for name in each.row.subscribers)
    yield "}"


def _label(text: str) -> str:
    """A quoted string of the dot language; escapes `\\`, `&` and quotes."""
    for special, escaped in (("&", "&amp;"), ("\\", "\\\\"), ('"', '\\"')):
        text = text.replace(special, escaped)
    return f'"{text}"'


def _nothing(_rows: Sequence[Placed], _count: int) -> Iterator[str]:
    """No lines: for forms that print values."""
    yield from ()


FORMS: dict[str, Callable[[Sequence[Placed], int], Iterator[str]]] = {
    "table": _table,
    "json": _nothing,
    "csv": _nothing,
    "dot": _dot,
    "md": _markdown,
}
