"""Ledger lines about the CAs of further sets, in a form that shows of which set each is.

A proof of the ledger has of a line what the tree hashes: number, kind, name, SHA-256 and chain
value. The set of credentials is in the line's details, which the chain value covers, together with
the chain value before it. So whoever has both can compute it again.
"""

from collections.abc import Collection, Mapping
from typing import Any, Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import MalformedError
from pqsec_pki.keystore._chain import START, Entry, Line, link
from pqsec_pki.keystore._ledger import Ledger
from pqsec_pki.transparency import ProvenLine

_TEXTS = ("at", "kind", "name", "sha256")
_OPTIONAL = ("serial", "not_after", "issuer", "operator")


@dataclass(frozen=True, slots=True)
class SetLine:
    """A line about a CA of a further set."""

    before: str
    """The chain value of the line before it."""
    line: Line

    @classmethod
    def of(cls, ledger: Ledger, kind: str, sha256: str) -> Self | None:
        """The newest line of that kind and SHA-256; None if the ledger has none."""
        number = ledger.line_of((kind,), sha256)
        line, before = ledger.line(number), ledger.row(number - 1) if number > 1 else None
        return cls(before[-1] if before else START, line) if line else None

    @property
    def about(self) -> tuple[str, str]:
        """Its kind and SHA-256."""
        return self.line.entry.kind, self.line.entry.sha256

    def proves(self, set_name: str, proven: Collection[ProvenLine]) -> bool:
        """Whether one of the `proven` lines is this one, and about a CA of that set."""
        entry, number = self.line.entry, self.line.number
        if entry.set_name != set_name or link(self.before, number, entry) != self.line.chain:
            return False
        row = (number, entry.kind, entry.name, entry.sha256, self.line.chain)
        return any((e.number, e.kind, e.name, e.sha256, e.chain) == row for e in proven)

    def to_json(self) -> dict[str, object]:
        """The line in a bundle's manifest."""
        return {**self.line.to_json(), "before": self.before}

    @classmethod
    def of_json(cls, value: Mapping[str, Any]) -> Self:
        """The inverse of `to_json`; MalformedError for anything else."""
        try:
            texts: dict[str, Any] = {each: _text(value[each]) for each in _TEXTS}
            others: dict[str, Any] = {
                each: None if value[each] is None else _text(value[each]) for each in _OPTIONAL
            }
            details = {_text(key): _text(each) for key, each in value["details"].items()}
            entry = Entry(**texts, **others, details=details)
            line = Line(_number(value["number"]), entry, _text(value["chain"]))
            return cls(_text(value["before"]), line)
        except (KeyError, TypeError, ValueError, AttributeError):
            raise MalformedError("the manifest has a line of a ledger that is not one") from None


def _number(value: object) -> int:
    if type(value) is not int:
        raise TypeError("not a number")
    return value


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError("not a text")
    value.encode()  # JSON can have texts that UTF-8 cannot
    return value
