"""Taking certificates back: a line in the ledger, a new revocation list, a link to it everywhere.

All of it is one change. The list is made from the ledger; it lies once, in public/, and
each enclave has a link to it, so a new list reaches all of them in one rename.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

from pqsec_pki.certificates import (
    Authority,
    Reason,
    RevocationList,
    RevokedCertificate,
    revocation_list,
)
from pqsec_pki.errors import KeystoreError, PqsecError, UsageError
from pqsec_pki.keystore import _journal, _layout
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._entries import list_entry
from pqsec_pki.keystore._ledger import Ledger
from pqsec_pki.keystore._transaction import Transaction
from pqsec_pki.keystore.authorities import Authorities
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.overlap import refuse_overlap

COMPROMISE = "compromise"
"""The kind of the ledger's lines on what was revoked for another reason before."""

LIST_VALIDITY = timedelta(days=365)
"""Once a list has ended, stacks that were given it refuse everybody: it lasts as long as
participants do, unless the user wants another risk."""


@dataclass(frozen=True, slots=True)
class Revoked:
    """A certificate that was taken back."""

    name: str
    serial: str
    not_after: datetime
    since: datetime
    reason: str
    before: bool
    """Whether it had been already."""
    listed: bool
    """Whether the list names it: not if an earlier CA issued it, whose lists are no more made."""


def revoke(  # noqa: PLR0913 -- the choices are the user's, and by name
    keystore: Keystore,
    authorities: Authorities,
    subjects: Sequence[str],
    *,
    reason: Reason = Reason.UNSPECIFIED,
    now: datetime,
    validity: timedelta = LIST_VALIDITY,
) -> tuple[list[Revoked], RevocationList]:
    """Take back what `subjects` name, and make a new list; all of it or nothing.

    A subject is a participant, which means all its certificates that have not expired,
    or one certificate's serial number in hex. What was revoked before stays so, since then
    and for its reason; only that a key is compromised may become known later. KeystoreError
    for a subject the ledger does not know or that has expired.
    """
    with _journal.change(keystore.root) as transaction, keystore.open_ledger() as ledger:
        authorities.refuse_outdated(keystore.root)
        chosen = {
            each.sha256: each
            for subject in subjects
            for each in _certificates(ledger, subject, now)
        }
        before = _revoked_since(ledger)
        new = [
            _revocation(each, reason, now, again=each.sha256 in before)
            for each in chosen.values()
            if _is_news(before.get(each.sha256), reason)
        ]
        made = Publisher(keystore, authorities.identity, ledger, now).publish(
            transaction, new, validity
        )
    after = _merged((*before.values(), *new))
    listed = {each.serial_number for each in made.revoked}
    return [_told(after[sha256], listed, before=sha256 in before) for sha256 in chosen], made


def renew_list(
    keystore: Keystore,
    authorities: Authorities,
    *,
    now: datetime,
    validity: timedelta = LIST_VALIDITY,
) -> RevocationList:
    """A new list that takes back what the last one did, and is due later."""
    with _journal.change(keystore.root) as transaction, keystore.open_ledger() as ledger:
        authorities.refuse_outdated(keystore.root)
        publisher = Publisher(keystore, authorities.identity, ledger, now)
        return publisher.publish(transaction, [], validity)


