"""A log in the form that is searched for messages: one line, with the positions of its lines."""

import re
from bisect import bisect_right
from collections.abc import Iterator
from functools import cached_property
from itertools import accumulate
from string import ascii_lowercase, ascii_uppercase
from typing import Self

from pqsec_pki._dataclass import dataclass

MAX_VALUE = 300
"""Most characters between two parts of a message, such as a path; more do not match."""

_CODE = re.compile(r"\bcode:? ?([0-9]{3})\b", re.IGNORECASE)
_END_OF_VALUE = re.compile(r" ?\(code:| \(/| -> |, at |; ")
_LOWER = str.maketrans(ascii_uppercase, ascii_lowercase)  # keeps the length, as lower() does not


def lowered(text: str) -> str:
    """`text` with A to Z in lower case, each character in its place."""
    return text.translate(_LOWER)


@dataclass(frozen=True)
class Log:
    """A text as one line, every run of spaces and line ends a single space."""

    text: str
    starts: tuple[int, ...]
    """The position of the begin of each line."""

    @classmethod
    def of(cls, text: str) -> Self:
        """The log of a text of any size."""
        lines = [" ".join(line.split()) for line in text.split("\n")]
        starts = accumulate((len(line) + 1 for line in lines), initial=0)
        return cls(" ".join(lines), tuple(starts)[:-1])

    @cached_property
    def lowered(self) -> str:
        """The text in lower case, for comparing."""
        return lowered(self.text)

    def line(self, place: int) -> int:
        """The number, from 1, of the line at position `place`."""
        return bisect_right(self.starts, place)

    def codes(self) -> Iterator[tuple[int, int]]:
        """(line, code) for each number after the word `code`."""
        for found in _CODE.finditer(self.text):
            yield self.line(found.start()), int(found[1])

    def word_before(self, place: int) -> str:
        """The word that ends at position `place`."""
        before = self.text[max(0, place - MAX_VALUE) : place].split()
        return before[-1].strip("'\"") if before else ""

    def rest_of_line(self, place: int) -> str:
        """The rest of the line from `place`, without what stacks add to every message."""
        line = self.line(place)
        end = self.starts[line] - 1 if line < len(self.starts) else len(self.text)
        rest = self.text[place : min(end, place + MAX_VALUE)]
        return _END_OF_VALUE.split(rest, maxsplit=1)[0].strip(" .'\")")
