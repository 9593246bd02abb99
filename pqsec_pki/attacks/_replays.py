"""The attacker on the way repeats what it heard, to the one who said it or to the other."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

from pqsec_pki.attacks._context import AttackContext, Attempt, token_in, value_in
from pqsec_pki.attacks._relays import instead, on, putting
from pqsec_pki.attacks.attack import COVERED, TRANSCRIPT, Attack, Attacker
from pqsec_pki.handshake import DataHolder, Introduction, Request, reply_to
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck.report import AUTH_REQUEST, HANDSHAKE, MESSAGE
from pqsec_pki.selfcheck.session import Relay


def reflect(context: AttackContext) -> Iterator[Attempt]:
    """A side meets itself."""
    for message, other, hashed in (
        ("request", "reply", "hash_c1"),
        ("reply", "request", "hash_c2"),
    ):
        values = {name: context.value(other, name) for name in Introduction.NAMES}
        relay = putting(message, {**values, hashed: None})
        yield context.between(f"its own credentials, in the {message}", relay)


def reflect_message(context: AttackContext) -> Iterator[Attempt]:
    """The key is the same both ways, so what a side sent opens for that side too."""
    yield context.between("the initiator's, in the place of the replier's", _Echo())


@dataclass(slots=True)
class _Echo:
    """Sends what the first of two said under protection to the second, and back to it."""

    first: bytes = b""

    def __call__(self, name: str, data: bytes) -> bytes:
        if name != MESSAGE:
            return data
        self.first = self.first or data
        return self.first


def replay(context: AttackContext) -> Iterator[Attempt]:
    """One message of an earlier handshake, or all that one side said in it."""
    for name in HANDSHAKE:
        yield context.between(f"the {name}", _again(context, name))
    of_initiator = [_again(context, name) for name in (AUTH_REQUEST, "request", "final")]
    yield context.between("all that the initiator said", _Beside(context), *of_initiator)
    of_replier = _again(context, AUTH_REQUEST, 2), _again(context, "reply")
    yield context.between("all that the replier said", *of_replier)
    for occurrence, side in enumerate(context.session.sides, start=1):
        message = on(MESSAGE, partial(_heard, context, occurrence), occurrence)
        yield context.between(f"what {side.name} sent under the keys of then", message)


def _again(context: AttackContext, name: str, occurrence: int = 1) -> Relay:
    return instead(name, context.token(name, occurrence), occurrence)


def _heard(context: AttackContext, occurrence: int, data: bytes) -> bytes:
    del data
    return context.heard(MESSAGE, occurrence)


@dataclass(slots=True)
class _Beside:
    """Keeps the initiator busy with a handshake of its own, beside the replayed one."""

    context: AttackContext
    request: bytes = b""

    def __call__(self, name: str, data: bytes) -> bytes:
        if name == "request":
            self.request = data
        if name == "reply":
            return instead(name, self._answer(value_in(data, "challenge2")))(name, data)
        return data

    def _answer(self, challenge2: bytes) -> DataHolder:
        """The replier's, to what the initiator really asked."""
        session = self.context.session
        terms = replace(session.replier.terms, announced=challenge2)
        request = Request.from_holder(token_in(self.request))
        return reply_to(terms, request, now=session.now)[0].to_holder()


ATTACKS = (
    Attack(
        name="reflect",
        attacker=Attacker.ON_THE_WAY,
        title="sends a participant its own certificate back, so that it meets itself",
        refused_at=("reply", "final"),
        checks=(Code.C12, Code.C13),
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
        title="repeats what it recorded of an earlier handshake, piece by piece or all of it",
        refused_at=("reply", "final", "authenticated", "message"),
        checks=(Code.C14, Code.C19, Code.C20, Code.C23, Code.C26),
        also=TRANSCRIPT,
        because="of an earlier handshake all has to be replayed that its signatures cover",
        act=replay,
    ),
)
