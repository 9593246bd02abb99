"""What there is and how long it lasts, from the ledger: no participant's files are read."""

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
    """How a certificate or list stands, the most urgent first."""

    EXPIRED = "expired"
    PREVIOUS_CA = "previous-ca"
    """Its identity CA made way for another, and it did not come along."""
    DUE = "due"
    VALID = "valid"
    REVOKED = "revoked"
    GONE = "gone"
    """Its folder has no certificate any more."""

    @property
    def calls_for_renewal(self) -> bool:
        """Whether `pqsec renew --due` would do something about it."""
        return self in {State.EXPIRED, State.DUE}


_URGENCY = {state: place for place, state in enumerate(State)}


@dataclass(frozen=True, slots=True, kw_only=True)
class ParticipantStatus:
    """How one participant stands, by its newest certificate."""

    name: str
    state: State
    not_after: datetime
    serial: str
    profile: str | None
    """None where the ledger does not tell, for what was issued before it did."""
    domains: str | None
    """Where it was allowed anything when it was issued: 0,2-5."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SharedStatus:
    """How long something lasts that all share: a CA, or the revocation list."""

    kind: str
    """identity-ca, permissions-ca, countersigner, trusted-too (overlap.py) or crl."""
    name: str
    state: State
    not_after: datetime


@dataclass(frozen=True, slots=True)
class Status:
    """A keystore at one moment."""

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
        """Whether there is a revocation list, and it is to be renewed."""
        return any(each.kind == "crl" and each.state.calls_for_renewal for each in self.shared)


def status(
    keystore: Keystore,
    names: Iterable[str] | None = None,
    *,
    now: datetime,
    due: timedelta | None = None,
) -> Status:
    """How everything stands at `now`; of `names` only, if they are given.

    What ends within `due` is due; without it, what has less than a third of its life
    left. KeystoreError for a name that the ledger does not have.
    """
    authority = keystore.identity_ca.fingerprint
    with keystore.open_ledger() as ledger:
        revoked = {each.sha256 for each in ledger.of_kind("revocation")}
        lists = ledger.of_kind("crl")[-1:] if keystore.has_revocation_list else []
        participants = ledger.newest("participant")
    if names is not None:
        participants = _chosen(participants, names)
    gone = {each.name for each in participants if _gone(keystore, each.name)}

    def standing(entry: Entry) -> ParticipantStatus:
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
        map(standing, participants),
        key=lambda each: (_URGENCY[each.state], each.not_after, each.name),
    )
    shared = (*_authorities(keystore, now, due), *(_term(each, now, due) for each in lists))
    return Status(now, shared, tuple(ordered))


def _authorities(
    keystore: Keystore, now: datetime, due: timedelta | None
) -> Iterator[SharedStatus]:
    """The CAs that are in use, by their certificates; also one that is trusted beside."""
    signers = (keystore.permissions_ca, keystore.countersigner)
    overlap = Overlap.of(keystore)
    kinds = ("identity-ca", "permissions-ca", "countersigner", "trusted-too")
    others = (*signers, overlap.other if overlap else None)
    for kind, each in zip(kinds, (keystore.identity_ca, *others), strict=True):
        if each:
            yield _term(certificate_entry(kind, each.subject_name, each, each.not_before), now, due)


def _term(entry: Entry, now: datetime, due: timedelta | None) -> SharedStatus:
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
            f"the ledger knows no participant {', '.join(unknown)}",
            hint=meant(unknown[0], known) or "`pqsec status` lists those there are",
        )
    return [known[name] for name in wanted]


def _gone(keystore: Keystore, name: str) -> bool:
    folder = _layout.enclave_folder(name)
    return not exists(f"{keystore.root}/{folder}/{_layout.CERTIFICATE}", follow=False)
