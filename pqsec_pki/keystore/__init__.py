"""A keystore: the folder where CAs, participants and documents are kept.

The only room that knows what lies where on disk. SROS2's tools and ROS 2 itself can use
the folder as it is.
"""

from pqsec_pki.keystore._chain import Entry, Line
from pqsec_pki.keystore._making import Issued, PublicKeys
from pqsec_pki.keystore.adopting import Adopted, adopt
from pqsec_pki.keystore.auditing import audit
from pqsec_pki.keystore.authorities import Authorities, required_signatures
from pqsec_pki.keystore.enclave import regular_name
from pqsec_pki.keystore.foreseeing import Outlook, foresee
from pqsec_pki.keystore.holdings import Files, Holding, Holdings, holdings
from pqsec_pki.keystore.issuing import Wish, issue
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.participant import (
    Participant,
    load_certificate,
    load_participant,
    load_revocation_list,
)
from pqsec_pki.keystore.passphrase import change_passphrase
from pqsec_pki.keystore.renewing import Renewal, renew
from pqsec_pki.keystore.revoking import LIST_VALIDITY, Revoked, renew_list, revoke
from pqsec_pki.keystore.rollover import CA_VALIDITY, Rollover, Scope
from pqsec_pki.keystore.rotating import Rotated, rotate
from pqsec_pki.keystore.signing import govern, permit, signed_governance
from pqsec_pki.keystore.status import Standing, State, Status, Term, status

__all__ = [
    "CA_VALIDITY",
    "LIST_VALIDITY",
    "Adopted",
    "Authorities",
    "Entry",
    "Files",
    "Holding",
    "Holdings",
    "Issued",
    "Keystore",
    "Line",
    "Outlook",
    "Participant",
    "PublicKeys",
    "Renewal",
    "Revoked",
    "Rollover",
    "Rotated",
    "Scope",
    "Standing",
    "State",
    "Status",
    "Term",
    "Wish",
    "adopt",
    "audit",
    "change_passphrase",
    "foresee",
    "govern",
    "holdings",
    "issue",
    "load_certificate",
    "load_participant",
    "load_revocation_list",
    "permit",
    "regular_name",
    "renew",
    "renew_list",
    "required_signatures",
    "revoke",
    "rotate",
    "signed_governance",
    "status",
]
