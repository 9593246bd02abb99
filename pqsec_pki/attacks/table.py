"""The table of all attacks; each row is beside the function that carries it out.

For `pqsec verify-handshake --attack`: a row says what is done to the handshake of two
participants, and which step has to refuse it.
"""

from pqsec_pki.attacks import (
    _between,
    _impostors,
    _insiders,
    _meddling,
    _misdelivery,
    _replays,
    _sets,
    _tampering,
    _versions,
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
    *_versions.ATTACKS,
    *_sets.ATTACKS,
)


def attack_named(name: str) -> Attack:
    """The attack of that name; UnknownAlgorithmError, with the known ones, if there is none."""
    for row in ATTACKS:
        if row.name == name.lower():
            return row
    known = ", ".join(row.name for row in ATTACKS)
    raise UnknownAlgorithmError(f"no attack named {name!r}", hint=f"known: all, {known}")
