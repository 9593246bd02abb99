"""The state of participants, CAs, the revocation list and the governance."""

import hashlib
from collections.abc import Container, Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from datetime import datetime, timedelta

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors, read
from pqsec_pki.certificates import BACKDATE
from pqsec_pki.documents import Governance, Grant, Permissions
from pqsec_pki.errors import KeystoreError, MissingError, VerificationError, located
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._entries import certificate_entry
from pqsec_pki.keystore._file_comparison import FileComparison, presence
from pqsec_pki.keystore._ledger import Ledger
from pqsec_pki.keystore.current_files import CurrentFiles
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.overlap import Overlap
from pqsec_pki.keystore.participant import load_certificate
from pqsec_pki.keystore.patterns import nearest
from pqsec_pki.keystore.signing_clock import signed_later
from pqsec_pki.keystore.states import (
    ParticipantState,
    State,
    in_all_sets,
    participant_states,
)
from pqsec_pki.smime import document_in

_URGENCY = {state: place for place, state in enumerate(State)}


@dataclass(frozen=True, slots=True, kw_only=True)
class SharedStatus:
    """The state of a CA, or of the revocation list."""

    kind: str
    """identity-ca, permissions-ca, countersigner, trusted-too (overlap.py) or crl."""
    name: str
    state: State
    not_after: datetime
    set_name: str
    """The set of credentials; empty for the first one."""


@dataclass(frozen=True, slots=True)
class Status:
    """The state of a keystore at the time `at`."""

    at: datetime
    shared: tuple[SharedStatus, ...]
    participants: tuple[ParticipantState, ...]
    """The most urgent first."""
    head: str
    """The ledger's head when it was read."""
    future: tuple[tuple[str, datetime], ...] = ()
    """What was signed later than now, as of `signed_later`: a clock is wrong, or was."""

    def to_json(self) -> dict[str, object]:
        """The state for --json."""
        return {
            "at": self.at.isoformat(timespec="seconds"),
            "shared": self.shared,
            "future": dict(self.future),
            "counts": self.counts(),
            "participants": self.participants,
        }

    def only(
        self,
        states: Container[State] | None = None,
        domain: int | None = None,
        expires_before: datetime | None = None,
    ) -> "Status":
        """This status with only the participants to which all of these apply; None is any."""
        found = (
            each
            for each in self.participants
            if (states is None or each.state in states)
            and (domain is None or each.is_on(domain))
            and (expires_before is None or each.not_after < expires_before)
        )
        return replace(self, participants=tuple(found))

    def counts(self) -> dict[State, int]:
        """How many participants are in each state."""
        counted = dict.fromkeys(State, 0)
        for each in self.participants:
            counted[each.state] += 1
        return counted

    @property
    def due(self) -> list[str]:
        """The participants to be renewed."""
        return [each.name for each in self.participants if each.state.calls_for_renewal]

    @property
    def revocation_list(self) -> SharedStatus | None:
        """The state of the revocation list, the most urgent of all sets; None if there is none."""
        lists = [each for each in self.shared if each.kind == "crl"]
        lost = next((each for each in lists if each.state is State.GONE), None)
        return lost or min(lists, key=lambda each: _URGENCY[each.state], default=None)

    @property
    def list_is_due(self) -> bool:
        """Whether there is a revocation list that is due, or one of several is gone."""
        state = self.revocation_list.state if self.revocation_list else State.VALID
        return state.calls_for_renewal or state is State.GONE


def status(
    keystore: Keystore,
    names: Iterable[str] | None = None,
    *,
    now: datetime,
    due: timedelta | None = None,
    compare_files: bool = False,
) -> Status:
    """The state of all participants, or of `names` only, and of the CAs and lists at `now`.

    A participant has one state in all sets of credentials, as of `in_all_sets`.
    `due` is as in `State.at`. With `compare_files` the participants' files are compared with
    the ledger; without, they are only missed if they are gone. KeystoreError for a name that is
    not in the ledger.
    """
    wanted = None if names is None else list(dict.fromkeys(map(layout.enclave_name, names)))
    with keystore.open_ledger() as ledger, disk_errors(keystore.root):
        head, sets, shared = ledger.head, [], list[SharedStatus]()
        for each in keystore.sets:
            own = ledger.of(each.set_name)
            sets.append(_participants(each, own, wanted, now, due, compare_files=compare_files))
            shared += _authorities(each, now, due)
            shared += _lists(each, own, now, due)
        found = in_all_sets(sets) if len(sets) > 1 else sets[0]
        if wanted is not None:
            _refuse_unknown(ledger, wanted, found)
        future = tuple(signed_later(ledger, now))
    found.sort(key=lambda each: (_URGENCY[each.state], each.not_after, each.name))
    return Status(now, tuple(shared), tuple(found), head, future)


