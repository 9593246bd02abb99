"""Would two participants of a keystore authenticate each other? Run it and see.

For `pqsec verify-handshake`, `pqsec demo`, and whoever wants to know before a robot does.
"""

from pqsec_pki.selfcheck.handshake_check import HandshakeParty, HandshakeSetup, run_handshake
from pqsec_pki.selfcheck.report import Report, Step
from pqsec_pki.selfcheck.stacks import PQSEC, STACKS, Stack, stack_named

__all__ = [
    "PQSEC",
    "STACKS",
    "HandshakeParty",
    "HandshakeSetup",
    "Report",
    "Stack",
    "Step",
    "run_handshake",
    "stack_named",
]
