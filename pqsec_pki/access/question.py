"""A question about access: may this subject do this action, on this domain, at this time?"""

from datetime import UTC, datetime
from enum import StrEnum

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import UsageError

MAX_NAME = 256
"""Characters of a topic name (RTPS 2.3, table 9.12), and in pqsec also of a partition.

Cyclone DDS does not check it: its version 0.10.2 carries a topic of 2000 (run). Such a question is
refused, since the limit also bounds what a pattern costs (`_patterns.LONGEST`).
"""


class Action(StrEnum):
    """What a participant wants to do; all actions but `join` need a topic."""

    PUBLISH = "publish"
    SUBSCRIBE = "subscribe"
    RELAY = "relay"
    JOIN = "join"


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """May `subject` do `action` on `domain` at the time `now`?

    `subject` is the subject of the identity certificate, as RFC 2253 text, as in
    Certificate.subject_name. `topic` is the name in DDS (`rt/chatter`), and None only for
    `join`. `partitions` and `data_tags` are those of the endpoint; no partition means the
    default partition, whose name is empty.

    UsageError if the time has no zone, if the topic is missing, empty or given for `join`,
    and if a name is longer than 256 characters.
    """

    subject: str
    domain: int
    action: Action
    now: datetime
    topic: str | None = None
    partitions: tuple[str, ...] = ()
    data_tags: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        if self.now.tzinfo is not UTC:
            if self.now.utcoffset() is None:
                raise UsageError(f"the time {self.now} has no time zone")
            object.__setattr__(self, "now", self.now.astimezone(UTC))
        if (self.topic is None) is not (self.action is Action.JOIN):
            raise UsageError(
                f"`{self.action}` {'needs a' if self.topic is None else 'has no'} topic"
            )
        if self.topic == "":
            raise UsageError("the topic's name is empty")
        if len(max((self.topic or "", *self.partitions), key=len)) > MAX_NAME:
            raise UsageError(
                f"a name is longer than {MAX_NAME} characters",
                hint="RTPS allows no longer topic; Cyclone DDS takes one, and pqsec has no answer",
            )
