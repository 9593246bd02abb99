"""The state of each participant, read from the ledger in one pass.

It serves status, plan, renewals and rollovers. It is fast for thousands: no certificate is
parsed. Files are compared with the ledger only if asked for (`_file_comparison.py`).
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from enum import StrEnum
from sys import intern

from pqsec_pki._dataclass import dataclass
from pqsec_pki.certificates import BACKDATE
from pqsec_pki.keystore._chain import Entry, damaged_line, time_in
from pqsec_pki.keystore._ledger import Ledger
from pqsec_pki.keystore.compromised import compromised_keys_in
from pqsec_pki.keystore.keystore import Keystore

PERMITTED = "permit "
"""Before a config digest: the rights are no longer those of the domain file."""


class State(StrEnum):
    """The state of a certificate or list, the most urgent first."""

    EXPIRED = "expired"
    NOT_YET_VALID = "not-yet-valid"
    """It begins later: it was made when the clock was ahead, or the clock is behind now."""
    PREVIOUS_CA = "previous-ca"
    """It was issued by an identity CA that has been replaced."""
    DUE = "due"
    INCOMPLETE = "incomplete"
    """It has no certificate in one of the keystore's sets of credentials, or one that is gone or
    revoked while that of another set is not."""
    VALID = "valid"
    REVOKED = "revoked"
    GONE = "gone"
    """Its folder no longer has a certificate."""
    ELSEWHERE = "elsewhere"
    """Its newest files are on another machine with the same ledger."""

    @classmethod
    def at(
        cls,
        now: datetime,
        made: datetime,
        end: datetime,
        due: timedelta | None,
        *,
        begin: datetime | None = None,
    ) -> "State":
        """EXPIRED, NOT_YET_VALID, DUE or VALID at `now`.

        It begins at `begin` [default: when it was `made`]. It is due if it ends within `due`; if
        that is None, when less than a third of its validity is left.
        """
        if now > end:
            return cls.EXPIRED
        if now < (made if begin is None else begin):
            return cls.NOT_YET_VALID
        notice = (end - made) / 3 if due is None else due
        return cls.DUE if end - now <= notice else cls.VALID

    @property
    def calls_for_renewal(self) -> bool:
        """Whether `pqsec renew --due` would renew it."""
        return self in {State.EXPIRED, State.NOT_YET_VALID, State.DUE}


class Files(StrEnum):
    """How a participant's files compare with the ledger."""

    NOT_COMPARED = "not compared"
    RIGHT = "right"
    GONE = "gone"
    """The folder has no certificate."""
    ELSEWHERE = "elsewhere"
    """Another machine with the same ledger has the newest certificate."""
    OTHER_CERTIFICATE = "other certificate"
    OTHER_PERMISSIONS = "other permissions"
    """The certificate is right, the permissions are not."""


@dataclass(frozen=True, slots=True)
class ParticipantState:
    """The state of one participant, by its newest lines in the ledger."""

    name: str
    state: State
    sha256: str
    """SHA-256 of its newest certificate; serial, times, profile, domains and keys are of that one
    too."""
    serial: str
    made_at: datetime
    not_after: datetime
    profile: str | None
    """None if the ledger line is older than this detail."""
    domains: str | None
    """The domains that its newest permissions allow: 0,2-5."""
    keys: str
    """Hashes of the certified keys, as of `key_hashes`; empty if not known."""
    requested: bool
    """Whether it ever sent a certificate request; then its key is not here."""
    revoked: bool
    issued_by_previous_ca: bool
    """Whether its certificate was issued by an identity CA that has been replaced."""
    compromised: bool
    """Whether a certificate for its key was revoked as compromised."""
    config_digest: str
    """The config digest with which it was issued or its permissions were signed; `PERMITTED`
    before it if its rights were changed since."""
    permissions: str
    """SHA-256 of its newest signed permissions; empty if none are known."""
    permissions_line: int
    """The number of their ledger line; 0 if none are known."""
    files: Files
    further: "tuple[ParticipantState, ...]" = ()
    """Its states in the further sets of credentials; `state` and `files` are those of all sets."""
    set_name: str = ""
    """The set that it is about; empty for the first one."""

    def is_on(self, domain: int) -> bool:
        """Whether `domains` has this domain; False if the domains are not known."""
        for part in (self.domains or "").split(","):
            first, to, last = part.partition("-")
            if not first.isdecimal() or domain < int(first):
                continue
            if domain == int(first) or (to and (not last.isdecimal() or domain <= int(last))):
                return True
        return False

    def to_json(self) -> dict[str, object]:
        """The state for --json."""
        return {
            "name": self.name,
            "state": self.state,
            "not_after": self.not_after,
            "profile": self.profile,
            "domains": self.domains,
            "serial": self.serial,
            "further": [each.to_json() for each in self.further],
        }


