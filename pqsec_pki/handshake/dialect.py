"""How a side writes what the specification leaves open, and what it will not read.

DDS-Security 1.1 does not say whether algorithm names end in NUL, and stacks do not agree
which optional properties may be absent. A dialect is one answer to all of it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeVar

from pqsec_pki.handshake.messages import Final, Reply, Request

Message = TypeVar("Message", Request, Reply, Final)


@dataclass(frozen=True, slots=True, kw_only=True)
class Dialect:
    """One way to speak. The default is ours, which every stack understands."""

    ends_names_in_nul: bool = True
    """In a Request, and in a Reply unless it answers in kind."""
    answers_in_kind: bool = True
    """Whether a Reply ends names as the Request did."""
    sends_optional: bool = True
    """Whether hash_c1, hash_c2 and what is repeated of dh1 and dh2 are sent."""
    reads_request_names: bool | None = None
    """Whether names in a Request must (True) or must not (False) end in NUL, or may."""
    reads_reply_names: bool | None = None
    """The same for a Reply."""
    needs_in_reply: tuple[str, ...] = ()
    """Properties that are optional, but not to this reader."""

    def written(self, message: Message) -> Message:
        """`message` as this side sends it."""
        return message if self.sends_optional else message.without_optional()

    def answers_with_nul(self, request: Request) -> bool:
        """Whether names end in NUL in the Reply to `request`."""
        if self.answers_in_kind:
            return request.introduction.ends_names_in_nul
        return self.ends_names_in_nul

    def problems(self, message: Request | Reply) -> Iterator[str]:
        """What this side will not read in `message`, though others do."""
        is_request = isinstance(message, Request)
        wanted = self.reads_request_names if is_request else self.reads_reply_names
        found = message.introduction.ends_names_in_nul
        if wanted not in (None, found):
            yield f"algorithm names {'end' if found else 'do not end'} in NUL"
        if not is_request:
            for name in self.needs_in_reply:
                if getattr(message, name) is None:
                    yield f"{name} is missing"


OURS = Dialect()
