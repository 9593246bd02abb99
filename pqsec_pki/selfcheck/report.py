"""The report of a self-check, step by step."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import field
from typing import Any, NamedTuple

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import FileError, MissingError, PqsecError, problems_of
from pqsec_pki.handshake import DataHolder, Done, GenericMessage
from pqsec_pki.problems import Code


@dataclass(frozen=True, slots=True)
class CheckedStep:
    """One check. `detail` is what was found, or why it failed."""

    name: str
    ok: bool
    detail: str
    hint: str | None = None
    codes: frozenset[Code] = frozenset()
    """Codes of the checks that failed; empty if the step succeeded."""

    @property
    def fault(self) -> dict[str, str | None]:
        """The fault for --json, if the step failed."""
        return {"step": self.name, "cause": self.detail, "hint": self.hint}


AUTH_REQUEST = "auth request"
HANDSHAKE = ("request", "reply", "final")
"""The names of the handshake's messages."""
MESSAGE = "message"
"""The name of the protected message after the handshake."""


class StoppedError(Exception):
    """A step failed, the last of the steps. This error never leaves the room."""


@dataclass(frozen=True, slots=True)
class Steps:
    """The steps that were run so far."""

    done: list[CheckedStep] = field(default_factory=list)

    @contextmanager
    def step(self, name: str) -> Iterator[list[str]]:
        """Run one step; the caller appends its detail to the list. StoppedError if it fails.

        A FileError passes through and fails no step: an unreadable file is neither valid
        nor invalid.
        """
        detail: list[str] = []
        try:
            yield detail
        except PqsecError as error:
            if isinstance(error, FileError) and not isinstance(error, MissingError):
                raise
            codes = frozenset(each.code for each in problems_of(error))
            self.done.append(CheckedStep(name, False, str(error), error.hint, codes))  # noqa: FBT003 -- field
            raise StoppedError from error
        self.done.append(CheckedStep(name, ok=True, detail="; ".join(detail)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Sent:
    """A message that went from one side to the other."""

    name: str
    sender: str
    receiver: str
    data: bytes = field(repr=False)
    """What is sent: a sample of a ParticipantGenericMessage, or protected submessages."""

    @property
    def token(self) -> DataHolder | None:
        """The token in the message; None for protected submessages."""
        return None if self.name == MESSAGE else GenericMessage.decode(self.data).tokens[0]


class TopicFlow(NamedTuple):
    """The topics that one may publish and the other subscribe to."""

    sender: str
    receiver: str
    topics: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """The two names and the topics, for --json."""
        return {"from": self.sender, "to": self.receiver, "topics": list(self.topics)}


@dataclass(frozen=True, slots=True, kw_only=True)
class HandshakeReport:
    """A handshake between two participants. What was not reached is None."""

    steps: tuple[CheckedStep, ...]
    initiator: str | None
    replier: str | None
    why: str | None
    """Why the initiator is the one that sends the Request."""
    stacks: dict[str, str]
    """The name of the stack that each participant behaves like."""
    signature: str | None
    """The names of the signature algorithms of initiator and replier, as in c.dsign_algo."""
    key_agreement: str
    """Its name in c.kagree_algo."""
    milliseconds: float
    """Time of the messages and the key exchange, both sides, without the checks before them."""
    sent: tuple[Sent, ...] = field(default=(), repr=False)
    outcome: Done | None = field(default=None, repr=False)
    """The result of the replier."""

    domain: int | None = None
    """The domain ID of the handshake; None if they share none, or it was not determined."""
    shared: tuple[int, ...] = ()
    """The domains that both may join."""
    talks: tuple[TopicFlow, ...] = ()
    """In both directions, if the handshake succeeded."""

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
        """Whether all steps were reached and succeeded."""
        return all(step.ok for step in self.steps)

    @property
    def failed(self) -> CheckedStep | None:
        """The step that failed, if any."""
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
