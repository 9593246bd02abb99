"""Compares one participant with its wanted state: the steps, or why it is blocked."""

import shlex
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._times import said
from pqsec_pki.algorithms import Profile
from pqsec_pki.documents import Grant
from pqsec_pki.domain._orders import order_at, steps_of
from pqsec_pki.domain.desired import Member
from pqsec_pki.domain.requests import admitted, asks_for_other_keys, hashes_in, is_there
from pqsec_pki.domain.steps import Blocked, Ended, Step, StepAction
from pqsec_pki.errors import PqsecError
from pqsec_pki.keystore import PERMITTED, Files, Keystore, ParticipantState, State, signed_grants

_NEVER = datetime.max.replace(tzinfo=UTC)
_SLACK = timedelta(days=1)
"""SROS2 writes a certificate and its permissions seconds apart."""
_READMIT = (
    "remove it from the file; or, if it came back, run `pqsec issue {} --validity {} --force"
    " --after-revocation`, and apply it again"
)
_REENROL = (
    "remove it from the file; or, if it came back, `pqsec enrolment-token create {} --replace"
    " --after-revocation`, or `pqsec issue --csr` with --force --after-revocation, and apply it"
    " again"
)
_ELSEWHERE = "has its key elsewhere"
_OTHER_MACHINE = "its files are on another machine, and were not made from this file"
_OTHER_KEY = "its request is for another key"
_IF_MEANT = "if the request is really from the robot, use --new-keys"
_NEW_ONLY = "an order enrols new names only"
_NO_ORDER = "name its `request` in place of the `order`"
_ORDER_AGAIN = "the registration authority makes a new one: `pqsec sign-request export --grant`"
_GRANT_FIRST = "apply the file, and then `pqsec ra add`"
_ASK_AGAIN = "make a new request on it (`pqsec request`), and name the file as its `request`"


