"""What a self-check found, step by step."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from pqsec_pki.errors import FileError, MissingError, PqsecError, problems_of
from pqsec_pki.handshake import DataHolder, Done, GenericMessage
from pqsec_pki.problems import Code


@dataclass(frozen=True, slots=True)
class Step:
    """One thing that was checked. `detail` is what was found, or why it failed."""

    name: str
    ok: bool
    detail: str
    hint: str | None = None
    codes: frozenset[Code] = frozenset()
    """What is wrong, for programs, where it failed: which checks refused."""


AUTH_REQUEST = "auth request"
HANDSHAKE = ("request", "reply", "final")
"""The names of its messages."""
MESSAGE = "message"
"""The name of what is sent under the protection that follows."""


class StoppedError(Exception):
    """A step failed; the steps say which. It never leaves this room."""


@dataclass(frozen=True, slots=True)
class Steps:
    """The steps so far."""

    done: list[Step] = field(default_factory=list)

    @contextmanager
    def step(self, name: str) -> Iterator[list[str]]:
        """Run one step; what is put in the list is its detail. StoppedError if it fails.

        A file that cannot be read fails no step: whether it would hold is not known, and the
        FileError passes.
        """
        detail: list[str] = []
        try:
            yield detail
        except PqsecError as error:
            if isinstance(error, FileError) and not isinstance(error, MissingError):
                raise
            codes = frozenset(each.code for each in problems_of(error))
            self.done.append(Step(name, False, str(error), error.hint, codes))  # noqa: FBT003 -- field
            raise StoppedError from error
        self.done.append(Step(name, ok=True, detail="; ".join(detail)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Sent:
    """A message that went from one side to the other."""

    name: str
    sender: str
    receiver: str
    data: bytes = field(repr=False)
    """As it travels: a sample of a ParticipantGenericMessage, or protected submessages."""

    @property
    def token(self) -> DataHolder | None:
        """The token in it; None if it has none."""
        return None if self.name == MESSAGE else GenericMessage.decode(self.data).tokens[0]


class TopicFlow(NamedTuple):
    """The topics that one may publish and the other subscribe to."""

    sender: str
    receiver: str
    topics: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """For --json."""
        return {"from": self.sender, "to": self.receiver, "topics": list(self.topics)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """A handshake between two participants. What was not reached is None."""

    steps: tuple[Step, ...]
    initiator: str | None
    replier: str | None
    why: str | None
    """Why that one sends the Request."""
    stacks: dict[str, str]
    """How each participant behaved: the name of a stack."""
    signature: str | None
    """The signature algorithms of initiator and replier, as c.dsign_algo names them."""
    key_agreement: str
    """As c.kagree_algo names it."""
    milliseconds: float
    """The messages and the key exchange, both sides; checks before not counted."""
    sent: tuple[Sent, ...] = field(default=(), repr=False)
    outcome: Done | None = field(default=None, repr=False)
    """What the replier knows at the end."""

    domain: int | None = None
    """Where they met; None if they share none, or it was not looked for."""
    shared: tuple[int, ...] = ()
    """The domains that both may join."""
    talks: tuple[TopicFlow, ...] = ()
    """Both ways, once they have met."""

    @property
    def token_bytes(self) -> dict[str, int]:
        """Size of the DataHolder of each message: request, reply, final."""
        return {
            each.name: len(each.token.encode())
            for each in self.sent
            if each.name in HANDSHAKE and each.token
        }

    @property
    def ok(self) -> bool:
        """Whether every step was reached and held."""
        return all(step.ok for step in self.steps)

    @property
    def failed(self) -> Step | None:
        """The step that ended it, if one did."""
        return next((step for step in self.steps if not step.ok), None)

    def to_json(self) -> dict[str, Any]:
        """The report for --json."""
        return {
            "ok": self.ok,
            "initiator": self.initiator,
            "replier": self.replier,
            "why": self.why,
            "stacks": self.stacks,
            "signature": self.signature,
            "key_agreement": self.key_agreement,
            "token_bytes": self.token_bytes,
            "steps": [
                {"name": step.name, "ok": step.ok, "detail": step.detail}
                | ({"hint": step.hint} if step.hint else {})
                for step in self.steps
            ],
            "milliseconds": self.milliseconds,
            "domain": self.domain,
            "shared_domains": list(self.shared),
            "topic_flows": [each.to_json() for each in self.talks],
        }
