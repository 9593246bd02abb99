"""Run the handshake of two participants of a keystore, to see whether they authenticate.

For `pqsec verify-handshake` and `pqsec demo`: it runs in memory, before any robot starts.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.selfcheck.handshake_check import HandshakeParty, HandshakeSetup, run_handshake
    from pqsec_pki.selfcheck.report import CheckedStep, HandshakeReport
    from pqsec_pki.selfcheck.shared_domains import verify_handshake
    from pqsec_pki.selfcheck.stacks import PQSEC, STACKS, SimulatedStack, stack_named
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "PQSEC",
    "STACKS",
    "CheckedStep",
    "HandshakeParty",
    "HandshakeReport",
    "HandshakeSetup",
    "SimulatedStack",
    "run_handshake",
    "stack_named",
    "verify_handshake",
]
