"""Two participants with only their plugins; the messages between them are the test's."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.interop.cyclone import Meeting, Participant, Token
from tests.interop.cyclone import participant as cyclone_participant
from tests.interop.fastdds import participant as fastdds_participant
from tests.interop.fastdds_shim import FastDdsShim

DOMAIN = 0

Plugins = Path | FastDdsShim
"""The folder of Cyclone DDS's, or Fast DDS's behind the tests' shim."""
Relay = Callable[[str, Token], Token]


def faithful(name: str, token: Token) -> Token:
    """What an honest network does."""
    return token


@dataclass(frozen=True)
class Side:
    """A participant that has heard of the other."""

    participant: Participant
    permissions: Token
    meeting: Meeting


@dataclass(frozen=True)
class Couple:
    """Two that have heard of each other; the first has the smaller GUID."""

    first: Side
    second: Side

    def shake_hands(self, relay: Relay = faithful) -> tuple[int, int]:
        """The handles of both ends of their handshake."""
        one, other = self.first, self.second
        begun, request = one.participant.request(one.meeting)
        answered, reply = other.participant.reply(other.meeting, relay("request", request))
        final = one.participant.process(begun, relay("reply", reply))
        assert final is not None
        assert other.participant.process(answered, relay("final", final)) is None
        return begun, answered

    def agree(self, handshakes: tuple[int, int]) -> None:
        """Both have the same secret, and let each other in."""
        one, other = self.first, self.second
        begun, answered = handshakes
        assert one.participant.secret(begun) == other.participant.secret(answered)
        one.participant.admit(one.meeting, begun, other.permissions)
        other.participant.admit(other.meeting, answered, one.permissions)


@contextmanager
def couple(*sides: tuple[Plugins, Path], announce: bool = True) -> Iterator[Couple]:
    """Of each side its plugins, and its enclave.

    With `announce`, each has heard the other's AuthRequest.
    """
    with ExitStack() as stack:
        ready = [stack.enter_context(_ready(plugins, enclave)) for plugins, enclave in sides]
        ready.sort(key=lambda each: each[0].guid)
        yield _met(*ready, announce=announce)


@contextmanager
def _ready(plugins: Plugins, enclave: Path) -> Iterator[tuple[Participant, Token]]:
    start = cyclone_participant if isinstance(plugins, Path) else fastdds_participant
    with start(plugins, enclave) as one:
        credential, token = one.join(DOMAIN)
        one.show(credential, token)
        yield one, token


def _met(one: tuple[Participant, Token], other: tuple[Participant, Token], *, announce: bool):
    first, second = one[0], other[0]
    seen = second.meet(first.guid, first.identity_token)
    request = seen.auth_request if announce else None
    known = first.meet(second.guid, second.identity_token, request)
    assert (known.begins, seen.begins) == (True, False)
    return Couple(Side(first, one[1], known), Side(second, other[1], seen))
