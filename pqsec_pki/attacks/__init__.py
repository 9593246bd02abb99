"""What an enemy could try on two participants who would meet, and that it fails.

For `pqsec verify-handshake --attack`: with the participants' own credentials, as the
meeting of `selfcheck` is attacked from between them, from outside and from inside.
"""

from pqsec_pki.attacks.attack import Attack
from pqsec_pki.attacks.siege import Outcome, Result, Siege, withstand
from pqsec_pki.attacks.table import ATTACKS, attack_named

__all__ = ["ATTACKS", "Attack", "Outcome", "Result", "Siege", "attack_named", "withstand"]
