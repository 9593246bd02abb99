"""Would two participants of a keystore authenticate each other? Run it and see.

For `pqsec verify-handshake`, `pqsec demo`, and whoever wants to know before a robot does.
"""

from pqsec_pki.selfcheck.credentials import required_signatures
from pqsec_pki.selfcheck.meeting import meet
from pqsec_pki.selfcheck.report import Report, Step

__all__ = ["Report", "Step", "meet", "required_signatures"]