@dataclass(frozen=True, slots=True)
class Reconciler:
    """Compares participants with their wanted state; the fields apply to all of them."""

    profiles: Sequence[Profile]
    """Of all sets of credentials, also of those that the plan adds."""
    keystore: Keystore | None = None
    """None if there is none yet."""
    ca_ends: datetime = _NEVER
    now: datetime = _NEVER
    new_keys: bool = False
    """Whether a request may be for other keys than its participant had."""
    members: Mapping[str, Member] = field(default_factory=dict)
    """All of the domain file, by name."""
    added: Collection[str] = ()
    """The participants for which the plan adds the sets that the keystore lacks."""
    orders: dict[Path, Mapping[str, Step] | str] = field(default_factory=dict)
    """The steps of each order that was read, or why it is refused."""

    def of(self, member: Member, held: ParticipantState | None) -> Iterator[Step | Blocked | Ended]:
        """The steps for `member`; `held` is its state in the keystore, None if it is new."""
        if held is None and self.keystore and self.keystore.has(member.name):
            yield Blocked(
                member.name,
                "has files that are not in the ledger",
                "move its folder out of enclaves/",
            )
        elif held is not None and any(each.revoked for each in _sets(held)):
            yield _revoked(member)
        elif held is not None and held.files is Files.ELSEWHERE:
            if held.config_digest != member.config_digest:
                yield Blocked(member.name, _OTHER_MACHINE, "apply the file there")
        elif again := self._why_issue(member.name, held):
            yield self._issue_step(member, held, *again)
        elif held is not None:
            answer = self._other_keys(member, held)
            if answer:
                yield answer
            if not isinstance(answer, Step):
                yield from self._steps_with_its_key(member, held)

    def _other_keys(self, member: Member, held: ParticipantState) -> Step | Blocked | None:
        """The step if it gets other keys, although all that it has is right.

        A key that is on a robot is not replaced here: what runs would no longer start.
        """
        if lacking := self._lacking(held):
            why = f"it has no certificate of set {', '.join(lacking)}"
            if not member.request and self.keystore and not self.keystore.has_key(member.name):
                return Blocked(member.name, f"{_ELSEWHERE}, and {why}", _ASK_AGAIN)
            return self._issue_step(member, held, StepAction.REPLACE, why)
        if asks_for_other_keys(member, [each.keys for each in _sets(held)]):
            return self._answer(member, held, StepAction.REPLACE, _OTHER_KEY)
        return None

    def _lacking(self, held: ParticipantState) -> list[str]:
        """The sets of which it has no certificate, and gets none when they are added."""
        known = {each.profile for each in held.further}
        there = [each.name for each in self.keystore.profiles] if self.keystore else []
        if held.name in self.added:
            known |= {each.name for each in self.profiles} - {*there}
        return [each.name for each in self.profiles[1:] if each.name not in known]

    def _steps_with_its_key(self, member: Member, held: ParticipantState) -> Iterator[Step]:
        """The steps that keep its key, whatever its request asks for."""
        if why := self._why_sign_permissions(member, held):
            yield Step(StepAction.SIGN_PERMISSIONS, member.name, why)
        if why := self._why_renew(member, held):
            yield Step(StepAction.RENEW, member.name, why)

    def _why_issue(self, name: str, held: ParticipantState | None) -> tuple[StepAction, str] | None:
        """Why it must be issued rather than renewed; None if it need not."""
        if held is None:
            return StepAction.ISSUE, "new"
        found = _sets(held)
        if any(each.files is Files.GONE for each in found):
            sets = self.keystore.sets if self.keystore else ()
            return (
                StepAction.REPLACE if any(each.has(name) for each in sets) else StepAction.ISSUE,
                "its certificate is missing",
            )
        why = next((why for each in found if (why := _why_replace(each))), "")
        return (StepAction.REPLACE, why) if why else None

    def _issue_step(
        self, member: Member, held: ParticipantState | None, action: StepAction, why: str
    ) -> Step | Blocked:
        """The step, if its keys are made here or its request may be answered."""
        if member.request:
            return self._answer(member, held, action, why)
        if held and self._key_is_elsewhere(member.name, held):
            return Blocked(member.name, f"{_ELSEWHERE}, and {why}", _ASK_AGAIN)
        return Step(action, member.name, why)

    def _answer(
        self, member: Member, held: ParticipantState | None, action: StepAction, why: str
    ) -> Step | Blocked:
        """The step by the participant's request or order."""
        if member.by_order and held:
            return Blocked(member.name, f"is not changed: {_NEW_ONLY}, and {why}", _NO_ORDER)
        if not is_there(member):
            what = "is in no order yet" if member.by_order else "has sent no request"
            return Blocked(member.name, f"{what} ({why})", f"put it at {member.request}")
        if member.by_order:
            return self._enrol_step(member)
        return self._answer_request(member, held, action, why)

    def _answer_request(
        self, member: Member, held: ParticipantState | None, action: StepAction, why: str
    ) -> Step | Blocked:
        name = member.name
        try:
            keys = hashes_in(admitted(member, self.profiles))
        except PqsecError as error:
            return Blocked(name, f"its request is refused: {error}", _ASK_AGAIN)
        same = held is None or self._has_its_key(keys, held)
        if held and same and any(each.compromised for each in _sets(held)):
            return Blocked(name, f"{_ELSEWHERE}, and {why}", _ASK_AGAIN)
        if not (same or self.new_keys):
            why = _OTHER_KEY if why == _OTHER_KEY else f"{_OTHER_KEY}, and {why}"
            return Blocked(name, f"is not changed: {why}", _IF_MEANT)
        return Step(action, name, why, keys)

    def _has_its_key(self, keys: str, held: ParticipantState) -> bool:
        """Whether a request is for the keys that it has and, for sets that it lacks, for others.

        A request for several sets proves possession of the first set's key too.
        """
        certified = " ".join(each.keys for each in _sets(held))
        return keys == certified or (bool(self._lacking(held)) and keys.startswith(f"{certified} "))

    def _enrol_step(self, member: Member) -> Step | Blocked:
        """The step by the participant's order, which is read once for all in it."""
        if self.keystore is None or member.request is None:
            return Blocked(member.name, "has an order, and there is no grant yet", _GRANT_FIRST)
        if member.request not in self.orders:
            self.orders[member.request] = self._order(member.request, self.keystore)
        found = self.orders[member.request]
        if isinstance(found, str):
            return Blocked(member.name, f"its order is refused: {found}", _ORDER_AGAIN)
        if member.name not in found:
            return Blocked(member.name, f"is not in {member.request}", _ORDER_AGAIN)
        return found[member.name]

    def _order(self, path: Path, keystore: Keystore) -> Mapping[str, Step] | str:
        try:
            found = order_at(path, self.members, self._with_all(keystore), now=self.now)
        except PqsecError as error:
            return str(error)
        return {each.name: each for each in steps_of(found)}

    def _with_all(self, keystore: Keystore) -> Keystore:
        """The keystore as it is after the plan's sets are added: before them nobody is enrolled."""
        return replace(keystore, profiles=tuple(self.profiles))

    def _key_is_elsewhere(self, name: str, held: ParticipantState) -> bool:
        """Whether it sent a request, and the keystore has no key for it; or a token has it."""
        if self.keystore and (self.keystore.has_key(name) or self.keystore.keys_outside(name)):
            return not self.keystore.has_key(name)
        return held.requested

    def _why_renew(self, member: Member, held: ParticipantState) -> str:
        if held.state is State.NOT_YET_VALID:
            return "its certificate is not valid yet: a clock was wrong"
        end = min(each.not_after for each in _sets(held))
        if not held.state.calls_for_renewal or end - self.now >= member.validity:
            return ""
        if self.ca_ends <= end:
            return ""  # no certificate outlives its CA
        word = "expired" if held.state is State.EXPIRED else "ends"
        return f"{word} {said(end)}"

    def _why_sign_permissions(self, member: Member, held: ParticipantState) -> str:
        if any(each.files is Files.OTHER_PERMISSIONS for each in _sets(held)):
            return "its permissions are not the ones signed last"
        if has_rights(self.keystore, member, held, now=self.now):
            return ""
        if held.config_digest.startswith(PERMITTED):
            return "its rights were changed by `pqsec permit`"
        return (
            f"its role ({member.role.label}) was changed"
            if held.config_digest
            else "its permissions were not made from the file"
        )


