"""A keystore: the folder where CAs, participants and documents are kept.

The only room that knows what lies where on disk. SROS2's tools and ROS 2 itself can use
the folder as it is.

What there is:
    _layout       where each file lies
    _settings     pqsec.json, read and written
    participant   one participant, its files and what they say
    authorities   the CAs, with their private keys
    keystore      the folder, made and opened
The ledger:
    _chain        a line, and how it holds the one before
    _table        lines in SQLite
    _ledger_file  the database's file, read and replaced whole
    _ledger       the database, and what it is asked
    _entries      the lines on what is made
Changing anything:
    _folder       folders by handle, through no link
    _lock         one command at a time
    _draft        what shall be done
    _journal      done wholly or not at all
    _moves        what a committed change still has to do
    _shredding    private keys that go
Participants and documents:
    issuing       new participants; `_making`, what one runs with
    renewing      the same again; `_inspector`, what was the newest of its own
    signing       new documents for what is there
    revoking      taking back, and the revocation list
    compromised   keys that nobody may have any more
CAs:
    rotating      new ones; `rollover`, which and for whom; `_turn`, each of its parts;
                  `foreseeing`, the same told beforehand
    overlapping   new ones while the old are trusted; `overlap`, what a keystore says of that
    passphrase    another one
    adopting      those that others made; `_survey`, what is there
Questions:
    status        how long everything lasts
    holdings      what each participant has, and whether its files are that
    auditing      whether the ledger is whole
"""

from pqsec_pki.keystore._chain import Entry, Line
from pqsec_pki.keystore._layout import SETTINGS
from pqsec_pki.keystore._layout import enclave_name as regular_name
from pqsec_pki.keystore._making import Issued, PublicKeys
from pqsec_pki.keystore.adopting import Adopted, adopt
from pqsec_pki.keystore.auditing import audit
from pqsec_pki.keystore.authorities import Authorities
from pqsec_pki.keystore.compromised import key_hashes
from pqsec_pki.keystore.foreseeing import Outlook, foresee
from pqsec_pki.keystore.holdings import Files, Holding, Holdings, holdings
from pqsec_pki.keystore.issuing import Wish, issue
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.overlap import Overlap, Phase
from pqsec_pki.keystore.overlapping import (
    Begun,
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
from pqsec_pki.keystore.passphrase import change_passphrase
from pqsec_pki.keystore.renewing import Renewal, renew
from pqsec_pki.keystore.revoking import LIST_VALIDITY, Revoked, renew_list, revoke
from pqsec_pki.keystore.rollover import CA_VALIDITY, Rollover, Scope
from pqsec_pki.keystore.rotating import Rotated, rotate
from pqsec_pki.keystore.signing import govern, permit, sign_document, signed_governance
from pqsec_pki.keystore.status import Standing, State, Status, Term, status

__all__ = [
    "CA_VALIDITY",
    "LIST_VALIDITY",
    "SETTINGS",
    "Adopted",
    "Authorities",
    "Begun",
    "Entry",
    "Files",
    "Holding",
    "Holdings",
    "Issued",
    "Keystore",
    "Line",
    "Outlook",
    "Overlap",
    "Phase",
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
    "begin_overlap",
    "cancel_overlap",
    "change_passphrase",
    "check_begin",
    "enclave_files",
    "finish_overlap",
    "foresee",
    "govern",
    "holdings",
    "issue",
    "key_hashes",
    "load_certificate",
    "load_participant",
    "load_revocation_list",
    "permit",
    "regular_name",
    "renew",
    "renew_list",
    "revoke",
    "rotate",
    "sign_document",
    "signed_governance",
    "status",
    "switch_overlap",
]
