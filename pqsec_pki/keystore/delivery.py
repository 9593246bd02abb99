"""Which robots have the newest revocation list, by their receipts, and what the others accept.

A robot refuses a revoked certificate only if its own list has it. The ledger knows each list by its
SHA-256, and a receipt names the list that is installed. A robot without a receipt counts as one
that lacks the list: nobody knows that it has it. Of several sets of credentials a robot must have
the list of each in which it has a certificate.
"""

import shlex
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki._times import said
from pqsec_pki.credentials import REVOCATION_LIST
from pqsec_pki.errors import PqsecError
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._ledger import Ledger
from pqsec_pki.keystore.accepted_certificates import AcceptedCertificate, Revocations
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.overlap import Overlap
from pqsec_pki.keystore.receipt import RECEIPT, Receipt
from pqsec_pki.keystore.states import ParticipantState, participant_states

ADMISSION = "admission"
"""The kind of lines about requests that a server admitted."""
MOST_SHOWN = 10
"""Names in words; JSON has all."""


class Way(StrEnum):
    """How files of the keystore get to a robot."""

    FETCH = "fetch"
    """It enrolled over a network: `pqsec renew --from` fetches them."""
    BUNDLE = "bundle"
    """It generated its keys, or sent a receipt: `pqsec install` installs a bundle."""
    COPY = "copy"
    """Its keys were generated here: its folder was exported or copied."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LateRobot:
    """The robot of a participant, of which nobody knows that it has the newest list."""

    name: str
    groups: tuple[str, ...]
    """Those of the domain file that it is in."""
    has_receipt: bool
    list_number: int | None
    """The number of the list that its receipt names; None without one of this CA. Of several sets,
    that of the first of which it lacks the newest list; as the next value."""
    list_ends: datetime | None
    """When that list ends: then its stack refuses every peer."""
    way: Way
    until: datetime | None
    """When it accepts no revoked certificate any more, even without a new list; None if it accepts
    none now. Without a receipt it is not known whether it does."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ListDelivery:
    """How far the newest revocation list got."""

    keystore: Path
    number: int
    """The number of the newest list; of several sets, that of the first one that has a list."""
    robots: int
    """How many participants need it: those whose newest certificate is valid."""
    late: tuple[LateRobot, ...]
    """By name."""
    accepted: tuple[AcceptedCertificate, ...]
    """What at least one of them accepts."""
    profiles: tuple[str, ...] = ()
    """Of the keystore's sets of credentials."""

    @property
    def without_receipt(self) -> int:
        """How many of the late robots have no receipt."""
        return sum(not each.has_receipt for each in self.late)

    @property
    def until(self) -> datetime | None:
        """When the last robot accepts no revoked certificate any more; None if none does now."""
        return max((each.until for each in self.late if each.until), default=None)

    def to_json(self) -> dict[str, object]:
        """The delivery for --json."""
        return {
            "number": self.number,
            "robots": self.robots,
            "late": self.late,
            "without_receipt": self.without_receipt,
            "groups": dict(self._groups),
            "accepted": self.accepted,
            "until": self.until,
            "commands": self.commands,
        }

    def __str__(self) -> str:
        """How many robots lack it, in one line."""
        if not self.late:
            every = "the only robot has" if self.robots == 1 else f"all {self.robots} robots have"
            return f"{every} list {self.number}" if self.robots else "no robot needs it"
        words = f"{len(self.late)} of {self.robots} robots do not have list {self.number} yet"
        if self.without_receipt:
            words += f" ({self.without_receipt} without a receipt: not known)"
        return words

    @property
    def lines(self) -> tuple[str, ...]:
        """All of it, for people: the robots, what they accept and until when, and what to do."""
        if not self.late:
            return (str(self),)
        return (f"{self}: {self.names}", *self._group_lines(), self.danger, *self._ways())

    @property
    def names(self) -> str:
        """The first robots by name, with the lists that their receipts name."""
        shown = [f"{each.name} ({_held(each)})" for each in self.late[:MOST_SHOWN]]
        more = len(self.late) - len(shown)
        return ", ".join(shown) + (f" and {more} more" if more else "")

    @property
    def danger(self) -> str:
        """What they accept, and until when."""
        if not self.accepted or self.until is None:
            return "none of them accepts a revoked certificate"
        shown = [*dict.fromkeys(map(str, self.accepted))]
        more = f" and {len(shown) - MOST_SHOWN} more" if len(shown) > MOST_SHOWN else ""
        names = ", ".join(shown[:MOST_SHOWN])
        end = said(self.until)
        return f"until they have it they accept {names}{more}; at the latest until {end}"

    @property
    def commands(self) -> tuple[str, ...]:
        """The commands that bring the list to the late robots, on this machine."""
        ways, found = {each.way for each in self.late}, []
        keystore = f"pqsec -k {shlex.quote(str(self.keystore))}"
        if ways & {Way.BUNDLE, Way.FETCH}:
            names = [shlex.quote(each.name) for each in self.late if each.way is not Way.COPY]
            some = " ".join(names) + " " if len(names) <= MOST_SHOWN else ""
            found.append(f"{keystore} bundle {some}--outdated --no-keys --bundles bundles --force")
        if Way.COPY in ways:
            found += self._copies
        return tuple(found)

    @property
    def _copies(self) -> list[str]:
        """The commands that copy the list of each set."""
        keystore = f"pqsec -k {shlex.quote(str(self.keystore))}"
        if not self.profiles[1:]:
            return [f"{keystore} ca crl --show --force -o crl.pem"]
        return [
            f"{keystore} ca crl --show --set {each} --force -o {each}.crl.pem"
            for each in self.profiles
        ]

    def _ways(self) -> Iterator[str]:
        count = Counter(each.way for each in self.late)
        first, copies = self.commands[0], " and ".join(self._copies)
        if count[Way.FETCH]:
            words = "enrolled over a network: `pqsec renew --from` fetches it there, or a bundle"
            yield f"{count[Way.FETCH]} {words}"
        if count[Way.BUNDLE] or count[Way.FETCH]:
            yield (
                f"bundles for {count[Way.BUNDLE] + count[Way.FETCH]}, for `pqsec install` there:"
                f" {first}"
            )
        if count[Way.COPY]:
            yield (
                f"for {count[Way.COPY]} with keys from here, beside cert.pem in the enclave of each"
                f" copy (ROS 2 too): {copies}"
            )
        yield (
            "stacks read crl.pem when a participant starts: restart it; if a configuration for"
            " Cyclone DDS or Fast DDS does not name crl.pem, export it again; OpenDDS reads no list"
        )

    @property
    def _groups(self) -> Counter[str]:
        return Counter(group for each in self.late for group in each.groups)

    def _group_lines(self) -> Iterator[str]:
        """How many of each group are late."""
        if self._groups:
            alone = sum(not each.groups for each in self.late)
            words = [f"@{group}: {count}" for group, count in sorted(self._groups.items())]
            yield f"by group: {', '.join(words + ([f'in none: {alone}'] if alone else []))}"