def has_rights(
    keystore: Keystore | None, member: Member, held: ParticipantState, *, now: datetime
) -> bool:
    """Whether its permissions have the rules of the file and last as long as its certificate.

    In all sets of credentials that it has.

    Another command may have signed them, or the role was written in another way. An error
    in its role or its files means no: the step then reports it.
    """
    if all(each.config_digest == member.config_digest for each in _sets(held)):
        return True
    if keystore is None:
        return False
    own = {each.profile for each in held.further}
    views = [keystore.sets[0], *(each for each in keystore.sets[1:] if each.profile.name in own)]
    with suppress(PqsecError):
        [wanted] = member.spec().grants
        return all(_fits(signed_grants(each, member.name), wanted, held, now) for each in views)
    return False


def _fits(signed: Sequence[Grant], wanted: Grant, held: ParticipantState, now: datetime) -> bool:
    """Whether these grants are the wanted one, for as long as its certificate."""
    if len(signed) != 1:
        return False
    [grant] = signed
    same = (grant.rules, grant.default) == (wanted.rules, wanted.default)
    return same and held.not_after - grant.not_after <= _SLACK and grant.not_before <= now


def _sets(held: ParticipantState) -> tuple[ParticipantState, ...]:
    """Its state in each set of credentials that it has; of the first one that of all."""
    return held, *held.further


def _why_replace(held: ParticipantState) -> str:
    """Why the certificate of one set cannot be renewed; or ''."""
    faults = {
        "its certificate is not the one issued last": held.files is Files.OTHER_CERTIFICATE,
        "its certificate was issued by a CA that has been replaced": held.issued_by_previous_ca,
        "its key was revoked as compromised": held.compromised,
    }
    return next((why for why, is_so in faults.items() if is_so), "")


def _revoked(member: Member) -> Ended:
    days, rest = divmod(member.validity, timedelta(days=1))
    validity = f"{member.validity // timedelta(hours=1)}h" if rest else f"{days}d"
    if member.request:
        return Ended(member.name, _REENROL.format(shlex.quote(member.name)))
    return Ended(member.name, _READMIT.format(shlex.quote(member.name), validity))
