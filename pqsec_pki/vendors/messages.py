"""Explains a stack's security error, by its text or code, and how to fix it.

The table is messages.yaml. A text may be one message or a whole log, with lines wrapped
anywhere; the time to search it is linear in its length.
"""

import re
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import field, fields
from enum import StrEnum
from functools import cache
from importlib.resources import files
from itertools import accumulate, pairwise

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import shown
from pqsec_pki.stacks import Stack, stack_named
from pqsec_pki.vendors._log import MAX_VALUE, Log, lowered
from pqsec_pki.vendors._nearest import nearest_texts

_PLACEHOLDER = re.compile(r"\{(\w+)\}")
_BARE_CODE = re.compile(r"(?:code:? ?)?([0-9]{3})", re.IGNORECASE)
_FIT_FOR_A_COMMAND = re.compile(r"(?!-)[\w./*?:@%+=,-]{1,200}", re.ASCII)


class MessageKind(StrEnum):
    """What a message shows; the most useful first."""

    CAUSE = "cause"
    SYMPTOM = "symptom"
    """The message says that something failed; another message says why."""
    NORMAL = "normal"
    """The message belongs to a run without faults."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """A row of the table: the messages of stacks for one reason."""

    stacks: tuple[Stack, ...]
    code: int | None
    texts: tuple[str, ...]
    """{name} replaces words that vary."""
    kind: MessageKind
    cause: str
    remedy: str
    evidence: str

    @property
    def title(self) -> str:
        """Its text, or its code if it has none."""
        return self.texts[0] if self.texts else f"code {self.code}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Recognised:
    """A message that was found in a text."""

    message: Message
    text: str
    """The text of the table that matched, with {name} for words that vary."""
    values: Mapping[str, str]
    """The value in the text for each {name}."""
    line: int
    """The first line of the text that has it, from 1."""
    times: int

    def to_json(self) -> dict[str, object]:
        """The row of the table for --json, with the text of this message."""
        row = {each.name: getattr(self.message, each.name) for each in fields(self.message)}
        return row | {
            "said": self.said,
            "values": dict(self.values),
            "line": self.line,
            "times": self.times,
            "cause": self.cause,
            "remedy": self.remedy,
        }

    @property
    def said(self) -> str:
        """Its text, with the values filled in."""
        return _filled(self.text, self._shown)

    @property
    def cause(self) -> str:
        """What is wrong."""
        return _filled(self.message.cause, self._shown)

    @property
    def _shown(self) -> dict[str, str]:
        return {name: shown(value, MAX_VALUE) for name, value in self.values.items()}

    @property
    def remedy(self) -> str:
        """What to do. Values that are not plain words are left out, because users copy it."""
        known = {k: v for k, v in self.values.items() if fit_for_a_command(v)}
        return _filled(self.message.remedy, known)


def fit_for_a_command(text: str) -> bool:
    """Whether `text`, from outside, is one word for a shell, and not a command's option."""
    return _FIT_FOR_A_COMMAND.fullmatch(text) is not None


def messages(stack: str | None = None) -> tuple[Message, ...]:
    """All rows, or those of one stack."""
    return tuple(row for row in _table() if stack is None or stack in row.stacks)


def recognise(text: str, *, stack: str | None = None) -> tuple[Recognised, ...]:
    """The known messages in `text`, best first: causes, then symptoms, in the text's order.

    Only of `stack` if it is given. A text that is only a number is read as a code.
    """
    rows = messages(stack)
    if found := _BARE_CODE.fullmatch(text.strip()):
        return tuple(_by_code(row, 1) for row in rows if row.code == int(found[1]))
    log = Log.of(text)
    places = _undisguised([each for row in rows for each in _places(row, log)])
    places.sort(key=lambda each: each.ends)
    return _counted([*places, *_coded(rows, places, log)])


def nearest(text: str, *, stack: str | None = None, limit: int = 3) -> tuple[Message, ...]:
    """The rows whose words are most similar to a text that no row matches; may be empty."""
    known = {words: row for row in messages(stack) for words in row.texts}
    return tuple(dict.fromkeys(known[words] for words in nearest_texts(text, known)))[:limit]


