"""The description of a file: facts, each as text for people and as a value for programs."""

from typing import Any, Self, TypeAlias

from pqsec_pki._dataclass import dataclass

Value: TypeAlias = "str | int | tuple[Value, ...] | dict[str, Value] | None"
"""A JSON value. A bool is an int."""
Row: TypeAlias = tuple[str, str]
"""A label and a line of text; the label is empty if the line continues the one before."""

MAX_LABEL = 24
"""Columns; after a longer label the text begins further right."""


@dataclass(frozen=True, slots=True)
class Fact:
    """One fact about a file."""

    key: str
    """Its name in JSON."""
    value: Value
    rows: tuple[Row, ...]

    @classmethod
    def of(cls, label: str, value: Value, *words: str, key: str | None = None) -> Self:
        """A fact with one label; its words default to the value, and its key to the label."""
        lines = words or (str(value),)
        rows = tuple((label if line == 0 else "", text) for line, text in enumerate(lines))
        return cls(label.replace(" ", "_") if key is None else key, value, rows)


@dataclass(frozen=True, slots=True)
class Description:
    """What a file is: a kind, a title and facts; and parts, if it contains several things."""

    kind: str
    title: str
    facts: tuple[Fact, ...] = ()
    parts: "tuple[Description, ...]" = ()

    def to_json(self) -> dict[str, Any]:
        """The description for json.dumps."""
        value: dict[str, Any] = {"kind": self.kind, "title": self.title}
        value |= {fact.key: fact.value for fact in self.facts}
        if self.parts:
            value["parts"] = [part.to_json() for part in self.parts]
        return value

    def to_text(self) -> list[str]:
        """The description in lines. Control characters from the file are shown escaped."""
        rows = [row for fact in self.facts for row in fact.rows]
        width = min(MAX_LABEL, max((len(label) for label, _ in rows), default=0))
        lines = [_shown(self.title)]
        lines += [_shown(f"  {label:<{width}}  {words}") for label, words in rows]
        for part in self.parts:
            lines += ["", *part.to_text()]
        return lines


def _shown(text: str) -> str:
    return "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in text).rstrip()
