"""Would two participants of a keystore authenticate each other? Run it and see.

For `pqsec verify-handshake`, `pqsec demo`, and whoever wants to know before a robot does.
"""

from pqsec_pki.selfcheck.meeting import Guest, Occasion, meet
from pqsec_pki.selfcheck.report import Report, Step
from pqsec_pki.selfcheck.stacks import PQSEC, STACKS, Stack, stack_named

__all__ = [
    "PQSEC",
    "STACKS",
    "Guest",
    "Occasion",
    "Report",
    "Stack",
    "Step",
    "meet",
    "stack_named",
]
