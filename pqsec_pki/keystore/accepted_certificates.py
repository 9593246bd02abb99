"""The revoked certificates that a robot still accepts, by the revocation list that it has."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents import DefaultAction, Grant
from pqsec_pki.errors import PqsecError
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._ledger import Ledger
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.status_report import signed_grants

_MOST_TOPICS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class AcceptedCertificate:
    """A revoked certificate that has not expired."""

    name: str
    serial: str
    not_after: datetime
    list_number: int | None
    """The number of the first list that has it; None if a CA issued it that was replaced since, so
    that no list of today has it: a robot with the files of that CA accepts it."""
    rights: tuple[str, ...]
    """What its participant's permissions allow, such as `publish rt/estop`; empty if they cannot
    be read."""

    def __str__(self) -> str:
        topics = [*self.rights[:_MOST_TOPICS]]
        topics += ["..."] if len(self.rights) > len(topics) else []
        return f"{self.name} ({', '.join(topics)})" if topics else self.name


@dataclass(frozen=True, slots=True)
class Revocations:
    """The revoked certificates that have not expired, oldest revocation first."""

    every: tuple[AcceptedCertificate, ...]
    lines: tuple[int, ...]
    """The ledger line of each revocation."""
    list_lines: Mapping[str, int]
    """The ledger line of each list, by its SHA-256."""
    issuer: str
    """SHA-256 of the identity CA that issues now."""
    now: datetime
    known: dict[str, dict[str, datetime]]
    """The results for the lists that were asked for: thousands of robots have the same one."""

    @classmethod
    def of(cls, keystore: Keystore, ledger: Ledger, own: Sequence[Entry], now: datetime) -> Self:
        """Those of `keystore`; `own` are the lists of the CA that issues now, at least one."""
        line_of, list_lines = ledger.numbers("revocation"), ledger.numbers("crl")
        issuer, rights = own[-1].issuer or "", dict[str, tuple[str, ...]]()
        every, lines = [], []
        for each in ledger.of_kind("revocation"):
            if each.ends < now:
                continue
            line = line_of[each.sha256]
            having = (one for one in own if list_lines[one.sha256] > line)
            first = next(having, None) if each.issuer == issuer else None
            if each.name not in rights:
                rights[each.name] = _rights(keystore, each.name)
            lines.append(line)
            every.append(
                AcceptedCertificate(
                    name=each.name,
                    serial=f"{each.serial_number:x}",
                    not_after=each.ends,
                    list_number=first.list_number if first else None,
                    rights=rights[each.name],
                )
            )
        return cls(tuple(every), tuple(lines), list_lines, issuer, now, {})

    def accepted_with(self, held: Entry | None) -> dict[str, datetime]:
        """The ends of those that a robot with the list `held` accepts, by serial number.

        With a list that has ended, it accepts no peer. A robot with a list of the CA that issues
        now has its files, and no longer trusts one that was replaced.
        """
        if held and held.ends < self.now:
            return {}
        key = held.sha256 if held else ""
        if key not in self.known:
            line, is_own = (
                self.list_lines.get(key, 0),
                held is not None and held.issuer == self.issuer,
            )
            self.known[key] = {
                each.serial: each.not_after
                for number, each in zip(self.lines, self.every, strict=True)
                if number > line and not (is_own and each.list_number is None)
            }
        return self.known[key]


def _rights(keystore: Keystore, name: str) -> tuple[str, ...]:
    """What the permissions in the participant's folder allow; empty if they cannot be read."""
    with suppress(PqsecError):
        grants = signed_grants(keystore, name)
        return tuple(dict.fromkeys(each for grant in grants for each in _allowed(grant)))
    return ()


def _allowed(grant: Grant) -> Iterator[str]:
    if grant.default is DefaultAction.ALLOW:
        yield "all that is not denied"
    for rule in grant.rules:
        for word, criteria in (("publish", rule.publish), ("subscribe", rule.subscribe)):
            for topic in (topic for each in criteria for topic in each.topics if rule.allow):
                yield f"{word} {topic}"
