"""Parses all YAML from outside, without guessing types.

YAML guesses: NO is false, 010 is eight, 2026-01-01 is a date. Here a document is text in lists
and mappings, each with its line, and the reader of a value decides its type. Tags, anchors,
aliases, duplicate keys and second documents are refused: each has been an attack or an
unnoticed mistake. Parsing is by events, so the limits apply during parsing.
"""

import codecs
import re
from collections.abc import Iterable, Iterator, Mapping
from datetime import datetime
from functools import cache
from typing import TYPE_CHECKING, Any, TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents._yaml_guesses import TAG, add_guesses
from pqsec_pki.errors import InvalidDocumentError, TooLargeError, UsageError, library_call, shown
from pqsec_pki.problems import Problem

if TYPE_CHECKING:
    import yaml

MAX_DOCUMENT = 8 << 20
"""Bytes; the same limit as for an XML document."""
MAX_DEPTH = 24
"""Nested lists and mappings; a policy needs eleven levels."""
_TOO_DEEP = f"more than {MAX_DEPTH} nested lists and mappings"
MAX_ITEMS = 500_000
"""Values in a document. A policy of 10 000 rules has about 150 000."""
_SMALLER = "make several smaller ones, or name sets of participants by patterns"

_CODECS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"),
           (codecs.BOM_UTF16_BE, "utf-16"))  # fmt: skip

_SURROGATE = re.compile("[\ud800-\udfff]")
_UNSEEN_END = re.compile("[\x85\u2028\u2029]|\r(?!\n)")
"""Ends of lines for YAML 1.1 and Python, and for few editors: there a comment goes on as code."""


@dataclass(frozen=True, slots=True)
class Text:
    """The text of one value; `plain` if it has no quotes."""

    line: int
    text: str
    plain: bool


@dataclass(frozen=True, slots=True)
class Items:
    """A list."""

    line: int
    items: list["Item"]


@dataclass(frozen=True, slots=True)
class YamlMapping:
    """A mapping: key -> (the key, its value)."""

    line: int
    entries: dict[str, tuple[Text, "Item"]]


Item: TypeAlias = Text | Items | YamlMapping


def refused(place: Item | int | None, message: str) -> InvalidDocumentError:
    """The error for the item or line at `place`."""
    line = place if isinstance(place, int) or place is None else place.line
    return InvalidDocumentError([Problem(message, line=line)])


# Parsing


def parse(data: bytes) -> Item:
    """The document's root item; InvalidDocumentError, with the line, if it is not YAML."""
    text = _decoded(data)
    return _tree(_events(text))


def _events(text: str) -> "Iterator[yaml.Event]":
    """The events of the text; InvalidDocumentError where the library reads no further."""
    import yaml  # noqa: PLC0415 - `pqsec --help` must not load yaml

    loader = yaml.CSafeLoader if yaml.__with_libyaml__ else yaml.SafeLoader
    with library_call(lambda error: _no_yaml(error, text)):
        yield from yaml.parse(text, Loader=loader)


def _decoded(data: bytes) -> str:
    if len(data) > MAX_DOCUMENT:
        raise refused(None, f"larger than {MAX_DOCUMENT} bytes, so not a policy")
    codec = next((codec for mark, codec in _CODECS if data.startswith(mark)), "utf-8")
    try:
        text = data.decode(codec)
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise refused(line, f"not {codec.removesuffix('-sig').upper()} text") from None
    refuse_unseen_ends(text)
    return text


def refuse_unseen_ends(text: str) -> None:
    """InvalidDocumentError for a character that ends a line here, and is not seen to elsewhere."""
    if found := _UNSEEN_END.search(text):
        line = text.count("\n", 0, found.start()) + 1
        raise refused(line, f"U+{ord(found[0]):04X} ends a line, and editors do not show it so")


def _no_yaml(error: BaseException, text: str) -> InvalidDocumentError:
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    reason = getattr(error, "problem", None) or getattr(error, "reason", None) or "not YAML"
    if "alias" in f"{reason} {getattr(error, 'context', '')}":
        reason = "a name with * at its start must be in quotes, as '*' or '*/status'"
    if "nesting depth" in reason:  # PyYAML 6.0.4 looks ahead, and has a limit of its own
        return refused(mark.line + 1 if mark else None, _TOO_DEEP)
    line = text.splitlines()[mark.line :][:1] if mark else []
    if any("\t" in each[: len(each) - len(each.lstrip())] for each in line):
        reason = "a tab: indent YAML with spaces only"
    return refused(mark.line + 1 if mark else None, f"not well-formed YAML: {shown(reason)}")


def _tree(events: Iterable["yaml.Event"]) -> Item:
    """The document's tree, built without recursion, so that depth cannot exhaust Python's stack."""
    builder = _TreeBuilder()
    for event in events:
        kind = type(event).__name__
        if action := getattr(builder, f"on_{kind}", None):
            action(event, event.start_mark.line + 1 if event.start_mark else 1)
    if builder.root is None:
        raise refused(1, "is empty")
    return builder.root


