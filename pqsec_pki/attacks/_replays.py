"""The attacker on the way sends recorded messages again, to their sender or their receiver."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

from pqsec_pki._dataclass import dataclass
from pqsec_pki.attacks._context import AttackContext, Attempt, token_in, value_in
from pqsec_pki.attacks._relays import instead, on, putting
from pqsec_pki.attacks.attack import COVERED, TRANSCRIPT, Attack, Attacker
from pqsec_pki.handshake import DataHolder, Introduction, Request, reply_to
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck import AUTH_REQUEST, HANDSHAKE, MESSAGE, Relay


def reflect(context: AttackContext) -> Iterator[Attempt]:
    """Send a side its own credentials."""
    for message, other, hashed in (
        ("request", "reply", "hash_c1"),
        ("reply", "request", "hash_c2"),
    ):
        values = {name: context.value(other, name) for name in Introduction.NAMES}
        relay = putting(message, {**values, hashed: None})
        yield context.between(f"its own credentials, in the {message}", relay)


def reflect_message(context: AttackContext) -> Iterator[Attempt]:
    """Send a side its own protected message: it can decrypt it, as there is one key for both."""
    yield context.between("the initiator's, in the place of the replier's", _Echo())


@dataclass(slots=True)
class _Echo:
    """Sends the protected message of the first side to the second, and back to the first."""

    first: bytes = b""

    def __call__(self, name: str, data: bytes) -> bytes:
        if name != MESSAGE:
            return data
        self.first = self.first or data
        return self.first


def replay(context: AttackContext) -> Iterator[Attempt]:
    """Replay one message of an earlier handshake, or all messages of one side."""
    for name in HANDSHAKE:
        yield context.between(f"the {name}", _replayed(context, name))
    of_initiator = [_replayed(context, name) for name in (AUTH_REQUEST, "request", "final")]
    yield context.between("all that the initiator sent", _Beside(context), *of_initiator)
    of_replier = _replayed(context, AUTH_REQUEST, 2), _replayed(context, "reply")
    yield context.between("all that the replier sent", *of_replier)
    for occurrence, side in enumerate(context.session.sides, start=1):
        message = on(MESSAGE, partial(_recorded, context, occurrence), occurrence)
        yield context.between(f"what {side.name} sent under the earlier keys", message)


def _replayed(context: AttackContext, name: str, occurrence: int = 1) -> Relay:
    return instead(name, context.token(name, occurrence), occurrence)


def _recorded(context: AttackContext, occurrence: int, data: bytes) -> bytes:
    del data
    return context.message(MESSAGE, occurrence)


@dataclass(slots=True)
class _Beside:
    """Runs a handshake with the initiator, beside the replayed one."""

    context: AttackContext
    request: bytes = b""

    def __call__(self, name: str, data: bytes) -> bytes:
        if name == "request":
            self.request = data
        if name == "reply":
            return instead(name, self._answer(value_in(data, "challenge2")))(name, data)
        return data

    def _answer(self, challenge2: bytes) -> DataHolder:
        """The replier's token, as an answer to the initiator's new Request."""
        session = self.context.session
        terms = replace(session.replier.terms, announced=challenge2)
        request = Request.from_holder(token_in(self.request))
        return reply_to(terms, request, now=session.now)[0].to_holder()


ATTACKS = (
    Attack(
        name="reflect",
        attacker=Attacker.ON_THE_WAY,
        title="sends a participant its own certificate back, as if it were its own peer",
        refused_at=("reply", "final"),
        checks=(Code.C12, Code.C13, Code.C29),
        also=TRANSCRIPT,
        because=COVERED,
        act=reflect,
    ),
    Attack(
        name="reflect-message",
        attacker=Attacker.ON_THE_WAY,
        title="sends a participant its own first encrypted message back",
        refused_at=("message",),
        checks=(Code.C26,),
        act=reflect_message,
    ),
    Attack(
        name="replay",
        attacker=Attacker.ON_THE_WAY,
        title="replays an earlier handshake, one message or all messages of a side",
        refused_at=("reply", "final", "authenticated", "message"),
        checks=(Code.C14, Code.C19, Code.C20, Code.C23, Code.C26),
        also=TRANSCRIPT,
        because="a replay needs all values that the signatures of the earlier handshake cover",
        act=replay,
    ),
)
