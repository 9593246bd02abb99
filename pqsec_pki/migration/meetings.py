"""Whether two participants can meet, also of different generations: by running their handshake."""

from contextlib import suppress
from datetime import datetime

from pqsec_pki._dataclass import dataclass
from pqsec_pki.keystore import Keystore
from pqsec_pki.selfcheck import (
    CheckedStep,
    HandshakeCheck,
    HandshakeSetup,
    LoadedParty,
    SimulatedStack,
    StoppedError,
    check_party,
    load_party,
)


@dataclass(frozen=True, slots=True)
class Side:
    """A participant with the files of one generation, in one stack."""

    keystore: Keystore
    name: str
    stack: SimulatedStack


def failure(one: Side, other: Side, domain: int, now: datetime) -> CheckedStep | None:
    """The step at which two sides fail to authenticate each other; None if they succeed.

    Each first checks its own files, as its stack does at start.
    """
    check = HandshakeCheck(HandshakeSetup(keystore=one.keystore, domain=domain, now=now))
    with suppress(StoppedError):
        parties = []
        for side in (one, other):
            setup = HandshakeSetup(keystore=side.keystore, domain=domain, now=now)
            party = LoadedParty(load_party(setup, side.name, check.steps), side.stack)
            check_party(setup, party, check.steps)
            parties.append(party)
        check.perform(check.pair(*parties))
    return check.report().failed
