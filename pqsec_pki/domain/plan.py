"""What differs between a domain file and a keystore, as the steps that lead from one to the other.

All is asked of the ledger and of the files' stamps; no certificate or document is parsed.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

from pqsec_pki.domain.desired import Desired, Member
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import (
    Files,
    Holding,
    Holdings,
    Keystore,
    holdings,
    signed_governance,
    status,
)


class Action(StrEnum):
    """What a step does, in the order in which steps are taken."""

    MAKE = "make"
    GOVERN = "govern"
    ISSUE = "issue"
    REPLACE = "replace"
    PERMIT = "permit"
    RENEW = "renew"
    REVOKE = "revoke"
    LIST = "list"

    @property
    def words(self) -> str:
        """It, for a person."""
        return _WORDS[self]


_WORDS = {
    Action.MAKE: "make the CAs",
    Action.GOVERN: "sign the governance",
    Action.ISSUE: "issue",
    Action.REPLACE: "issue anew",
    Action.PERMIT: "sign permissions for",
    Action.RENEW: "renew",
    Action.REVOKE: "revoke",
    Action.LIST: "renew the revocation list",
}
_PLACE = {action: place for place, action in enumerate(Action)}


@dataclass(frozen=True, slots=True)
class Step:
    """One thing to be done."""

    action: Action
    name: str
    """Of the participant; empty where all share the thing."""
    why: str


@dataclass(frozen=True, slots=True)
class Blocked:
    """A participant that is wanted and that no step can bring back."""

    name: str
    why: str


@dataclass(frozen=True, slots=True)
class Plan:
    """What is to be done, and what is not."""

    steps: tuple[Step, ...]
    blocked: tuple[Blocked, ...]
    unlisted: tuple[str, ...]
    """In the keystore and not in the file, and valid: they stay, as nothing says `prune`."""
    unchanged: int
    """Participants that are as they should be."""

    @property
    def in_order(self) -> bool:
        """Whether the keystore is as the file wants it."""
        return not self.steps and not self.blocked


def plan(
    desired: Desired, keystore: Keystore | None, *, now: datetime, prune: bool = False
) -> Plan:
    """The steps from the keystore, None if there is none yet, to what is desired.

    `prune` as in the file, if that does not say it. KeystoreError if the keystore is of
    another name or profile.
    """
    if keystore is None:
        return _from_nothing(desired)
    _refuse_another(desired, keystore)
    actual = holdings(keystore)
    ca_ends = keystore.identity_ca.not_after
    return _Planner(desired, keystore, actual, now, ca_ends, prune or desired.prune).plan()


def _from_nothing(desired: Desired) -> Plan:
    steps = [
        Step(Action.MAKE, "", "there is no keystore"),
        Step(Action.GOVERN, "", "there is no keystore"),
        *(Step(Action.ISSUE, name, "new") for name in desired.members),
    ]
    return Plan(tuple(steps), (), (), 0)


def _refuse_another(desired: Desired, keystore: Keystore) -> None:
    if desired.profile not in {None, keystore.profile.name}:
        raise KeystoreError(
            f"{desired.path} wants profile {desired.profile}, and {keystore.root} has"
            f" {keystore.profile.name}",
            hint="`pqsec ca rotate` changes the profile of a keystore",
        )
    subject = keystore.identity_ca.subject_name
    if desired.name and f"CN={desired.name} " not in subject:
        raise KeystoreError(
            f"{desired.path} is about {desired.name}, and the CA of {keystore.root} is {subject}",
            hint="name the right keystore with -k, or leave `name` out of the file",
        )


@dataclass(frozen=True, slots=True)
class _Planner:
    desired: Desired
    keystore: Keystore
    actual: Holdings
    now: datetime
    ca_ends: datetime
    prune: bool

    def plan(self) -> Plan:
        steps: list[Step] = []
        blocked: list[Blocked] = []
        unchanged = 0
        if why := self._why_govern():
            steps.append(Step(Action.GOVERN, "", why))
        for member in self.desired.members.values():
            found = list(self._for(member))
            steps += [each for each in found if isinstance(each, Step)]
            blocked += [each for each in found if isinstance(each, Blocked)]
            unchanged += not found
        others = self._others()
        if self.prune:
            steps += [Step(Action.REVOKE, name, "not in the file") for name in others]
        steps += self._list_steps(steps)
        steps.sort(key=lambda step: _PLACE[step.action])
        return Plan(tuple(steps), tuple(blocked), () if self.prune else others, unchanged)

    def _why_govern(self) -> str:
        mark = self.actual.governance_mark
        if mark is None:
            return "the file there is not the one signed last"
        if mark == self.desired.governance_mark:
            return ""
        if not mark and signed_governance(self.keystore) == self.desired.governance:
            return ""  # by other means, but the same
        return "it was changed" if mark else "it says something else"

    def _for(self, member: Member) -> Iterator[Step | Blocked]:
        """What is to be done for one participant."""
        held = self.actual.participants.get(member.name)
        if held is None:
            yield Step(Action.ISSUE, member.name, "new")
        elif held.revoked:
            yield Blocked(member.name, "was revoked")
        elif held.requested and held.files in {Files.GONE, Files.OTHER_CERTIFICATE}:
            yield Blocked(member.name, "lacks its certificate here, and has its key elsewhere")
        elif held.files is Files.GONE:
            yield Step(Action.ISSUE, member.name, "its certificate is gone")
        elif held.files is Files.OTHER_CERTIFICATE:
            yield Step(Action.REPLACE, member.name, "its certificate is not the one issued last")
        else:
            if why := _why_permit(member, held):
                yield Step(Action.PERMIT, member.name, why)
            if why := self._why_renew(member, held):
                yield Step(Action.RENEW, member.name, why)

    def _why_renew(self, member: Member, held: Holding) -> str:
        notice = self.desired.renew_before
        if notice is None:
            notice = (held.not_after - held.made_at) / 3
        left = held.not_after - self.now
        if left > notice or left >= member.validity:
            return ""
        if self.ca_ends <= held.not_after:
            return ""  # no certificate outlives its CA
        word = "expired" if held.not_after < self.now else "ends"
        return f"{word} {held.not_after:%Y-%m-%d}"

    def _others(self) -> tuple[str, ...]:
        return tuple(
            name
            for name, held in self.actual.participants.items()
            if name not in self.desired.members and not held.revoked and held.not_after >= self.now
        )

    def _list_steps(self, steps: list[Step]) -> list[Step]:
        """Renewing and revoking see to the list themselves."""
        seen_to = any(step.action in {Action.RENEW, Action.REVOKE} for step in steps)
        if seen_to or not self.keystore.has_revocation_list:
            return []
        shared = status(self.keystore, (), now=self.now, due=self.desired.renew_before)
        ends = [term.not_after for term in shared.shared if term.kind == "crl"]
        return [Step(Action.LIST, "", f"ends {end:%Y-%m-%d}") for end in ends if shared.list_is_due]


def _why_permit(member: Member, held: Holding) -> str:
    if held.files is Files.OTHER_PERMISSIONS:
        return "its permissions are not the ones signed last"
    if held.mark == member.mark:
        return ""
    return f"its role ({member.role.label}) was changed" if held.mark else "not made of the file"
