"""Run the handshake of two participants of a keystore, to see whether they authenticate.

For `pqsec verify-handshake` and `pqsec demo`: it runs in memory, before any robot starts.
"""

from pqsec_pki.selfcheck.handshake_check import HandshakeParty, HandshakeSetup, run_handshake
from pqsec_pki.selfcheck.report import Report, Step
from pqsec_pki.selfcheck.shared_domains import verify_handshake
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
    "verify_handshake",
]
