"""Revokes certificates: ledger lines, a new revocation list, and links to it in all enclaves.

All of it is one change. The list is made from the ledger. There is one file, in public/, and
each enclave links to it, so one rename gives all enclaves the new list.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from typing import TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki._times import said
from pqsec_pki.approvals import Covered
from pqsec_pki.certificates import (
    Authority,
    Certificate,
    Reason,
    RevocationList,
    RevokedCertificate,
    revocation_list,
)
from pqsec_pki.errors import KeystoreError, PqsecError, UsageError
from pqsec_pki.keystore import (
    Authorities,
    Entry,
    Keystore,
    Ledger,
    SetChange,
    certificate_entry,
    change,
    layout,
    list_entry,
    nearest,
    refuse_overlap,
    superseded_in,
)
from pqsec_pki.lifecycle._sets import SetWork, each_set

OfSet: TypeAlias = tuple[Keystore, Ledger]
COMPROMISE = "compromise"
"""The kind of ledger lines that change the reason of an earlier revocation to keyCompromise."""

REVOCATIONS = ("revocation", COMPROMISE)
"""The kinds of lines about a certificate that was revoked."""
_ISSUED = "participant"
LIST_VALIDITY = timedelta(days=365)
"""The default validity of participants: after a list has expired, stacks with it refuse every
peer."""


@dataclass(frozen=True, slots=True)
class Revoked:
    """A revoked certificate."""

    name: str
    serial: str
    not_after: datetime
    since: datetime
    reason: str
    before: bool
    """Whether it had been revoked before."""
    listed: bool
    """Whether the list contains it; not if a previous CA issued it, which issues no lists now."""

    def to_json(self) -> dict[str, object]:
        """The certificate for --json."""
        return {
            "name": self.name,
            "serial": self.serial,
            "since": self.since,
            "reason": self.reason,
            "before": self.before,
            "listed": self.listed,
        }


def revoke(  # noqa: PLR0913 -- the choices are the user's, and by name
    keystore: Keystore,
    authorities: Authorities,
    subjects: Sequence[str],
    *,
    certificates: Sequence[Certificate] = (),
    reason: Reason = Reason.UNSPECIFIED,
    superseded: bool = False,
    now: datetime,
    validity: timedelta = LIST_VALIDITY,
) -> tuple[list[Revoked], RevocationList]:
    """Revoke the certificates of all `subjects` and issue new lists, or do nothing.

    Each set of credentials gets its list, with the same number; returned is that of the first set.
    A subject is a participant's name, for all its certificates that have not expired, or a
    certificate's serial number in hex. With `superseded` it is a name, for those that were
    replaced and are still valid; its current certificate stays. `certificates` are others of this
    identity CA, which the ledger need not have: it may have lost their lines. A certificate that
    was revoked before keeps its time and reason; only the reason keyCompromise may be added later.
    KeystoreError for a subject that is not in the ledger or has expired, and for a certificate of
    another CA.
    """
    with change(keystore.root, authorities) as transaction, keystore.open_ledger() as ledger:
        keystore.refuse_unapproved(Covered.REVOKE)
        sets = each_set(keystore, authorities, transaction, ledger)
        asked = [(each.keystore, each.ledger) for each in sets]
        chosen = _chosen(asked, subjects, now, superseded=superseded)
        chosen |= _given(asked, certificates, now)
        before = _merged(line for each in sets for line in _revoked_since(each.ledger).values())
        new = [
            _revocation(each, reason, now, again=each.sha256 in before)
            for each in chosen.values()
            if _is_news(before.get(each.sha256), reason)
        ]
        made = publish(sets, new, validity, now)
    after = _merged((*before.values(), *new))
    listed = {each.serial_number for one in made for each in one.revoked}
    found = [_result(after[sha256], listed, before=sha256 in before) for sha256 in chosen]
    return found, made[0]


def revocable(
    keystore: Keystore,
    subjects: Iterable[str],
    certificates: Iterable[Certificate] = (),
    *,
    superseded: bool = False,
    now: datetime,
) -> list[Entry]:
    """The ledger lines of the certificates that `revoke` would revoke; KeystoreError as there."""
    with keystore.open_ledger() as ledger:
        sets = [(each, ledger.of(each.set_name)) for each in keystore.sets]
        chosen = _chosen(sets, subjects, now, superseded=superseded)
        chosen |= _given(sets, certificates, now)
    return list(chosen.values())


def renew_list(
    keystore: Keystore,
    authorities: Authorities,
    *,
    now: datetime,
    validity: timedelta = LIST_VALIDITY,
) -> RevocationList:
    """Issue new lists with the same revocations and a later nextUpdate; that of the first set."""
    with change(keystore.root, authorities) as transaction, keystore.open_ledger() as ledger:
        keystore.refuse_unapproved(Covered.OTHER)
        sets = each_set(keystore, authorities, transaction, ledger)
        return publish(sets, [], validity, now)[0]


def publish(
    sets: Sequence[SetWork], new: Sequence[Entry], validity: timedelta, now: datetime
) -> list[RevocationList]:
    """Stage the next lists of all sets, with one number, and the missing links to them.

    `new` are revocations: each is in the list of its set. Errors as of `Publisher.publish`.
    """
    publishers = [
        Publisher(each.keystore, each.authorities.identity, each.ledger, now) for each in sets
    ]
    number = max(each.next_number for each in publishers)
    made = []
    for publisher, each in zip(publishers, sets, strict=True):
        own = [line for line in new if line.set_name == each.keystore.set_name]
        made.append(publisher.publish(each.part, own, number, validity))
    return made


@dataclass(frozen=True, slots=True)
class Publisher:
    """Issues the next list of an identity CA, while the keystore is locked."""

    keystore: Keystore
    identity: Authority
    ledger: Ledger
    now: datetime

    @property
    def next_number(self) -> int:
        """The number after that of its last list."""
        return 1 + self.last_number

    @property
    def last_number(self) -> int:
        """The number of its last list; 0 without one."""
        last, old = self._last(), self._verified()
        return max(last.list_number if last else 0, (old.number if old else None) or 0)

    def publish(
        self, part: SetChange, new: Sequence[Entry], number: int, validity: timedelta
    ) -> RevocationList:
        """Stage the next list, with `new` revocations, and the missing links to it.

        KeystoreError while two identity CAs are trusted: a list covers one CA only.
        """
        refuse_overlap(self.keystore, "a revocation list would cover only one of them")
        made = self.stage(part, new, number, validity)
        for place, target in layout.missing_list_links(self.keystore.folder):
            part.link(place, target)
        return made

    def stage(
        self, part: SetChange, new: Sequence[Entry], number: int, validity: timedelta
    ) -> RevocationList:
        """Stage the next list, with `new` revocations, but no links to it."""
        made = revocation_list(
            self.identity,
            self._revoked(self._last(), self._verified(), new),
            number=number,
            now=self.now,
            validity=validity,
        )
        part.folder(layout.PUBLIC, private=False).public(layout.CA_LIST, made.pem)
        part.record(*new, list_entry(made, made.pem, self.identity.certificate, self.now))
        return made

    @property
    def _issuer(self) -> str:
        return self.identity.certificate.fingerprint

    def _last(self) -> Entry | None:
        lists = [each for each in self.ledger.of_kind("crl") if each.issuer == self._issuer]
        return lists[-1] if lists else None

    def _verified(self) -> RevocationList | None:
        """The keystore's list; None if there is none, or this CA did not sign it."""
        try:
            found = self.keystore.revocation_list
            if found:
                found.verify(self.identity.certificate)
        except PqsecError:
            return None
        return found

    def _revoked(
        self, last: Entry | None, old: RevocationList | None, new: Sequence[Entry]
    ) -> list[RevokedCertificate]:
        """The revocations in the ledger, and those only in the old list, if the ledger was lost."""
        listed = {each.serial_number: each for each in old.revoked} if old else {}
        for entry in _merged((*_revoked_since(self.ledger).values(), *new)).values():
            if entry.issuer != self._issuer:
                continue
            # RFC 5280 3.3: an entry is removed after it was in a list that was issued after the
            # certificate's end (which must be past now too, in case that list's clock was wrong)
            if last and entry.ends < min(last.made_at, self.now):
                listed.pop(entry.serial_number, None)
            else:
                listed[entry.serial_number] = _revoked(entry)
        return list(listed.values())