class _TreeBuilder:
    """Builds a tree from YAML's events; each event has a method with its name."""

    def __init__(self) -> None:
        self.root: Item | None = None
        self._open: list[Items | YamlMapping] = []
        self._keys: list[Text | None] = []  # for each open item, the key without a value yet
        self._count = 0

    def on_DocumentStartEvent(self, event: "yaml.Event", line: int) -> None:  # noqa: N802 - YAML's
        del event
        if self.root is not None:
            raise refused(line, "a second document begins with ---; only one is allowed")

    def on_AliasEvent(self, event: "yaml.Event", line: int) -> None:  # noqa: N802 - YAML's
        name = shown(getattr(event, "anchor", ""))
        message = f"YAML reads *{name} as an alias, which is not allowed; in quotes: '*{name}'"
        raise refused(line, message)

    def on_ScalarEvent(self, event: "yaml.ScalarEvent", line: int) -> None:  # noqa: N802 - YAML's
        self._check(event, line)
        self._put(Text(line, event.value, plain=event.style in {None, ""}))

    def on_SequenceStartEvent(self, event: "yaml.NodeEvent", line: int) -> None:  # noqa: N802
        self._begin(event, Items(line, []))

    def on_MappingStartEvent(self, event: "yaml.NodeEvent", line: int) -> None:  # noqa: N802
        self._begin(event, YamlMapping(line, {}))

    def on_SequenceEndEvent(self, *_: object) -> None:  # noqa: N802 - YAML's
        self._open.pop()
        self._keys.pop()

    on_MappingEndEvent = on_SequenceEndEvent  # noqa: N815 - YAML's

    def _begin(self, event: "yaml.NodeEvent", item: Items | YamlMapping) -> None:
        self._check(event, item.line)
        self._put(item)
        self._open.append(item)
        self._keys.append(None)
        if len(self._open) > MAX_DEPTH:
            raise refused(item.line, _TOO_DEEP)

    def _check(self, event: Any, line: int) -> None:
        self._count += 1
        if self._count > MAX_ITEMS:
            raise refused(line, f"more than {MAX_ITEMS} values, so not a policy")
        if event.tag is not None:
            raise refused(line, f"the tag {shown(event.tag)} is not allowed; ! begins a tag")
        if event.anchor is not None:
            raise refused(line, f"the anchor &{shown(event.anchor)} is not allowed")

    def _put(self, item: Item) -> None:
        holder = self._open[-1] if self._open else None
        if holder is None:
            self.root = item
        elif isinstance(holder, Items):
            holder.items.append(item)
        elif (key := self._keys[-1]) is not None:
            holder.entries[key.text] = (key, item)
            self._keys[-1] = None
        elif not isinstance(item, Text):
            raise refused(item.line, "a key must be a word")
        elif item.text in holder.entries:
            raise refused(item.line, f"the key '{shown(item.text)}' comes twice")
        else:
            self._keys[-1] = item


# Writing


def dump(value: object) -> bytes:
    """`value` as a YAML document; UsageError for text that cannot be encoded.

    TooLargeError for one that `parse` would refuse.
    """
    TooLargeError.check("the YAML", _values_in(value), MAX_ITEMS, hint=_SMALLER, unit="values")
    import yaml  # noqa: PLC0415 - `pqsec --help` must not load yaml

    written: str = yaml.dump(
        value, Dumper=_dumper(), sort_keys=False, allow_unicode=True, width=1 << 20
    )
    data = written.encode()
    TooLargeError.check("the YAML", len(data), MAX_DOCUMENT, hint=_SMALLER)
    return data


def _values_in(value: object) -> int:
    """How many values `parse` counts in it: each key, text, list and mapping."""
    if isinstance(value, Mapping):
        return 1 + sum(1 + _values_in(each) for each in value.values())
    if isinstance(value, list | tuple):
        return 1 + sum(map(_values_in, value))
    return 1


@cache
def _dumper() -> "type[yaml.SafeDumper]":
    import yaml  # noqa: PLC0415 - `pqsec --help` must not load yaml

    class Dumper(yaml.SafeDumper):
        """Times as XML has them, and lists under their key to the right of it."""

        def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:  # noqa: FBT001, FBT002 - yaml's
            del indentless
            super().increase_indent(flow, indentless=False)

    Dumper.add_representer(
        datetime,
        lambda dumper, value: dumper.represent_scalar(
            f"{TAG}timestamp", f"{value.replace(tzinfo=None).isoformat()}Z"
        ),
    )
    Dumper.add_representer(str, _represented)
    add_guesses(Dumper)
    return Dumper


def _represented(dumper: Any, text: str) -> Any:
    """Text as a scalar; outside double quotes, yaml would lose U+0085 and U+2028."""
    if found := _SURROGATE.search(text):
        raise UsageError(f"{found[0]!a} is a character that cannot be written to a file")
    style = None if text.isprintable() else '"'
    return dumper.represent_scalar(f"{TAG}str", text, style)
