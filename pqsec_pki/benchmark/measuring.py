"""Rounds of a handshake, each operation timed; every message passes as bytes."""

import gc
import signal
import time
import tracemalloc
from collections.abc import Callable
from contextlib import suppress
from datetime import datetime
from typing import ParamSpec, TypeVar

from pqsec_pki.algorithms import KeyAgreement
from pqsec_pki.benchmark.participants import MeasuredParticipants
from pqsec_pki.benchmark.results import HandshakeSizes, MeasuredSuite, Operation, Timing
from pqsec_pki.benchmark.suites import HandshakeSuite
from pqsec_pki.errors import VerificationError
from pqsec_pki.handshake import (
    GUID_SIZE,
    DataHolder,
    Discovered,
    Done,
    Final,
    GenericMessage,
    MessageClass,
    PeerRequirements,
    Reply,
    ReplySent,
    Request,
    RequestSent,
    Terms,
    begin,
    reply_to,
)

Value = TypeVar("Value")
Given = ParamSpec("Given")
Round = dict[Operation, Timing]


class _Clock:
    """Times the operations of one round."""

    def __init__(self) -> None:
        self.taken: Round = {}

    def time(
        self,
        operation: Operation,
        run: Callable[Given, Value],
        *given: Given.args,
        **named: Given.kwargs,
    ) -> Value:
        wall, cpu = time.perf_counter_ns(), time.thread_time_ns()
        value = run(*given, **named)
        cpu, wall = time.thread_time_ns() - cpu, time.perf_counter_ns() - wall
        self.taken[operation] = Timing(wall, cpu)
        return value


def measured_rounds(
    suite: HandshakeSuite,
    *,
    rounds: int,
    warm_up: int,
    now: datetime,
    each: Callable[[int], None] = lambda _: None,
) -> MeasuredSuite | None:
    """Run `warm_up` handshakes and measure `rounds` more; call `each` with 1 after every one.

    No peer is remembered: each round reads and verifies both certificates and makes new keys for
    the key agreement. KeyboardInterrupt ends it with the rounds that were measured, or None if
    there is none: see `MeasuredSuite.rounds`. VerificationError if a handshake fails.
    """
    found: list[Round] = []
    with suppress(KeyboardInterrupt):
        participants = MeasuredParticipants.of(suite, now)
        for _ in range(warm_up):
            _handshake(participants, suite, now)
            each(1)
        memory, messages = _memory(participants, suite, now)
        for _ in range(rounds):
            found.append(_undisturbed(participants, suite, now))
            each(1)
    if not found:
        return None
    return MeasuredSuite(suite, tuple(found), _sizes(messages), memory)


def _undisturbed(participants: MeasuredParticipants, suite: HandshakeSuite, now: datetime) -> Round:
    """Python's garbage collector and timers run between rounds only."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})
    gc.disable()
    try:
        taken, _ = _handshake(participants, suite, now)
    finally:
        gc.enable()
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return taken


def _handshake(
    participants: MeasuredParticipants, suite: HandshakeSuite, now: datetime
) -> tuple[Round, tuple[bytes, ...]]:
    """The time of each operation, and the three tokens."""
    one, other = participants.initiator, participants.responder
    policy = PeerRequirements(
        agreements=(suite.agreement,),
        versions=(suite.version,),
        require_alternative=suite.alternative is not None,
    )
    ours = Terms(own=one, policy=policy, discovered=Discovered(guid=other.guid))
    theirs = Terms(own=other, policy=policy, discovered=Discovered(guid=one.guid))
    clock = _Clock()
    request, waiting = clock.time(Operation.REQUEST, _begun, ours, suite.agreement)
    reply, awaiting = clock.time(Operation.REPLY, _replied, theirs, request, now)
    final, done = clock.time(Operation.FINAL, _answered, waiting, reply, now)
    ended = clock.time(Operation.END, _ended, awaiting, final)
    if ended.shared_secret != done.shared_secret:
        raise VerificationError(f"{suite}: the two sides do not agree on a secret")
    return clock.taken, (request, reply, final)


def _begun(terms: Terms, agreement: KeyAgreement) -> tuple[bytes, RequestSent]:
    request, waiting = begin(terms, agreement)
    return request.to_holder().encode(), waiting


def _replied(terms: Terms, request: bytes, now: datetime) -> tuple[bytes, ReplySent]:
    reply, awaiting = reply_to(terms, Request.from_holder(DataHolder.decode(request)), now=now)
    return reply.to_holder().encode(), awaiting


def _answered(waiting: RequestSent, reply: bytes, now: datetime) -> tuple[bytes, Done]:
    final, done = waiting.receive(Reply.from_holder(DataHolder.decode(reply)), now=now)
    return final.to_holder().encode(), done


def _ended(awaiting: ReplySent, final: bytes) -> Done:
    return awaiting.receive(Final.from_holder(DataHolder.decode(final)))


def _memory(
    participants: MeasuredParticipants, suite: HandshakeSuite, now: datetime
) -> tuple[int, tuple[bytes, ...]]:
    """The most that Python holds in a handshake, in bytes, and the three tokens."""
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        _, messages = _handshake(participants, suite, now)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    return most - before, messages


def _sizes(tokens: tuple[bytes, ...]) -> HandshakeSizes:
    request, reply, final = tokens
    return HandshakeSizes(
        (len(request), len(reply), len(final)), (_sample(request), _sample(reply), _sample(final))
    )


def _sample(token: bytes) -> int:
    """Bytes of the ParticipantGenericMessage that carries a token (7.4.4.3)."""
    message = GenericMessage(
        source=bytes(GUID_SIZE),
        sequence=1,
        destination_participant=bytes(GUID_SIZE),
        class_id=MessageClass.HANDSHAKE,
        tokens=(DataHolder.decode(token),),
    )
    return len(message.encode())
