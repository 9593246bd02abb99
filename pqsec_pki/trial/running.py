"""Runs participants of a stack together on one loopback."""

import secrets
import time
from collections.abc import Sequence
from contextlib import ExitStack

from pqsec_pki._dataclass import dataclass
from pqsec_pki.trial.network import Network, Wire, alone, watched
from pqsec_pki.trial.peer import PeerOutcome, PeerProcess, TrialRole, running_peer

_PAUSE = 0.05
_SETTLE = 1.0
"""Seconds that other participants get after one has ended; for unauthenticated peers the
minimum."""
_SPARE = 30.0
"""Further seconds after which a participant ends by itself, if the trial was killed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialSetup:
    """The program, domain, topic and time limit of a trial."""

    program: Sequence[str]
    """The command line of one participant, without its arguments."""
    domain: int
    topic: str
    timeout: float
    """Seconds to wait for the sample."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialRun:
    """The result of running all participants."""

    outcomes: tuple[PeerOutcome, ...]
    """In the order of the roles."""
    seconds: float
    """Until the first authenticated participant ended, or the time limit."""
    wire: Wire | None
    """None if capturing is forbidden."""
    alone: bool
    """Whether the trial had its own network."""


def unique_text() -> str:
    """A random text, which is on the wire only if it was sent unencrypted."""
    return f"pqsec-trial-{secrets.token_hex(16)}"


def run_peers(setup: TrialSetup, roles: Sequence[TrialRole]) -> TrialRun:
    """Run all roles together, and search the wire for the text that the first one sends.

    The run is over when an authenticated participant ends: it has received the sample, its own
    stack refused, or it crashed. Unauthenticated ones then get the same time again. At
    `setup.timeout` the run is over in any case, and all processes are killed.
    """
    return alone(lambda network: _run_peers(setup, roles, network))


def _run_peers(setup: TrialSetup, roles: Sequence[TrialRole], network: Network) -> TrialRun:
    with ExitStack() as stack:
        wire = stack.enter_context(watched(roles[0].text.encode()))
        peers = [
            stack.enter_context(
                running_peer(
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


def _wait(peers: Sequence[PeerProcess], timeout: float, network: Network) -> float:
    """Seconds until the first authenticated participant ended; at most `timeout`."""
    start = time.monotonic()
    waited_for = [peer for peer in peers if not peer.role.unauthenticated]
    while network.pause(_PAUSE) and (spent := time.monotonic() - start) < timeout:
        ended = [peer for peer in waited_for if peer.ended]
        if any(peer.refused for peer in ended):
            _settle(waited_for, network)
            return spent
        if ended:
            if waited_for != peers:
                network.pause(max(_SETTLE, spent))
            return spent
    return timeout


def _settle(peers: Sequence[PeerProcess], network: Network) -> None:
    """Wait for the other participant: its stack may refuse too."""
    end = time.monotonic() + _SETTLE
    while network.pause(_PAUSE) and time.monotonic() < end:
        if all(peer.ended for peer in peers):
            return
