"""Both sides of a handshake by Cyclone DDS's own security plugin, for bench/handshake.py.

Only the time inside the plugin's C functions counts: what ctypes needs to hand messages
over does not, and nobody encodes them to bytes.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tries import Spent

from tests.interop.cyclone import Meeting, Participant, find_plugins
from tests.interop.cyclone_abi import ACCESS_CONTROL, AUTHENTICATION, started

__all__ = ["both_sides", "find_plugins"]

DOMAIN = 0


class _Stopwatch:
    """A plugin's functions, and the CPU seconds spent in them."""

    def __init__(self, functions: Any) -> None:
        self._functions = functions
        self.seconds = 0.0

    def __getattr__(self, name: str) -> Callable[..., int]:
        function = getattr(self._functions, name)

        def timed(*arguments: Any) -> int:
            start = time.thread_time()
            result: int = function(*arguments)
            self.seconds += time.thread_time() - start
            return result

        return timed


@dataclass(frozen=True)
class _Side:
    participant: Participant
    stopwatch: _Stopwatch

    def meet(self, other: "_Side") -> Meeting:
        peer = other.participant
        return self.participant.meet(peer.guid, peer.identity_token)


@contextmanager
def both_sides(plugins: Path, first: Path, second: Path) -> Iterator[Callable[[], Spent]]:
    """A function that runs one handshake between the participants in these two folders.

    Optional properties are sent, as pqsec sends them.
    """
    with ExitStack() as stack:
        one, other = (stack.enter_context(_side(plugins, folder)) for folder in (first, second))
        if not one.meet(other).begins:
            one, other = other, one
        there, here = one.meet(other), other.meet(one)

        def run() -> Spent:
            one.stopwatch.seconds = other.stopwatch.seconds = 0.0
            begun, request = one.participant.request(there)
            answered, reply = other.participant.reply(here, request)
            final = one.participant.process(begun, reply)
            other.participant.process(answered, final)
            assert one.participant.secret(begun) == other.participant.secret(answered)
            return Spent(tries=0, rest=one.stopwatch.seconds + other.stopwatch.seconds)

        yield run


@contextmanager
def _side(plugins: Path, folder: Path) -> Iterator[_Side]:
    authentication, access = (plugins / f"libdds_security_{name}.so" for name in ("auth", "ac"))
    with (
        started(authentication, "authentication", AUTHENTICATION, optional=True) as plugin,
        started(access, "access_control", ACCESS_CONTROL) as control,
    ):
        stopwatch = _Stopwatch(plugin.functions)
        participant = Participant(replace(plugin, functions=stopwatch), control, folder, "")
        participant.show(*participant.join(DOMAIN))
        yield _Side(participant, stopwatch)