def list_delivery(
    keystore: Keystore,
    *,
    now: datetime,
    participants: Iterable[ParticipantState] | None = None,
) -> ListDelivery | None:
    """Which robots have the newest list of each set at `now`.

    None if no identity CA issued a list, or while two identity CAs are trusted, when there is none.
    `participants` are the states of all, if the caller has read them. KeystoreError for a damaged
    ledger. Only permissions of revoked participants are read.
    """
    with keystore.open_ledger() as ledger:
        views = ((each, ledger.of(each.set_name)) for each in keystore.sets)
        sets = [found for view, own in views if (found := _Lists.of(view, own, now))]
        if not sets:
            return None
        receipts = {each.name: Receipt.of(each) for each in ledger.newest(RECEIPT)}
        admitted = {each.details.get("participant", "") for each in ledger.of_kind(ADMISSION)}
        states = participants or participant_states(keystore, ledger, now=now)
        robots = [each for each in states if not each.revoked and each.not_after >= now]
    robots.sort(key=lambda each: each.name)
    groups, late, accepted = _groups_of(keystore), [], set[str]()
    for each in robots:
        receipt = receipts.get(each.name)
        held = [(own, own.held_by(receipt)) for own in sets if each.name in own.names]
        lacking = [(own, entry) for own, entry in held if entry is not own.newest]
        if not lacking:
            continue
        ends = [(own.revocations.accepted_with(entry), entry) for own, entry in lacking]
        accepted.update(*(found.keys() for found, _ in ends))
        first, entry = lacking[0]
        late.append(
            LateRobot(
                name=each.name,
                groups=groups.get(each.name, ()),
                has_receipt=receipt is not None,
                list_number=entry.list_number if entry and entry.issuer == first.issuer else None,
                list_ends=entry.ends if entry else None,
                way=_way(each, receipt, admitted),
                until=_until(ends),
            )
        )
    every = [each for own in sets for each in own.revocations.every]
    return ListDelivery(
        keystore=keystore.root,
        number=sets[0].newest.list_number,
        robots=len(robots),
        late=tuple(late),
        accepted=tuple(each for each in every if each.serial in accepted),
        profiles=tuple(each.name for each in keystore.profiles),
    )


