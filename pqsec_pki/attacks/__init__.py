"""What an enemy could try on two participants who would meet, and that it fails.

For `pqsec verify-handshake --attack`: with the participants' own credentials, as the
meeting of `selfcheck` is attacked from between them, from outside and from inside.
"""

from pqsec_pki.attacks.attack import Attack
from pqsec_pki.attacks.run import AttackReport, Outcome, Result, run_attacks
from pqsec_pki.attacks.table import ATTACKS, attack_named

__all__ = ["ATTACKS", "Attack", "AttackReport", "Outcome", "Result", "attack_named", "run_attacks"]
