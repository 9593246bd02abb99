"""Two participants of one stack, Cyclone DDS or Fast DDS, that meet with the files they have."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.interop.cyclone import participant as cyclone_participant
from tests.interop.fastdds import participant as fastdds_participant

DOMAIN = 0
STACKS = ("cyclone", "fastdds")

Starts = Callable[[Path], Any]


@contextmanager
def participants_of(stack: str, request: pytest.FixtureRequest) -> Iterator[Starts]:
    """What makes a participant of `stack` from the folder of its files, until the test ends."""
    if stack == "cyclone":
        make = partial(cyclone_participant, request.getfixturevalue("plugins"))
    else:
        make = partial(fastdds_participant, request.getfixturevalue("fastdds"))
    with ExitStack() as opened:
        yield lambda folder: opened.enter_context(make(folder))


def shake_hands(starts: Starts, first: Path, second: Path) -> Callable[[], None]:
    """Both join, hear of each other, and shake hands; RefusedError where that fails.

    What is returned lets each check the permissions that the other showed.
    """
    a, b = starts(first), starts(second)
    shown = {}
    for each in (a, b):
        credential, shown[each] = each.join(DOMAIN)
        each.show(credential, shown[each])
    of_b = a.meet(b.guid, b.identity_token)
    of_a = b.meet(a.guid, a.identity_token, of_b.auth_request)
    sides = [(a, of_b), (b, of_a)] if of_b.begins else [(b, of_a), (a, of_b)]
    (initiator, of_replier), (replier, of_initiator) = sides
    begun, request = initiator.request(of_replier)
    answered, reply = replier.reply(of_initiator, request)
    replier.process(answered, initiator.process(begun, reply))

    def admit() -> None:
        initiator.admit(of_replier, begun, shown[replier])
        replier.admit(of_initiator, answered, shown[initiator])

    return admit


def meet(starts: Starts, first: Path, second: Path) -> None:
    """Both shake hands and let each other in; RefusedError if not."""
    shake_hands(starts, first, second)()
