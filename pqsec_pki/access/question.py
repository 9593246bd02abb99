"""A question about access: may this subject do that, there and then?"""

from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum

from pqsec_pki.errors import UsageError

MAX_NAME = 256
"""Characters of a topic name, as RTPS has it (2.3, table 9.12), and here of a partition."""


class Action(StrEnum):
    """What a participant wants to do; all but `join` are done with a topic."""

    PUBLISH = "publish"
    SUBSCRIBE = "subscribe"
    RELAY = "relay"
    JOIN = "join"


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """May `subject` do `action` on `domain` at the time `now`?

    `subject` is the subject of the identity certificate in the text of RFC 2253, as
    Certificate.subject_name has it. `topic` is the name in DDS (`rt/chatter`) and is
    None for `join` alone. `partitions` and `data_tags` are those of the endpoint; no
    partition means the default one, whose name is empty.

    UsageError for a time without a zone, a topic that is missing, empty or superfluous,
    and a name longer than 256 characters.
    """

    subject: str
    domain: int
    action: Action
    now: datetime
    topic: str | None = None
    partitions: tuple[str, ...] = ()
    data_tags: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        if self.now.utcoffset() is None:
            raise UsageError(f"the time {self.now} has no time zone")
        object.__setattr__(self, "now", self.now.astimezone(UTC))
        if (self.topic is None) is not (self.action is Action.JOIN):
            raise UsageError(
                f"`{self.action}` is asked {'of' if self.topic is None else 'without'} a topic"
            )
        if self.topic == "":
            raise UsageError("a topic has a name")
        if any(len(name) > MAX_NAME for name in (self.topic or "", *self.partitions)):
            raise UsageError(f"a name is longer than {MAX_NAME} characters")
