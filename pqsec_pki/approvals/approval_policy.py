"""Whose approvals a keystore demands, and for which changes."""

import re
from base64 import b64decode, b64encode
from collections.abc import Collection, Mapping
from dataclasses import field
from enum import StrEnum
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import PublicKey, load_public_key
from pqsec_pki.approvals import _canonical
from pqsec_pki.approvals._canonical import canonical, exactly, items, parsed, reading, text, whole
from pqsec_pki.errors import KeystoreError, UsageError, shown

MAX_APPROVERS = 100
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.@+-]{0,63}")
"""The name of a person or an authority; also a part of a file's name."""


class Covered(StrEnum):
    """Kinds of changes."""

    REVOKE = "revoke"
    ROTATE = "rotate"
    GROW = "grow"
    """A new certificate, more rights, or less protection."""
    OTHER = "other"
    APPROVALS = "approvals"
    """A change of this policy. It always needs approvals."""

    @property
    def words(self) -> str:
        """The kind in words, for messages."""
        return _WORDS[self]


_WORDS = {
    Covered.REVOKE: "revocation",
    Covered.ROTATE: "the replacement of CAs",
    Covered.GROW: "rights that grow",
    Covered.OTHER: "every change",
    Covered.APPROVALS: "a change of `approvals`",
}
ALL = frozenset(Covered)
DEFAULT = frozenset({Covered.REVOKE, Covered.ROTATE, Covered.GROW, Covered.APPROVALS})


@dataclass(frozen=True, slots=True)
class ApprovalPolicy:
    """How many of which people must approve which changes."""

    required: int
    covers: frozenset[Covered]
    approvers: Mapping[str, PublicKey] = field(compare=False)
    """Public key of each approver, by name."""
    text: str = field(repr=False)
    """All of it, as JSON."""

    @classmethod
    def of(
        cls, required: int, covers: Collection[Covered], approvers: Mapping[str, PublicKey]
    ) -> Self:
        """UsageError for what would not need that many people."""
        _check(required, approvers)
        covered = frozenset({*covers, Covered.APPROVALS})
        value = {
            "required": required,
            "covers": sorted(covered),
            "approvers": {
                name: b64encode(key.spki).decode() for name, key in sorted(approvers.items())
            },
        }
        return cls(required, covered, dict(sorted(approvers.items())), canonical(value).decode())

    @classmethod
    def from_json(cls, value: object) -> Self:
        """The policy in a value of JSON; MalformedError if it is none."""
        with reading("a policy of approvals"):
            found = exactly(value, "required", "covers", "approvers")
            names = exactly(found["approvers"], *found["approvers"])
            keys = {
                name: load_public_key(b64decode(text(key), validate=True))
                for name, key in names.items()
            }
            return cls.of(whole(found["required"]), items(found["covers"], _kind), keys)

    @classmethod
    def from_text(cls, data: str) -> Self:
        """The policy with that `text`; MalformedError if it is none."""
        with reading("a policy of approvals"):
            value = parsed(data.encode())
        return cls.from_json(value)

    def to_json(self) -> object:
        """The policy as a value of JSON."""
        return parsed(self.text.encode())

    def needs(self, kinds: Collection[Covered]) -> tuple[Covered, ...]:
        """The kinds of `kinds` that need approvals."""
        return tuple(kind for kind in Covered if kind in kinds and kind in self.covers)

    def refuse(self, kinds: Collection[Covered]) -> None:
        """KeystoreError if any of `kinds` needs approvals."""
        if words := self.demand(kinds):
            raise KeystoreError(words, hint=_WAY_OUT)

    def demand(self, kinds: Collection[Covered]) -> str:
        """What approvals are needed for changes of these kinds, in words; empty for none."""
        words = ", ".join(each.words for each in self.needs(kinds))
        return f"approvals are needed for {words}: {self._people}" if words else ""

    @property
    def _people(self) -> str:
        return f"{self.required} of {', '.join(self.approvers)}"

    def name_of(self, key: PublicKey) -> str | None:
        """The approver with that key."""
        found = (name for name, each in self.approvers.items() if _same(each) == _same(key))
        return next(found, None)

    def other_keys(self, before: "ApprovalPolicy") -> tuple[str, ...]:
        """The approvers who had another key in the policy `before`."""
        both = self.approvers.keys() & before.approvers.keys()
        same = {
            name for name in both if _same(self.approvers[name]) == _same(before.approvers[name])
        }
        return tuple(sorted(both - same))

    def __str__(self) -> str:
        chosen = sorted(self.covers - {Covered.APPROVALS})
        kinds = "every change" if self.covers == ALL else ", ".join(chosen)
        return f"{self._people} for {kinds}"


_WAY_OUT = (
    "propose it with `pqsec propose -o plan.json --key KEY COMMAND`, or a change of the domain file"
    " with `pqsec plan`; others run `pqsec approve plan.json`; then run `pqsec apply plan.json`"
)


def _check(required: int, approvers: Mapping[str, PublicKey]) -> None:
    if not 1 <= len(approvers) <= MAX_APPROVERS:
        raise UsageError(f"there must be 1 to {MAX_APPROVERS} approvers")
    seen: dict[object, str] = {}
    for name, key in approvers.items():
        if not NAME.fullmatch(name):
            raise UsageError(
                f"'{shown(name)}' cannot be an approver's name", hint="write alice or bob@example"
            )
        for each, what in ((name.casefold(), "name"), (_same(key), "key")):
            if other := seen.setdefault(each, name) != name and seen[each]:
                raise UsageError(
                    f"{other} and {name} have the same {what}, and would count as two people"
                )
    if not 1 <= required <= len(approvers):
        raise UsageError(
            f"required: {required} approvals of {len(approvers)} approvers are not possible"
        )


def _same(key: PublicKey) -> tuple[str, bytes]:
    """Equal for one key, however its point is encoded."""
    return key.algorithm.name, key.raw


def _kind(value: object) -> Covered:
    return Covered(_canonical.text(value))
