"""Which stacks can trust two identity CAs at once, and how to configure them.

Measured with real processes of the stacks, in every round of an overlap
(tests/interop/test_rollover.py), and with their plugins, as an application that sets its
own properties would call them (tests/interop/test_rotate.py).

No stack fully trusts two permissions CAs. Fast DDS accepts documents of both from one file, but
authenticates only peers whose first CA has the same name. If both CAs have the same name, 3.1.2
changes over without a gap, and 2.9.1 does not start.
"""

from pqsec_pki._dataclass import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class OverlapSupport:
    """How a stack treats two identity CAs."""

    stack: str
    how: str | None
    """How it trusts both; None if it does not."""
    evidence: str

    def to_json(self) -> dict[str, str | None]:
        """The row for --json."""
        return {"stack": self.stack, "identity_ca": self.how, "evidence": self.evidence}


_FILE = "both certificates in the file identity_ca, as an overlap writes it"

TRUST = (
    OverlapSupport(stack="Fast DDS 2.9.1, 3.1.2", how=_FILE, evidence="measured, in any order"),
    OverlapSupport(stack="Cyclone DDS with pqsec's plugin", how=_FILE, evidence="measured"),
    OverlapSupport(
        stack="Cyclone DDS 0.10.2, 0.10.5",
        how=None,
        evidence="measured: the first in the file counts, and no configuration file can name a"
        " folder of CAs (TrustedCADirectory), because it names a revocation list too, if an"
        " empty one; an application that sets the properties itself can",
    ),
    OverlapSupport(
        stack="OpenDDS 3.13.3",
        how=None,
        evidence="measured: the first certificate in the file counts",
    ),
)
