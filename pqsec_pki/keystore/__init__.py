"""The keystore: the folder with the CAs, the enclaves and the documents of a domain.

The only room that knows file paths. SROS2's tools and ROS 2 can use the folder as it is.

Its content:
    _layout       where each file is
    _settings     reads and writes pqsec.json
    participant   the files of one participant, and their content
    authorities   the CAs with their private keys
    keystore      opens and creates the folder
The ledger:
    _chain        one line, and how it is chained to the line before
    _table        lines in SQLite
    _ledger_file  reads the database file, and replaces it as a whole
    _ledger       the database and its queries
    _entries      the lines for what is issued and signed
Changes:
    _folder       access to folders by descriptor, never through a link
    _lock         one command at a time
    _transaction  the files and lines of a change, before it is committed
    _journal      commits a change wholly or not at all
    _moves        what a committed change still has to do
    _shredding    overwrites private keys that are removed
Participants and documents:
    issuing       issues new participants; `_issuer` makes their files
    renewing      renews participants; `_inspector` finds the newest files of each
    signing       signs governance and permissions again
    revoking      revokes certificates and issues revocation lists
    compromised   finds keys that were revoked as compromised
CAs:
    rotating      replaces CAs; `rollover` has the options, `rollover_plan` the preview,
                  `_rollover_transaction` the steps
    overlapping   replaces the identity CA while the old one is still trusted; `overlap` reads
                  the phase
    passphrase    changes the passphrase of the CA keys
    adopting      makes another tool's keystore a pqsec keystore; `_scan` finds what it contains
Questions:
    participant_states   the state of each participant, for all commands that ask for it;
                         `_file_comparison` compares its files with the ledger
    status               the states of participants, CAs and the revocation list at one time
    auditing             whether the ledger is intact
"""

from pqsec_pki.keystore._chain import Entry, Line
from pqsec_pki.keystore._issuer import Issued, PublicKeys
from pqsec_pki.keystore._layout import SETTINGS
from pqsec_pki.keystore._layout import enclave_name as regular_name
from pqsec_pki.keystore.adopting import Adopted, adopt
from pqsec_pki.keystore.auditing import audit
from pqsec_pki.keystore.authorities import Authorities
from pqsec_pki.keystore.compromised import key_hashes
from pqsec_pki.keystore.issuing import ParticipantSpec, issue
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.overlap import Overlap, Phase
from pqsec_pki.keystore.overlapping import (
    BegunOverlap,
    begin_overlap,
    cancel_overlap,
    check_begin,
    finish_overlap,
    switch_overlap,
)
from pqsec_pki.keystore.participant import (
    enclave_files,
    load_certificate,
    load_participant,
    load_revocation_list,
)
from pqsec_pki.keystore.participant_states import (
    Files,
    ParticipantState,
    State,
)
from pqsec_pki.keystore.passphrase import change_passphrase
from pqsec_pki.keystore.renewing import Renewal, renew
from pqsec_pki.keystore.revoking import LIST_VALIDITY, Revoked, renew_list, revoke
from pqsec_pki.keystore.rollover import CA_VALIDITY, Rollover, Scope
from pqsec_pki.keystore.rollover_plan import RolloverPlan, plan_rollover
from pqsec_pki.keystore.rotating import Rotated, rotate
from pqsec_pki.keystore.signing import (
    governance_digest,
    sign_document,
    sign_governance,
    sign_permissions,
    signed_governance,
)
from pqsec_pki.keystore.status import SharedStatus, Status, status

__all__ = [
    "CA_VALIDITY",
    "LIST_VALIDITY",
    "SETTINGS",
    "Adopted",
    "Authorities",
    "BegunOverlap",
    "Entry",
    "Files",
    "Issued",
    "Keystore",
    "Line",
    "Overlap",
    "ParticipantSpec",
    "ParticipantState",
    "Phase",
    "PublicKeys",
    "Renewal",
    "Revoked",
    "Rollover",
    "RolloverPlan",
    "Rotated",
    "Scope",
    "SharedStatus",
    "State",
    "Status",
    "adopt",
    "audit",
    "begin_overlap",
    "cancel_overlap",
    "change_passphrase",
    "check_begin",
    "enclave_files",
    "finish_overlap",
    "governance_digest",
    "issue",
    "key_hashes",
    "load_certificate",
    "load_participant",
    "load_revocation_list",
    "plan_rollover",
    "regular_name",
    "renew",
    "renew_list",
    "revoke",
    "rotate",
    "sign_document",
    "sign_governance",
    "sign_permissions",
    "signed_governance",
    "status",
    "switch_overlap",
]
