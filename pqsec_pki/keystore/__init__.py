"""The keystore: the folder with the CAs, the enclaves and the documents of a domain.

The only room that knows file paths. SROS2's tools and ROS 2 can use the folder as it is. It
reads the folder and commits changes to it; `lifecycle` has the operations that make changes.

Its content:
    layout        where each file is
    _settings     reads and writes pqsec.json
    participant   the files of one participant, and their content
    authorities   the CAs with their private keys
    ca_keys       the files of those keys
    sets          the CAs and documents of several sets of credentials
    keystore      opens and creates the folder
    patterns      participants given as patterns and groups
    groups        the groups that `apply` stored
    approving     whose approvals are demanded, and who approved: lines of the ledger
    stock         who may be met with the first set of credentials: a line of the ledger
    registering   what registration authorities may order, and ordered: lines of the ledger
The ledger:
    _chain        one line, and how it is chained to the line before
    _table        lines in SQLite
    _ledger       a copy of the lines in memory, and its queries
    _copies       such a copy, kept for the next question
    _store        what it needs of the place that keeps the lines
    _file_store   that place: a file in private/
    _ledger_file  reads that file, and replaces it as a whole
    _address      the URL of a ledger in PostgreSQL
    _postgres     such a ledger: lines, lock and commit; the only user of psycopg
    _postgres_schema  its tables and rights, as SQL
    _shared       which of the two a keystore has; the connection of the change that is made
    _moved_ledger     lines that go from one of the two to the other
    _shared_files     what machines with one ledger get of each other: files that lines are about
    _fetched_files    those for all participants, with which each change begins
    shared_requests   requests that wait at any server with that ledger
    _replaced_cas     the CAs by the ledger, and whether another machine replaced them
    heads         the signed head of the ledger's tree
    proofs        proofs that the ledger has what is in a bundle
    set_lines     lines that show of which set of credentials a CA is
    _entries      the lines for what is issued and signed
Changes:
    _folder       access to folders by descriptor, never through a link
    _gitignore    keeps what is secret out of git
    _outsiders    refuses a keystore that another user could change
    _lock         one command at a time
    _transaction  the files and lines of a change, before it is committed
    _set_change   its part that is about one set of credentials
    _journal      commits a change wholly or not at all
    _moves        what a committed change still has to do
    _shredding    overwrites private keys that are removed
Questions:
    states               the state of each participant, for all commands that ask for it;
                         `_file_comparison` compares its files with the ledger
    status_report        the states of participants, CAs, revocation list and governance
    overview             the CAs, profile, domains and participants
    overlap              whether two identity CAs are trusted, and which of them issues
    signing_clock        whether the clock can be right when something is signed
    compromised          finds keys that were revoked as compromised
    anchoring            signed heads that are kept in another place
    auditing             whether the ledger is intact
    current_files        the files that leave it: those of the ledger's newest lines
    bundle_numbers       the number of a bundle, by the ledger's lines about its files
    receipt              what a robot says that it runs, and its line in the ledger
    robots               what each robot runs and should run, by the newest receipts
    superseded           certificates that were replaced and are still valid
    accepted_certificates    the revoked ones that a robot with an older list accepts
    set_faults           what one set of credentials lacks beside the first, or says otherwise
    delivery             which robots lack the newest revocation list, and what they accept
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.keystore import layout
    from pqsec_pki.keystore._address import LedgerAddress
    from pqsec_pki.keystore._chain import SET_END, Entry, Line
    from pqsec_pki.keystore._entries import (
        certificate_entry,
        document_entry,
        list_entry,
        placed_entry,
    )
    from pqsec_pki.keystore._fetched_files import signed_document
    from pqsec_pki.keystore._gitignore import GITIGNORE, keystore_ignored, secrets_ignored
    from pqsec_pki.keystore._journal import change, resume
    from pqsec_pki.keystore._ledger import ABOVE, Ledger
    from pqsec_pki.keystore._moved_ledger import moved_entry
    from pqsec_pki.keystore._postgres_schema import schema_sql
    from pqsec_pki.keystore._set_change import SetChange
    from pqsec_pki.keystore._settings import settings_file
    from pqsec_pki.keystore._shared_files import LedgerFile, files_elsewhere
    from pqsec_pki.keystore._transaction import StagedFolder, Transaction
    from pqsec_pki.keystore.accepted_certificates import AcceptedCertificate
    from pqsec_pki.keystore.anchoring import (
        Anchored,
        anchored_head,
        checked_head,
        faults_of_ledger,
        read_anchors,
        write_anchor,
    )
    from pqsec_pki.keystore.approving import (
        APPROVAL,
        PLAN,
        approval_entries,
        lines_since,
        policy_entry,
        policy_of,
    )
    from pqsec_pki.keystore.auditing import audit, older_copies
    from pqsec_pki.keystore.authorities import Authorities, check_pair
    from pqsec_pki.keystore.bundle_numbers import BundleNumbers, bundle_number
    from pqsec_pki.keystore.ca_keys import SigningCa, ca_key_files, key_algorithms, load_ca_key
    from pqsec_pki.keystore.compromised import all_hashes, compromised_keys_in, key_hashes
    from pqsec_pki.keystore.current_files import CurrentFiles
    from pqsec_pki.keystore.delivery import (
        ADMISSION,
        MOST_SHOWN,
        LateRobot,
        ListDelivery,
        Way,
        list_delivery,
    )
    from pqsec_pki.keystore.groups import GROUP_NAME, groups_file
    from pqsec_pki.keystore.heads import SeenLedger, read_head
    from pqsec_pki.keystore.keystore import Keystore
    from pqsec_pki.keystore.layout import GENERATIONS, SETTINGS
    from pqsec_pki.keystore.layout import enclave_name as regular_name
    from pqsec_pki.keystore.overlap import (
        WAIT,
        Overlap,
        Phase,
        refuse_overlap,
        trust_entry,
        trust_file,
    )
    from pqsec_pki.keystore.overview import Overview, overview_of
    from pqsec_pki.keystore.participant import (
        enclave_files,
        load_certificate,
        load_first_certificate,
        load_participant,
        load_revocation_list,
        public_files,
    )
    from pqsec_pki.keystore.patterns import GROUP, expanded, is_several, matching, nearest
    from pqsec_pki.keystore.receipt import PUBLIC_FILES, RECEIPT, Receipt
    from pqsec_pki.keystore.registering import (
        ORDER,
        Registration,
        enrolled_by,
        grant_end_entry,
        grant_entry,
        order_entry,
        order_in,
        predates_approvals,
        registration,
        registrations,
        registrations_of,
    )
    from pqsec_pki.keystore.robots import InstallState, RobotState, robot_states
    from pqsec_pki.keystore.set_faults import (
        faults_of_sets,
        refuse_other_governance,
        refuse_other_permissions,
    )
    from pqsec_pki.keystore.set_lines import SetLine
    from pqsec_pki.keystore.sets import (
        ca_key_places,
        further,
        one_set,
        refuse_further_sets,
        stage_cas,
        stage_governance,
        together,
    )
    from pqsec_pki.keystore.shared_requests import RequestRow, SharedRequests
    from pqsec_pki.keystore.signing_clock import CLOCK_SKEW, was_ahead
    from pqsec_pki.keystore.states import (
        PERMITTED,
        Files,
        ParticipantState,
        State,
        current_certificate,
        in_all_sets,
        is_revoked,
        participant_states,
    )
    from pqsec_pki.keystore.status_report import (
        SharedStatus,
        Status,
        governance_digest,
        list_status,
        signed_governance,
        signed_grants,
        status,
    )
    from pqsec_pki.keystore.stock import stock_entry
    from pqsec_pki.keystore.superseded import superseded_certificates, superseded_in
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "ABOVE",
    "ADMISSION",
    "APPROVAL",
    "CLOCK_SKEW",
    "GENERATIONS",
    "GITIGNORE",
    "GROUP",
    "GROUP_NAME",
    "MOST_SHOWN",
    "ORDER",
    "PERMITTED",
    "PLAN",
    "PUBLIC_FILES",
    "RECEIPT",
    "SETTINGS",
    "SET_END",
    "WAIT",
    "AcceptedCertificate",
    "Anchored",
    "Authorities",
    "BundleNumbers",
    "CurrentFiles",
    "Entry",
    "Files",
    "InstallState",
    "Keystore",
    "LateRobot",
    "Ledger",
    "LedgerAddress",
    "LedgerFile",
    "Line",
    "ListDelivery",
    "Overlap",
    "Overview",
    "ParticipantState",
    "Phase",
    "Receipt",
    "Registration",
    "RequestRow",
    "RobotState",
    "SeenLedger",
    "SetChange",
    "SetLine",
    "SharedRequests",
    "SharedStatus",
    "SigningCa",
    "StagedFolder",
    "State",
    "Status",
    "Transaction",
    "Way",
    "all_hashes",
    "anchored_head",
    "approval_entries",
    "audit",
    "bundle_number",
    "ca_key_files",
    "ca_key_places",
    "certificate_entry",
    "change",
    "check_pair",
    "checked_head",
    "compromised_keys_in",
    "current_certificate",
    "document_entry",
    "enclave_files",
    "enrolled_by",
    "expanded",
    "faults_of_ledger",
    "faults_of_sets",
    "files_elsewhere",
    "further",
    "governance_digest",
    "grant_end_entry",
    "grant_entry",
    "groups_file",
    "in_all_sets",
    "is_revoked",
    "is_several",
    "key_algorithms",
    "key_hashes",
    "keystore_ignored",
    "layout",
    "lines_since",
    "list_delivery",
    "list_entry",
    "list_status",
    "load_ca_key",
    "load_certificate",
    "load_first_certificate",
    "load_participant",
    "load_revocation_list",
    "matching",
    "moved_entry",
    "nearest",
    "older_copies",
    "one_set",
    "order_entry",
    "order_in",
    "overview_of",
    "participant_states",
    "placed_entry",
    "policy_entry",
    "policy_of",
    "predates_approvals",
    "public_files",
    "read_anchors",
    "read_head",
    "refuse_further_sets",
    "refuse_other_governance",
    "refuse_other_permissions",
    "refuse_overlap",
    "registration",
    "registrations",
    "registrations_of",
    "regular_name",
    "resume",
    "robot_states",
    "schema_sql",
    "secrets_ignored",
    "settings_file",
    "signed_document",
    "signed_governance",
    "signed_grants",
    "stage_cas",
    "stage_governance",
    "status",
    "stock_entry",
    "superseded_certificates",
    "superseded_in",
    "together",
    "trust_entry",
    "trust_file",
    "was_ahead",
    "write_anchor",
]
