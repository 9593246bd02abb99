"""A keystore: the folder where CAs, participants and documents are kept.

The only room that knows what lies where on disk. SROS2's tools and ROS 2 itself can use
the folder as it is.
"""

from pqsec_pki.keystore._ledger import Entry
from pqsec_pki.keystore.authorities import Authorities
from pqsec_pki.keystore.issuing import Issued, Wish, issue
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.participant import Participant, load_certificate, load_participant

__all__ = [
    "Authorities",
    "Entry",
    "Issued",
    "Keystore",
    "Participant",
    "Wish",
    "issue",
    "load_certificate",
    "load_participant",
]
