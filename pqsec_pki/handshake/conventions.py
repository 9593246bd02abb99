"""How an implementation writes what the specification leaves open, and what it refuses.

DDS-Security 1.1 does not say whether algorithm names end in NUL, and stacks differ in which
optional properties may be absent. `MessageConventions` has one choice for each of these.
"""

from collections.abc import Iterator
from typing import TypeVar

from pqsec_pki._dataclass import dataclass
from pqsec_pki.handshake.messages import Final, Reply, Request

Message = TypeVar("Message", Request, Reply, Final)


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageConventions:
    """One implementation's choices. The default is pqsec's, which every stack accepts."""

    ends_names_in_nul: bool = True
    """Whether names end in NUL in a Request, and in a Reply unless `answers_in_kind`."""
    answers_in_kind: bool = True
    """Whether names in a Reply end in NUL if those of the Request did."""
    sends_optional: bool = True
    """Whether hash_c1, hash_c2 and the repeated dh1 and dh2 are sent."""
    reads_request_names: bool | None = None
    """Whether names in a Request must (True), must not (False) or may (None) end in NUL."""
    reads_reply_names: bool | None = None
    """Whether names in a Reply must (True), must not (False) or may (None) end in NUL."""
    needs_in_reply: tuple[str, ...] = ()
    """Optional properties that this reader requires in a Reply."""

    def written(self, message: Message) -> Message:
        """`message` as this side sends it."""
        return message if self.sends_optional else message.without_optional()

    def answers_with_nul(self, request: Request) -> bool:
        """Whether names end in NUL in the Reply to `request`."""
        if self.answers_in_kind:
            return request.introduction.ends_names_in_nul
        return self.ends_names_in_nul

    def problems(self, message: Request | Reply) -> Iterator[str]:
        """Reasons why this side refuses `message` although others accept it."""
        is_request = isinstance(message, Request)
        wanted = self.reads_request_names if is_request else self.reads_reply_names
        found = message.introduction.ends_names_in_nul
        if wanted not in (None, found):
            yield f"algorithm names {'end' if found else 'do not end'} in NUL"
        if not is_request:
            for name in self.needs_in_reply:
                if getattr(message, name) is None:
                    yield f"{name} is missing"


OURS = MessageConventions()