@dataclass(frozen=True, slots=True)
class _Lists:
    """The revocation lists of one set."""

    set_name: str
    issuer: str
    """SHA-256 of the identity CA that issues now."""
    newest: Entry
    known: Mapping[str, Entry]
    """All lists that were ever issued, by their SHA-256."""
    revocations: Revocations
    names: frozenset[str]
    """The participants that have a certificate in this set."""

    @classmethod
    def of(cls, keystore: Keystore, ledger: Ledger, now: datetime) -> Self | None:
        """Those of the set `keystore`; None without a list, or while two CAs are trusted."""
        issuer = keystore.identity_ca.fingerprint
        known = {each.sha256: each for each in ledger.of_kind("crl")}
        own = [each for each in known.values() if each.issuer == issuer]
        if not own or Overlap.of(keystore):
            return None
        return cls(
            set_name=keystore.set_name,
            issuer=issuer,
            newest=own[-1],
            known=known,
            revocations=Revocations.of(keystore, ledger, own, now),
            names=frozenset(each.name for each in ledger.newest("participant")),
        )

    def held_by(self, receipt: Receipt | None) -> Entry | None:
        """The list of this set that the receipt names."""
        place = layout.in_set(self.set_name, REVOCATION_LIST)
        return self.known.get(receipt.files.get(place, "")) if receipt else None


def _until(accepted: Iterable[tuple[Mapping[str, datetime], Entry | None]]) -> datetime | None:
    """When none of these is accepted any more: all have ended, or its own list of the set has."""
    found = []
    for ends, held in accepted:
        last = max(ends.values(), default=None)
        if last:
            found.append(min(last, held.ends) if held else last)
    return max(found, default=None)


def _way(state: ParticipantState, receipt: Receipt | None, admitted: set[str]) -> Way:
    if state.name in admitted:
        return Way.FETCH
    return Way.BUNDLE if state.requested or receipt else Way.COPY


def _held(robot: LateRobot) -> str:
    if not robot.has_receipt:
        return "no receipt"
    return f"list {robot.list_number}" if robot.list_number else "no list"


def _groups_of(keystore: Keystore) -> dict[str, tuple[str, ...]]:
    """The groups of each participant; empty if they cannot be read."""
    found: dict[str, tuple[str, ...]] = {}
    with suppress(PqsecError):
        for group, names in keystore.groups.items():
            for name in names:
                found[name] = (*found.get(name, ()), group)
    return found