@cache
def _table() -> tuple[Message, ...]:
    import yaml  # noqa: PLC0415 -- only users of the table need it

    text = files("pqsec_pki.vendors").joinpath("messages.yaml").read_text("utf-8")
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    return tuple(
        Message(
            stacks=tuple(map(stack_named, row["stacks"])),
            code=row.get("code"),
            texts=tuple(row.get("texts", ())),
            kind=MessageKind(row.get("kind", MessageKind.CAUSE)),
            cause=row["cause"],
            remedy=row["remedy"],
            evidence=row["evidence"],
        )
        for row in yaml.load(text, loader)  # noqa: S506 -- both loaders are safe ones
    )


def _filled(template: str, values: Mapping[str, str]) -> str:
    return _PLACEHOLDER.sub(lambda found: values.get(found[1], found[1].upper()), template)


def _coded(rows: Iterable[Message], places: "list[_Place]", log: Log) -> Iterator[Recognised]:
    """Messages known only by code; a vague code counts only if there is no message text."""
    known = {(each.line, each.message.code) for each in places}
    lines = {line for each in places for line in (each.line, each.line + 1)}
    by_code = {row.code: row for row in rows if row.code is not None}
    for line, code in log.codes():
        row = by_code.get(code)
        if (
            row
            and (line, code) not in known
            and (row.kind is MessageKind.CAUSE or line not in lines)
        ):
            yield _by_code(row, line)


def _by_code(row: Message, line: int) -> Recognised:
    return Recognised(message=row, text=row.title, values={}, line=line, times=1)


@dataclass(frozen=True, slots=True)
class _Place(Recognised):
    """A message, with its position in a log."""

    parts: tuple[tuple[int, int], ...] = field(kw_only=True)
    """Begin and end of each of its fixed parts."""

    @property
    def ends(self) -> tuple[int, int]:
        return self.parts[0][0], self.parts[-1][1]


def _places(row: Message, log: Log) -> Iterator[_Place]:
    """The positions of the row's texts in the log."""
    for text in row.texts:
        fixed, names = _PLACEHOLDER.split(text)[::2], _PLACEHOLDER.findall(text)
        wanted = [lowered(part) for part in fixed if part]
        for parts in _found(wanted, log.lowered):
            values = dict(zip(names, _values(fixed, parts, log), strict=True))
            line = log.line(parts[0][0])
            yield _Place(message=row, text=text, values=values, line=line, times=1, parts=parts)


def _found(wanted: list[str], text: str) -> Iterator[tuple[tuple[int, int], ...]]:
    """The positions where all of `wanted` follow each other, as begins and ends."""
    begin = text.find(wanted[0])
    while begin >= 0:
        parts = [(begin, begin + len(wanted[0]))]
        for each in wanted[1:]:
            end = parts[-1][1]
            at = text.find(each, end, end + MAX_VALUE + len(each))
            if at < 0:
                break
            parts.append((at, at + len(each)))
        else:
            yield tuple(parts)
        begin = text.find(wanted[0], begin + len(wanted[0]))


def _values(fixed: list[str], parts: tuple[tuple[int, int], ...], log: Log) -> Iterator[str]:
    """The text between the fixed parts, and before and after them."""
    if not fixed[0]:
        yield log.word_before(parts[0][0])
    for (_, end), (begin, _) in pairwise(parts):
        yield log.text[end:begin].strip()
    if not fixed[-1]:
        yield log.rest_of_line(parts[-1][1])


def _undisguised(places: list[_Place]) -> list[_Place]:
    """The places without those that are only a piece of another's fixed words."""
    parts = sorted(part for place in places for part in place.parts)
    begins = [begin for begin, _ in parts]
    farthest = list(accumulate((end for _, end in parts), max))

    def is_piece(place: _Place) -> bool:
        begin, end = place.ends
        before, up_to = bisect_left(begins, begin), bisect_right(begins, begin)
        return (before > 0 and farthest[before - 1] >= end) or farthest[up_to - 1] > end

    return [place for place in places if len(place.parts) > 1 or not is_piece(place)]


def _counted(found: Iterable[Recognised]) -> tuple[Recognised, ...]:
    """Each message once for each set of values, best first."""
    kinds: dict[tuple[Message, tuple[tuple[str, str], ...]], list[Recognised]] = {}
    for each in found:
        kinds.setdefault((each.message, tuple(each.values.items())), []).append(each)
    firsts = [
        Recognised(
            message=same[0].message,
            text=same[0].text,
            values=same[0].values,
            line=min(each.line for each in same),
            times=len(same),
        )
        for same in kinds.values()
    ]
    order = list(MessageKind)
    return tuple(sorted(firsts, key=lambda each: (order.index(each.message.kind), each.line)))