def _chosen(
    sets: Sequence[OfSet], subjects: Iterable[str], now: datetime, *, superseded: bool
) -> dict[str, Entry]:
    """The entries of the certificates that `subjects` name, by the certificate's hash."""
    ledgers = [ledger for _, ledger in sets]
    if superseded:
        earlier = [superseded_in(keystore, ledger, now=now) for keystore, ledger in sets]
        names = [layout.enclave_name(each) for each in subjects]
        found = [each for name in names for each in _earlier(ledgers[0], name, earlier)]
    else:
        found = [each for subject in subjects for each in _certificates(ledgers, subject, now)]
    return {each.sha256: each for each in found}


def _earlier(
    ledger: Ledger, name: str, earlier: Iterable[Mapping[str, tuple[Entry, ...]]]
) -> list[Entry]:
    """Those of the participant in all sets; KeystoreError if there is no such participant."""
    found = [line for of_set in earlier for line in of_set.get(name, ())]
    if not found and not ledger.count(_ISSUED, name):
        raise _unknown(ledger, name, "participant")
    return found


def _given(
    sets: Sequence[OfSet], certificates: Iterable[Certificate], now: datetime
) -> dict[str, Entry]:
    """The entries of these certificates, by their hashes; made for those without a line."""
    found = {}
    for each in certificates:
        issuing = [one for one in sets if one[0].identity_ca.signed(each)]
        if each.is_self_issued or not issuing:
            raise KeystoreError(
                f"{each.subject_name}, serial number {each.serial_number:x}, is not a certificate"
                f" of {' or '.join(one.identity_ca.subject_name for one, _ in sets)}",
                hint="only the CA that issued a certificate can revoke it",
            )
        if now > each.not_after:
            raise _expired(each.subject_name, each.not_after)
        keystore, ledger = issuing[0]
        known = {line.sha256: line for line in ledger.of_kind(_ISSUED)}
        made = certificate_entry(_ISSUED, _subject(each), each, now, issuer=keystore.identity_ca)
        made = made.in_set(keystore.set_name)
        found[each.fingerprint] = known.get(each.fingerprint, made)
    return found