def _participants(  # noqa: PLR0913 -- as `status`
    keystore: Keystore,
    ledger: Ledger,
    names: list[str] | None,
    now: datetime,
    due: timedelta | None,
    *,
    compare_files: bool,
) -> list[ParticipantState]:
    """The states in one set, by name."""
    comparison = FileComparison.of(keystore) if compare_files else None
    compare = comparison.compare if comparison else presence(keystore)
    found = list(participant_states(keystore, ledger, names, now=now, due=due, compare=compare))
    if comparison and keystore.to_change:
        comparison.save()
    return found


def _lists(
    keystore: Keystore, ledger: Ledger, now: datetime, due: timedelta | None
) -> Iterator[SharedStatus]:
    """The state of the set's list; GONE if its file is missing beside those of other sets.

    A set with two trusted identity CAs has none.
    """
    if found := list_status(keystore, ledger, now=now, due=due):
        yield found
    elif len(keystore.sets) > 1 and not Overlap.of(keystore):
        lost = ledger.of_kind("crl")[-1:]
        yield from (replace(_shared(each, now, due), state=State.GONE) for each in lost)


def list_status(
    keystore: Keystore, ledger: Ledger, *, now: datetime, due: timedelta | None
) -> SharedStatus | None:
    """The state of the newest revocation list; None if the keystore has none."""
    lists = ledger.of_kind("crl")[-1:] if keystore.has_revocation_list else []
    return next((_shared(each, now, due) for each in lists), None)


def signed_governance(keystore: Keystore) -> Governance:
    """The keystore's governance; `governance_digest` compares it with the ledger."""
    return Governance.from_xml(document_in(_governance(keystore)))


def _governance(keystore: Keystore) -> bytes:
    """The signed governance, also one that another machine with its ledger made since."""
    if keystore.ledger_address:
        with CurrentFiles.of(keystore) as current, suppress(KeystoreError, VerificationError):
            return current.shared[layout.GOVERNANCE]
    return keystore.governance


def signed_grants(keystore: Keystore, name: str) -> tuple[Grant, ...]:
    """The grants in a participant's permissions for the subject of its certificate.

    No signature is checked: `status` compares the files with the ledger. FileError,
    MalformedError or InvalidDocumentError if they cannot be read.
    """
    folder = keystore.folder / layout.enclave_folder(name)
    subject = load_certificate(folder / layout.CERTIFICATE).subject_name
    path = folder / layout.PERMISSIONS
    with located(path):
        return Permissions.from_xml(document_in(read(path))).grants_for(subject)


def governance_digest(keystore: Keystore) -> str | None:
    """The governance's config digest; None if the file is not the newest governance signed."""
    with keystore.open_ledger() as ledger:
        newest = ledger.of_name("governance", "")[-1:]
    with suppress(MissingError):
        for each in newest:
            if hashlib.sha256(_governance(keystore)).hexdigest() == each.sha256:
                return each.details.get("mark", "")
    return None


def _authorities(
    keystore: Keystore, now: datetime, due: timedelta | None
) -> Iterator[SharedStatus]:
    """The CAs in use, and a second trusted identity CA, by their certificates."""
    signers = (keystore.permissions_ca, keystore.countersigner)
    overlap = Overlap.of(keystore)
    kinds = ("identity-ca", "permissions-ca", "countersigner", "trusted-too")
    others = (*signers, overlap.other if overlap else None)
    for kind, each in zip(kinds, (keystore.identity_ca, *others), strict=True):
        if each:
            entry = certificate_entry(kind, each.subject_name, each, each.not_before)
            yield replace(_shared(entry, now, due), set_name=keystore.set_name)


def _shared(entry: Entry, now: datetime, due: timedelta | None) -> SharedStatus:
    begin = entry.made_at - BACKDATE if entry.kind == "crl" else entry.made_at
    state = State.at(now, entry.made_at, entry.ends, due, begin=begin)
    return SharedStatus(
        kind=entry.kind,
        name=entry.name,
        state=state,
        not_after=entry.ends,
        set_name=entry.set_name,
    )


def _refuse_unknown(ledger: Ledger, wanted: list[str], found: list[ParticipantState]) -> None:
    names = {each.name for each in found}
    unknown = [name for name in wanted if name not in names]
    if unknown:
        known = [row[0] for row in ledger.participants()]
        raise KeystoreError(
            f"the ledger has no participant {', '.join(unknown)}",
            hint=nearest(unknown[0], known) or "`pqsec status` lists the participants",
        )
