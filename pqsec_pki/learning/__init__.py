"""Proposes permissions from what was seen in a domain, and compares them with what is granted.

    seen            the values: participants, and the topics that they were seen to use
    cyclone_trace   reads traces of Cyclone DDS
    fastdds_dump    reads what Fast DDS Monitor saves
    node_info       reads the output of `ros2 node info`
    recording       reads files of each kind, names participants and merges them
    proposing       the permissions that allow what was seen
    comparing       the differences to the permissions in a keystore
    learned         all of these as one value

What was seen is not proof of what is needed, and an attacker in an unsecured domain can pretend to
be any participant: people must review a proposal.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.learning.comparing import Comparison, Comparisons, compare
    from pqsec_pki.learning.learned import Learned, learn
    from pqsec_pki.learning.proposing import Proposal, Proposed, document_of, propose
    from pqsec_pki.learning.recording import Recording, read_recordings
    from pqsec_pki.learning.seen import Endpoint, NotProposed, SeenParticipant, UnreadLine
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "Comparison",
    "Comparisons",
    "Endpoint",
    "Learned",
    "NotProposed",
    "Proposal",
    "Proposed",
    "Recording",
    "SeenParticipant",
    "UnreadLine",
    "compare",
    "document_of",
    "learn",
    "propose",
    "read_recordings",
]
