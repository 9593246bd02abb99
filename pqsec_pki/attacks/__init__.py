"""Run attacks on the handshake of two participants, and check that all are refused.

For `pqsec verify-handshake --attack`: the handshake of `selfcheck` runs with the
participants' own credentials, attacked on the way, by outsiders and by insiders.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.attacks.attack import Attack
    from pqsec_pki.attacks.run import AttackOutcome, AttackReport, AttemptResult, run_attacks
    from pqsec_pki.attacks.table import ATTACKS, attack_named
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "ATTACKS",
    "Attack",
    "AttackOutcome",
    "AttackReport",
    "AttemptResult",
    "attack_named",
    "run_attacks",
]