@dataclass(frozen=True, slots=True)
class Publisher:
    """What the next list of a CA is made from, while the keystore is locked."""

    keystore: Keystore
    identity: Authority
    ledger: Ledger
    now: datetime

    def publish(
        self, transaction: Transaction, new: Sequence[Entry], validity: timedelta
    ) -> RevocationList:
        """Stage the next list, with `new` revocations, and the links to it that are missing.

        KeystoreError while two identity CAs are trusted: a list of one is none of the other.
        """
        refuse_overlap(self.keystore, "a revocation list would be of one of them only")
        made = self.stage(transaction, new, validity)
        for place, target in _missing_links(self.keystore):
            transaction.link(place, target)
        return made

    def stage(
        self, transaction: Transaction, new: Sequence[Entry], validity: timedelta
    ) -> RevocationList:
        """Stage the next list, with `new` revocations; the links to it are the caller's."""
        last, old = self._last(), self._believed()
        made = revocation_list(
            self.identity,
            self._revoked(last, old, new),
            number=1 + max(last.list_number if last else 0, (old.number if old else None) or 0),
            now=self.now,
            validity=validity,
        )
        transaction.folder(_layout.PUBLIC, private=False).public(_layout.CA_LIST, made.pem)
        transaction.record(*new, list_entry(made, made.pem, self.identity.certificate, self.now))
        return made

    @property
    def _issuer(self) -> str:
        return self.identity.certificate.fingerprint

    def _last(self) -> Entry | None:
        lists = [each for each in self.ledger.of_kind("crl") if each.issuer == self._issuer]
        return lists[-1] if lists else None

    def _believed(self) -> RevocationList | None:
        """The list that lies there, if it is this CA's."""
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
        """What the ledger says; and what only the old list does, if the ledger was lost."""
        listed = {each.serial_number: each for each in old.revoked} if old else {}
        for entry in _merged((*_revoked_since(self.ledger).values(), *new)).values():
            if entry.issuer != self._issuer:
                continue
            # RFC 5280 3.3: an entry goes once a list later than the certificate had it
            # (and by the clock of now too, if that list's was wrong)
            if last and entry.ends < min(last.made_at, self.now):
                listed.pop(entry.serial_number, None)
            else:
                listed[entry.serial_number] = _revoked(entry)
        return list(listed.values())


def _certificates(ledger: Ledger, subject: str, now: datetime) -> list[Entry]:
    """The participants' lines that the user means."""
    named = ledger.of_name("participant", _name(subject))
    if not named:
        serial = subject.replace(":", "").lower().lstrip("0")
        named = [each for each in ledger.of_kind("participant") if each.serial == serial]
    if not named:
        raise KeystoreError(
            f"the ledger knows no participant and no serial number {subject}",
            hint="`pqsec status` lists both",
        )
    good = [each for each in named if now <= each.ends]
    if not good:
        raise KeystoreError(
            f"{subject} expired on {named[-1].ends:%Y-%m-%d}: nobody takes it any more",
            hint="there is nothing to take back",
        )
    return good


def _name(subject: str) -> str:
    try:
        return _layout.enclave_name(subject)
    except UsageError:
        return subject


def _revoked_since(ledger: Ledger) -> dict[str, Entry]:
    """The ledger's revocations, by the certificate's hash."""
    return _merged((*ledger.of_kind("revocation"), *ledger.of_kind(COMPROMISE)))


def _merged(lines: Iterable[Entry]) -> dict[str, Entry]:
    """The first line on each certificate, with the reason that the last one gives."""
    found: dict[str, Entry] = {}
    for line in lines:
        first = found.get(line.sha256, line)
        found[line.sha256] = replace(first, details=line.details)
    return found


def _is_news(before: Entry | None, reason: Reason) -> bool:
    known = before.details.get("reason") if before else None
    return before is None or (reason is Reason.KEY_COMPROMISE and known != reason.value)


def _revocation(line: Entry, reason: Reason, now: datetime, *, again: bool) -> Entry:
    return replace(
        line,
        at=now.isoformat(timespec="seconds"),
        kind=COMPROMISE if again else "revocation",
        details={"reason": reason.value},
    )


def _revoked(entry: Entry) -> RevokedCertificate:
    return RevokedCertificate(
        serial_number=entry.serial_number,
        revoked_at=entry.made_at,
        reason=entry.details.get("reason"),
    )


def _missing_links(keystore: Keystore) -> Iterator[tuple[str, str]]:
    """Where a link to the list should be and is not, and what it should show."""
    for name in keystore.names():
        [(link, target)] = _layout.shared_links(name, _layout.LIST_TARGET).items()
        place = f"{_layout.enclave_folder(name)}/{link}"
        there = keystore.root / place
        if not (there.is_symlink() and str(there.readlink()) == target):
            yield place, target


def _told(entry: Entry, listed: Collection[int], *, before: bool) -> Revoked:
    return Revoked(
        name=entry.name,
        serial=f"{entry.serial_number:x}",
        not_after=entry.ends,
        since=entry.made_at,
        reason=entry.details.get("reason", Reason.UNSPECIFIED.value),
        before=before,
        listed=entry.serial_number in listed,
    )
