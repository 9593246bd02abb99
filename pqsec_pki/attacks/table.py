"""The attacks that a domain must withstand; the rows stand beside what they do.

For `pqsec verify-handshake --attack`: what is done to two participants of a keystore who
would meet, with their own credentials, and where it has to fail.
"""

from pqsec_pki.attacks import (
    _between,
    _impostors,
    _insiders,
    _meddling,
    _misdelivery,
    _replays,
    _tampering,
)
from pqsec_pki.attacks.attack import Attack
from pqsec_pki.errors import UnknownAlgorithmError

ATTACKS: tuple[Attack, ...] = (
    *_tampering.ATTACKS,
    *_misdelivery.ATTACKS,
    *_meddling.ATTACKS,
    *_replays.ATTACKS,
    *_impostors.ATTACKS,
    *_insiders.ATTACKS,
    *_between.ATTACKS,
)


def attack_named(name: str) -> Attack:
    """The attack a user means; UnknownAlgorithmError, with those there are, if it is none."""
    for row in ATTACKS:
        if row.name == name.lower():
            return row
    known = ", ".join(row.name for row in ATTACKS)
    raise UnknownAlgorithmError(f"no attack named {name!r}", hint=f"known: all, {known}")
