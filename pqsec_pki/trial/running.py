"""Participants of a stack on one loopback: they start together, and come to an end."""

import secrets
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass

from pqsec_pki.trial.network import Network, Wire, alone, watched
from pqsec_pki.trial.peer import Peer, PeerOutcome, Role, playing

_PAUSE = 0.05
_SETTLE = 1.0
"""Seconds that the others are given when one has ended; a stranger, at least."""
_SPARE = 30.0
"""Seconds after which a participant ends by itself, should nobody be left to end it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialSetup:
    """Where participants meet, and for how long."""

    program: Sequence[str]
    """What runs one participant."""
    domain: int
    topic: str
    timeout: float
    """Seconds to wait for the sample."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialRun:
    """How it went."""

    outcomes: tuple[PeerOutcome, ...]
    """In the order of the roles."""
    seconds: float
    """Until the first one, strangers apart, had ended, or until the time was over."""
    wire: Wire | None
    """None for who may not watch it."""
    alone: bool
    """Whether it was in a network of its own."""


def unique_text() -> str:
    """A text that is nowhere by chance."""
    return f"pqsec-trial-{secrets.token_hex(16)}"


def run_peers(setup: TrialSetup, roles: Sequence[Role]) -> TrialRun:
    """Run all roles at once, and watch the wire for what the first one sends.

    It is over when one that is no stranger ends: it has received, or its own stack refused, or
    it crashed. Strangers are then given as long again. At `scene.timeout` it is over in any
    case, and nothing of it is left running.
    """
    return alone(lambda network: _perform(setup, roles, network))


def _perform(setup: TrialSetup, roles: Sequence[Role], network: Network) -> TrialRun:
    with ExitStack() as stack:
        wire = stack.enter_context(watched(roles[0].text.encode()))
        peers = [
            stack.enter_context(
                playing(
                    setup.program,
                    role,
                    domain=setup.domain,
                    topic=setup.topic,
                    seconds=2 * setup.timeout + _SPARE,
                )
            )
            for role in roles
        ]
        seconds = _wait(peers, setup.timeout, network)
        outcomes = tuple(peer.outcome for peer in peers)
    return TrialRun(outcomes=outcomes, seconds=seconds, wire=wire, alone=network.is_alone)


def _wait(peers: Sequence[Peer], timeout: float, network: Network) -> float:
    """Seconds until the first one, strangers apart, ended; no more than `timeout`."""
    start = time.monotonic()
    waited_for = [peer for peer in peers if not peer.role.unauthenticated]
    while network.pause(_PAUSE) and (spent := time.monotonic() - start) < timeout:
        ended = [peer for peer in waited_for if peer.ended]
        if any(peer.refused for peer in ended):
            _let_speak(waited_for, network)
            return spent
        if ended:
            if waited_for != peers:
                network.pause(max(_SETTLE, spent))
            return spent
    return timeout


def _let_speak(peers: Sequence[Peer], network: Network) -> None:
    """The stack of the other may be about to refuse too."""
    end = time.monotonic() + _SETTLE
    while network.pause(_PAUSE) and time.monotonic() < end:
        if all(peer.ended for peer in peers):
            return
