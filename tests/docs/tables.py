"""What stands in a document of docs/: its tables, its text blocks, the tests it names."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
Row = dict[str, str]


class Document:
    """A Markdown file in docs/."""

    def __init__(self, name: str) -> None:
        self.text = (ROOT / "docs" / name).read_text()

    def table(self, *columns: str) -> list[Row]:
        """The rows of the one table whose first columns are these, by column.

        A column whose name is there twice has a number behind the second.
        """
        (found,) = (rows for head, rows in self._tables() if head[: len(columns)] == columns)
        return found

    def section(self, title: str) -> str:
        """What is under the heading `title`, to the next one of any level."""
        return self.text.partition(f" {title}\n")[2].partition("\n#")[0]

    def block(self, title: str, number: int = 0) -> str:
        """The text block of that number in a section."""
        return re.findall(r"(?s)```text\n(.*?)```", self.section(title))[number]

    @property
    def tests(self) -> list[str]:
        """The tests it names, as file::function."""
        return re.findall(r"`(tests/[\w/]+\.py::\w+)`", self.text)

    def _tables(self) -> Iterator[tuple[tuple[str, ...], list[Row]]]:
        for text in re.findall(r"(?m)(?:^\|.*\|\n)+", self.text):
            head, _, *lines = (_cells(line) for line in text.splitlines())
            names = [
                f"{name} {head[:at].count(name) or ''}".strip() for at, name in enumerate(head)
            ]
            yield tuple(names), [dict(zip(names, line, strict=True)) for line in lines]


def _cells(line: str) -> list[str]:
    return [cell.strip().replace("`", "") for cell in line.strip("|").split("|")]


def number(cell: str) -> int:
    """The one number in a cell, such as `up to 72`."""
    (found,) = re.findall(r"[0-9]+", cell)
    return int(found)


def missing(tests: list[str]) -> list[str]:
    """Those of `tests` that are not there."""
    names = {file: _functions(ROOT / file) for file in {test.partition("::")[0] for test in tests}}
    pairs = ((test, test.partition("::")) for test in tests)
    return [test for test, (file, _, name) in pairs if name not in names[file]]


def _functions(path: Path) -> set[str]:
    if not path.exists():
        return set()
    tree = ast.parse(path.read_text())
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
