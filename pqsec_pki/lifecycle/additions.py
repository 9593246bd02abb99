"""What a further set of credentials would have: for which participants, and what is in its way.

The documents of the new set say what those of the first one say, octet for octet, and are written
again; so nobody is added whose documents or subject pqsec would write in another form.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from datetime import datetime
from shlex import quote

from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents import Governance
from pqsec_pki.errors import PqsecError
from pqsec_pki.keystore import WAIT, CurrentFiles, Keystore, layout, refuse_overlap
from pqsec_pki.lifecycle._alike import credentials_to_copy, document_of, other_form
from pqsec_pki.lifecycle._inspector import Inspector

NEEDS_REQUEST = "its key is not here: it needs a request with a key of each set"
_ELSEWHERE = "its files are on another machine with this ledger"
_NOT_CURRENT = "its certificate has ended, or was issued by a CA that has been replaced"


@dataclass(frozen=True, slots=True, kw_only=True)
class Addable:
    """The participants of a keystore, as a further set of credentials would have them."""

    issued: tuple[str, ...]
    """Those that get credentials of the new set; all others are left as they are."""
    left: Mapping[str, str]
    """Why each other participant does not, by name; nobody who was revoked."""
    refused: Mapping[str, PqsecError]
    """What `add_set` refuses all of it for: by participant, and of the keystore under ""."""

    @property
    def waiting(self) -> tuple[str, ...]:
        """Those who have their keys elsewhere, and must send requests."""
        return tuple(name for name, why in self.left.items() if why == NEEDS_REQUEST)


def addable(keystore: Keystore, *, now: datetime) -> Addable:
    """What `add_set` would do at `now`. It reads the documents of all participants."""
    first = keystore.sets[0]
    with keystore.open_ledger() as ledger:
        inspector = Inspector.of(first, ledger.of(first.set_name), now=now)
    found = chosen(inspector, now)
    return replace(found, refused=dict(_refused(inspector, found.issued)))


def chosen(inspector: Inspector, now: datetime) -> Addable:
    """Who gets credentials, by the ledger; nothing is looked for that is in the way."""
    first = inspector.keystore
    there = [*first.names(), *first.elsewhere(inspector.participants)]
    names = [each for each in there if each in inspector.participants]
    names = [each for each in names if not inspector.participants[each].revoked]
    left = {name: why for name in names if (why := _why_left(inspector, name, now))}
    issued = tuple(name for name in names if name not in left)
    return Addable(issued=issued, left=left, refused={})


def _why_left(inspector: Inspector, name: str, now: datetime) -> str:
    known = inspector.participants[name]
    if not inspector.keystore.has_key(name):
        return NEEDS_REQUEST if inspector.keystore.has(name) else _ELSEWHERE
    is_current = not known.issued_by_previous_ca and known.not_after > now
    return "" if is_current else _NOT_CURRENT


def _refused(inspector: Inspector, names: tuple[str, ...]) -> Iterator[tuple[str, PqsecError]]:
    try:
        for each in inspector.keystore.sets:
            refuse_overlap(each, WAIT)
        governance_to_copy(inspector.keystore)
    except PqsecError as error:
        yield "", error
    for name in names:
        try:
            credentials_to_copy(inspector, name)
        except PqsecError as error:
            yield name, error


def governance_to_copy(first: Keystore) -> bytes:
    """The governance of the first set; KeystoreError if pqsec would write another form."""
    with CurrentFiles.of(first) as current:
        document = document_of(first.anchors, current.shared[layout.GOVERNANCE])
    if Governance.from_xml(document).to_xml() != document:
        enclaves = first.folder / layout.ENCLAVES
        root, edited = quote(str(first.root)), quote(str(enclaves / layout.GOVERNANCE_XML))
        raise other_form(
            enclaves / layout.GOVERNANCE,
            f"review governance.xml and `pqsec -k {root} sign-governance {edited} --force`",
        )
    return document
