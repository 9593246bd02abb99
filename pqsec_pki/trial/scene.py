"""Participants of a stack on one loopback: they start together, and come to an end."""

import secrets
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass

from pqsec_pki.trial.network import Place, Wire, alone, watched
from pqsec_pki.trial.peer import Account, Peer, Role, playing

_PAUSE = 0.05
_SETTLE = 1.0
"""Seconds that the others are given when one has ended; a stranger, at least."""
_SPARE = 30.0
"""Seconds after which a participant ends by itself, should nobody be left to end it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """Where participants meet, and for how long."""

    program: Sequence[str]
    """What runs one participant."""
    domain: int
    topic: str
    timeout: float
    """Seconds to wait for the sample."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Performance:
    """How it went."""

    accounts: tuple[Account, ...]
    """In the order of the roles."""
    seconds: float
    """Until the first one, strangers apart, had ended, or until the time was over."""
    wire: Wire | None
    """None for who may not watch it."""
    alone: bool
    """Whether it was in a network of its own."""


def mark() -> str:
    """A text that is nowhere by chance."""
    return f"pqsec-trial-{secrets.token_hex(16)}"


def perform(scene: Scene, roles: Sequence[Role]) -> Performance:
    """Run all roles at once, and watch the wire for what the first one sends.

    It is over when one that is no stranger ends: it has received, or its own stack refused, or
    it crashed. Strangers are then given as long again. At `scene.timeout` it is over in any
    case, and nothing of it is left running.
    """
    return alone(lambda place: _perform(scene, roles, place))


def _perform(scene: Scene, roles: Sequence[Role], place: Place) -> Performance:
    with ExitStack() as stack:
        wire = stack.enter_context(watched(roles[0].text.encode()))
        peers = [
            stack.enter_context(
                playing(
                    scene.program,
                    role,
                    domain=scene.domain,
                    topic=scene.topic,
                    seconds=2 * scene.timeout + _SPARE,
                )
            )
            for role in roles
        ]
        seconds = _wait(peers, scene.timeout, place)
        accounts = tuple(peer.account for peer in peers)
    return Performance(accounts=accounts, seconds=seconds, wire=wire, alone=place.is_alone)


def _wait(peers: Sequence[Peer], timeout: float, place: Place) -> float:
    """Seconds until the first one, strangers apart, ended; no more than `timeout`."""
    start = time.monotonic()
    waited_for = [peer for peer in peers if not peer.role.stranger]
    while place.pause(_PAUSE) and (spent := time.monotonic() - start) < timeout:
        ended = [peer for peer in waited_for if peer.ended]
        if any(peer.refused for peer in ended):
            _let_speak(waited_for, place)
            return spent
        if ended:
            if waited_for != peers:
                place.pause(max(_SETTLE, spent))
            return spent
    return timeout


def _let_speak(peers: Sequence[Peer], place: Place) -> None:
    """The stack of the other may be about to refuse too."""
    end = time.monotonic() + _SETTLE
    while place.pause(_PAUSE) and time.monotonic() < end:
        if all(peer.ended for peer in peers):
            return
