"""Tables in Markdown."""

from collections.abc import Iterable


def row(cells: Iterable[str]) -> str:
    """One line of a table, with `|` in the cells escaped."""
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def table(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A table with these columns."""
    heads = list(heads)
    return "\n".join([row(heads), f"|{'---|' * len(heads)}", *map(row, rows)])
