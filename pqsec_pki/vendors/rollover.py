"""Which stacks can trust two identity CAs at once, and how they are told to.

Measured with the stacks' own plugins, participants of each generation, in every round of a
rollover (tests/interop/test_rotate.py); what is said of other versions was measured as
docs/stacks.md has it, or read in the source.

Of two permissions CAs, no stack trusts both all the way: Fast DDS 2.9.1 takes documents of
either from one file, but meets only peers whose file has the same CA first.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Trust:
    """What a stack makes of two identity CAs."""

    stack: str
    how: str | None
    """How it trusts both; None if it does not."""
    evidence: str


TRUST = (
    Trust(
        stack="Fast DDS 2.9.1",
        how="both certificates in the file identity_ca, and both revocation lists if there are",
        evidence="measured",
    ),
    Trust(
        stack="Fast DDS 3.1.2, 3.6.2",
        how=None,
        evidence="measured: not the second in the file",
    ),
    Trust(
        stack="Cyclone DDS 0.10.2",
        how="both in a folder, TrustedCADirectory; no revocation list then; not in ROS 2",
        evidence="measured; in one file only the first counts",
    ),
    Trust(
        stack="Cyclone DDS 0.10.5, 11.0.1",
        how="perhaps so too: not tried",
        evidence="measured: in one file only the first counts",
    ),
    Trust(
        stack="OpenDDS",
        how=None,
        evidence="its source: the first certificate in the file",
    ),
)
