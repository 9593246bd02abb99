"""Dates that laws and authorities set for post-quantum cryptography, with their sources."""

from datetime import date

from pqsec_pki._dataclass import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Deadline:
    """A date, what it is for, and the document that sets it."""

    day: date
    what: str
    source: str


_CRA = "Cyber Resilience Act, Regulation (EU) 2024/2847 (OJ L, 2024-11-20), Article 71(2)"
_CNSA = (
    "CNSSP 15 in NSA, CNSA 2.0 FAQ, version 2.1, December 2024 (U/OO/194427-22), as others quote it"
)
"""The server of the NSA could not be reached; several quotations agree word for word."""
_EU = (
    "NIS Cooperation Group, Coordinated Implementation Roadmap for the Transition to"
    " Post-Quantum Cryptography, part 1, version 1.1, 2025-06-11"
)
DEADLINES = (
    Deadline(
        day=date(2026, 9, 11),
        what="manufacturers report exploited vulnerabilities and severe incidents (Article 14)",
        source=_CRA,
    ),
    Deadline(
        day=date(2026, 12, 31),
        what="first steps of the EU roadmap, such as inventories of cryptography (`pqsec cbom`)",
        source=_EU,
    ),
    Deadline(
        day=date(2027, 1, 1),
        what="new acquisitions for US national security systems support CNSA 2.0: ML-DSA-87 and"
        " ML-KEM-1024 (profile cnsa2)",
        source=_CNSA,
    ),
    Deadline(
        day=date(2027, 12, 11),
        what="the whole Cyber Resilience Act applies to new products",
        source=_CRA,
    ),
    Deadline(
        day=date(2030, 12, 31),
        what="the transition of high-risk uses is complete in the EU",
        source=_EU,
    ),
    Deadline(
        day=date(2030, 12, 31),
        what="what cannot support CNSA 2.0 is phased out of US national security systems",
        source=_CNSA,
    ),
    Deadline(
        day=date(2031, 12, 31),
        what="CNSA 2.0 is mandatory in US national security systems, unless otherwise noted",
        source=_CNSA,
    ),
    Deadline(
        day=date(2035, 12, 31),
        what="the transition of medium-risk uses is complete in the EU",
        source=_EU,
    ),
)
"""In order. A date of a roadmap is a recommendation, not a law."""