def _subject(certificate: Certificate) -> str:
    """The participant's name, or the whole subject if it has another form."""
    return certificate.subject_name.removeprefix("CN=")


def _certificates(ledgers: Sequence[Ledger], subject: str, now: datetime) -> list[Entry]:
    """The entries of the certificates that `subject` names, in all sets."""
    named = [line for each in ledgers for line in each.of_name(_ISSUED, _name(subject))]
    if not named:
        serial = subject.replace(":", "").lower().lstrip("0")
        lines = [line for each in ledgers for line in each.of_kind(_ISSUED)]
        named = [line for line in lines if line.serial == serial]
    if not named:
        raise _unknown(ledgers[0], subject, "participant and no serial number")
    good = [each for each in named if now <= each.ends]
    if not good:
        raise _expired(subject, named[-1].ends)
    return good


def _unknown(ledger: Ledger, subject: str, what: str) -> KeystoreError:
    return KeystoreError(
        f"the ledger has no {what} {subject}",
        hint=nearest(subject, [row[0] for row in ledger.participants()])
        or "`pqsec status` lists both",
    )


def _expired(subject: str, end: datetime) -> KeystoreError:
    return KeystoreError(
        f"{subject} expired on {said(end)}: no participant accepts it",
        hint="there is nothing to revoke; a server with `renew_expired` no longer renews it if the"
        " domain file does not name it",
    )


def _name(subject: str) -> str:
    try:
        return layout.enclave_name(subject)
    except UsageError:
        return subject


def _revoked_since(ledger: Ledger) -> dict[str, Entry]:
    """The ledger's revocations, by the certificate's hash."""
    return _merged(each for kind in REVOCATIONS for each in ledger.of_kind(kind))


def _merged(lines: Iterable[Entry]) -> dict[str, Entry]:
    """The first entry for each certificate, with the details of the last one."""
    found: dict[str, Entry] = {}
    for line in lines:
        first = found.get(line.sha256, line)
        found[line.sha256] = replace(first, details=line.details)
    return found


def _is_news(before: Entry | None, reason: Reason) -> bool:
    known = before.details.get("reason") if before else None
    return before is None or (reason is Reason.KEY_COMPROMISE and known != reason.value)


def _revocation(line: Entry, reason: Reason, now: datetime, *, again: bool) -> Entry:
    made = replace(
        line,
        at=now.isoformat(timespec="seconds"),
        kind=COMPROMISE if again else "revocation",
        details={"reason": reason.value},
    )
    return made.in_set(line.set_name)


def _revoked(entry: Entry) -> RevokedCertificate:
    return RevokedCertificate(
        serial_number=entry.serial_number,
        revoked_at=entry.made_at,
        reason=entry.details.get("reason"),
    )


def _result(entry: Entry, listed: Collection[int], *, before: bool) -> Revoked:
    return Revoked(
        name=entry.name,
        serial=f"{entry.serial_number:x}",
        not_after=entry.ends,
        since=entry.made_at,
        reason=entry.details.get("reason", Reason.UNSPECIFIED.value),
        before=before,
        listed=entry.serial_number in listed,
    )
