"""When certificates, CAs and lists expire, from the ledger: no participant's files are read."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta
from enum import StrEnum

from pqsec_pki._files import exists
from pqsec_pki.errors import KeystoreError, meant
from pqsec_pki.keystore import _layout
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._entries import certificate_entry
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.overlap import Overlap


class State(StrEnum):
    """The state of a certificate or list, the most urgent first."""

    EXPIRED = "expired"
    PREVIOUS_CA = "previous-ca"
    """It was issued by an identity CA that has been replaced."""
    DUE = "due"
    VALID = "valid"
    REVOKED = "revoked"
    GONE = "gone"
    """Its folder no longer has a certificate."""

    @property
    def calls_for_renewal(self) -> bool:
        """Whether `pqsec renew --due` would renew it."""
        return self in {State.EXPIRED, State.DUE}


_URGENCY = {state: place for place, state in enumerate(State)}


@dataclass(frozen=True, slots=True, kw_only=True)
class ParticipantStatus:
    """The state of one participant's newest certificate."""

    name: str
    state: State
    not_after: datetime
    serial: str
    profile: str | None
    """None if the ledger line is older than this detail."""
    domains: str | None
    """The domains that its permissions allowed when it was issued: 0,2-5."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SharedStatus:
    """The state of a CA, or of the revocation list."""

    kind: str
    """identity-ca, permissions-ca, countersigner, trusted-too (overlap.py) or crl."""
    name: str
    state: State
    not_after: datetime


@dataclass(frozen=True, slots=True)
class Status:
    """The state of a keystore at the time `at`."""

    at: datetime
    shared: tuple[SharedStatus, ...]
    participants: tuple[ParticipantStatus, ...]
    """The most urgent first."""

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
    def list_is_due(self) -> bool:
        """Whether there is a revocation list that is to be renewed."""
        return any(each.kind == "crl" and each.state.calls_for_renewal for each in self.shared)


def status(
    keystore: Keystore,
    names: Iterable[str] | None = None,
    *,
    now: datetime,
    due: timedelta | None = None,
) -> Status:
    """The state of all participants, or of `names` only, and of the CAs and the list at `now`.

    A certificate is due if it ends within `due`; if that is None, when less than a third of
    its validity is left. KeystoreError for a name that is not in the ledger.
    """
    authority = keystore.identity_ca.fingerprint
    with keystore.open_ledger() as ledger:
        revoked = {each.sha256 for each in ledger.of_kind("revocation")}
        lists = ledger.of_kind("crl")[-1:] if keystore.has_revocation_list else []
        participants = ledger.newest("participant")
    if names is not None:
        participants = _chosen(participants, names)
    gone = {each.name for each in participants if _has_no_certificate(keystore, each.name)}

    def status_of(entry: Entry) -> ParticipantStatus:
        end = entry.ends
        state = _state(entry.made_at, end, now, due)
        if entry.issuer not in {None, authority}:
            state = State.PREVIOUS_CA
        if entry.sha256 in revoked:
            state = State.REVOKED
        if entry.name in gone:
            state = State.GONE
        return ParticipantStatus(
            name=entry.name,
            state=state,
            not_after=end,
            serial=entry.serial or "",
            profile=entry.details.get("profile"),
            domains=entry.details.get("domains"),
        )

    ordered = sorted(
        map(status_of, participants),
        key=lambda each: (_URGENCY[each.state], each.not_after, each.name),
    )
    shared = (*_authorities(keystore, now, due), *(_shared(each, now, due) for each in lists))
    return Status(now, shared, tuple(ordered))


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
            yield _shared(entry, now, due)


def _shared(entry: Entry, now: datetime, due: timedelta | None) -> SharedStatus:
    state = _state(entry.made_at, entry.ends, now, due)
    return SharedStatus(kind=entry.kind, name=entry.name, state=state, not_after=entry.ends)


def _state(made: datetime, end: datetime, now: datetime, due: timedelta | None) -> State:
    if now > end:
        return State.EXPIRED
    notice = (end - made) / 3 if due is None else due
    return State.DUE if end - now <= notice else State.VALID


def _chosen(participants: list[Entry], names: Iterable[str]) -> list[Entry]:
    known = {each.name: each for each in participants}
    wanted = dict.fromkeys(map(_layout.enclave_name, names))
    unknown = [name for name in wanted if name not in known]
    if unknown:
        raise KeystoreError(
            f"the ledger has no participant {', '.join(unknown)}",
            hint=meant(unknown[0], known) or "`pqsec status` lists the participants",
        )
    return [known[name] for name in wanted]


def _has_no_certificate(keystore: Keystore, name: str) -> bool:
    folder = _layout.enclave_folder(name)
    return not exists(f"{keystore.root}/{folder}/{_layout.CERTIFICATE}", follow=False)