def current_certificate(lines: Sequence[Entry], now: datetime) -> str:
    """SHA-256 of the certificate that a participant may use at `now`, of its lines, oldest first.

    The newest that is valid; if none is, the newest. KeystoreError for a damaged line.
    """
    valid = (
        each
        for each in reversed(lines)
        if State.at(now, each.made_at, each.ends, None, begin=each.made_at - BACKDATE)
        in {State.VALID, State.DUE}
    )
    return next((each.sha256 for each in valid), lines[-1].sha256)


Compare = Callable[[str, str, str], Files]
"""Compares the files of a name with the SHA-256 of its certificate and of its permissions."""


def _not_compared(*_: str) -> Files:
    return Files.NOT_COMPARED


def participant_states(  # noqa: PLR0913 -- the rarer ones by name
    keystore: Keystore,
    ledger: Ledger,
    names: Collection[str] | None = None,
    *,
    now: datetime,
    due: timedelta | None = None,
    compare: Compare = _not_compared,
) -> Iterator[ParticipantState]:
    """The states at `now` of all participants in the ledger, or of those in `names`, by name.

    `due` is as in `State.at`. KeystoreError for a damaged ledger.
    """
    authority = keystore.identity_ca.fingerprint
    compromised = compromised_keys_in(keystore.folder, ledger).keys()
    for row in ledger.participants(names):
        name, sha256, serial, at, end, issuer, requests, profile, domains, keys, *others = row
        digest, permissions, line, revoked = others
        made_at, not_after = _times(name, at, end)
        files = compare(name, sha256, permissions)
        previous = issuer not in {"", authority}
        by_time = State.at(now, made_at, not_after, due, begin=made_at - BACKDATE)
        yield ParticipantState(
            name=name,
            state=_state(by_time, files, revoked=bool(revoked), previous=previous),
            sha256=sha256,
            serial=serial,
            made_at=made_at,
            not_after=not_after,
            profile=profile,
            domains=domains,
            keys=keys,
            requested=requests > 0,
            revoked=bool(revoked),
            issued_by_previous_ca=previous,
            compromised=not compromised.isdisjoint(keys.split()),
            config_digest=intern(digest),  # thousands share one
            permissions=permissions,
            permissions_line=line,
            files=files,
            set_name=keystore.set_name,
        )


def in_all_sets(
    sets: Sequence[Sequence[ParticipantState]],
) -> list[ParticipantState]:
    """The states of participants in all sets, by name, of those in each set, the first one first.

    The most urgent state of a participant is its state. It is INCOMPLETE, and not to be renewed, if
    the certificate of some sets, but not of all, is gone or revoked: it is issued again.
    """
    found: dict[str, list[ParticipantState]] = {}
    for each in (state for of_set in sets for state in of_set):
        found.setdefault(each.name, []).append(each)
    return [_joined(found[name], len(sets)) for name in sorted(found)]


def is_revoked(state: ParticipantState) -> bool:
    """Whether its certificate of any set was revoked."""
    return any(each.revoked for each in (state, *state.further))


def _joined(states: Sequence[ParticipantState], count: int) -> ParticipantState:
    found = {each.state for each in states}
    ended = found & {State.REVOKED, State.GONE, State.ELSEWHERE}
    if ended and len(found) > 1:
        found = {State.INCOMPLETE}
    elif not ended and len(states) < count:
        found.add(State.INCOMPLETE)
    wrong = (each.files for each in states if each.files is not Files.RIGHT)
    return replace(
        states[0],
        state=min(found, key=list(State).index),
        files=next(wrong, Files.RIGHT),
        further=tuple(states[1:]),
    )


def _state(by_time: State, files: Files, *, revoked: bool, previous: bool) -> State:
    if files is Files.GONE:
        return State.GONE
    if files is Files.ELSEWHERE and not revoked:
        return State.ELSEWHERE
    if revoked:
        return State.REVOKED
    return State.PREVIOUS_CA if previous else by_time


def _times(name: str, *texts: str) -> list[datetime]:
    try:
        return [time_in(text) for text in texts]
    except ValueError:
        raise damaged_line("participant", name) from None
