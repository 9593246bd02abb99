"""Run the handshake of two participants of a keystore, to see whether they authenticate.

For `pqsec verify-handshake` and `pqsec demo`: it runs in memory, before any robot starts.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.selfcheck.handshake_check import (
        HandshakeCheck,
        HandshakeParty,
        HandshakeSetup,
        LoadedParty,
        check_party,
        load_party,
        run_handshake,
    )
    from pqsec_pki.selfcheck.matrix import Suite, suites
    from pqsec_pki.selfcheck.pairs import (
        AllPairsJob,
        PairOutcome,
        PairsCheck,
        check_pairs,
        count_pairs,
    )
    from pqsec_pki.selfcheck.report import (
        AUTH_REQUEST,
        HANDSHAKE,
        MESSAGE,
        CheckedStep,
        HandshakeReport,
        Sent,
        Steps,
        StoppedError,
    )
    from pqsec_pki.selfcheck.run import HandshakeRun
    from pqsec_pki.selfcheck.session import HandshakeSession, Relay, SessionSide, SideSets
    from pqsec_pki.selfcheck.shared_domains import JoinableDomains, verify_handshake
    from pqsec_pki.selfcheck.stacks import PQSEC, STACKS, SimulatedStack, stack_named
    from pqsec_pki.selfcheck.summary import Cause, Summary, faults
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "AUTH_REQUEST",
    "HANDSHAKE",
    "MESSAGE",
    "PQSEC",
    "STACKS",
    "AllPairsJob",
    "Cause",
    "CheckedStep",
    "HandshakeCheck",
    "HandshakeParty",
    "HandshakeReport",
    "HandshakeRun",
    "HandshakeSession",
    "HandshakeSetup",
    "JoinableDomains",
    "LoadedParty",
    "PairOutcome",
    "PairsCheck",
    "Relay",
    "Sent",
    "SessionSide",
    "SideSets",
    "SimulatedStack",
    "Steps",
    "StoppedError",
    "Suite",
    "Summary",
    "check_pairs",
    "check_party",
    "count_pairs",
    "faults",
    "load_party",
    "run_handshake",
    "stack_named",
    "suites",
    "verify_handshake",
]
