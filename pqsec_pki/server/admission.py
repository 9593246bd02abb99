"""Who may have a certificate: decided by the ledger and the domain file, before a CA key is used.

A client shows a token, or a certificate whose key it has. Its name and its rights come from the
domain file: a request only says which participant asks, and for which keys.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from datetime import datetime
from functools import cache, cached_property
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import exists, read
from pqsec_pki._times import said
from pqsec_pki.algorithms import Profile
from pqsec_pki.certificates import CertificateRequest
from pqsec_pki.domain import Desired, Member, has_rights
from pqsec_pki.enrolment import NAMELESS, name_asked_for, validate_csrs
from pqsec_pki.errors import MalformedError, VerificationError
from pqsec_pki.est import REQUEST_ENDED, WAS_REVOKED
from pqsec_pki.keystore import (
    ADMISSION,
    ORDER,
    Entry,
    Keystore,
    Ledger,
    ParticipantState,
    State,
    current_certificate,
    in_all_sets,
    is_revoked,
    key_hashes,
    order_in,
    participant_states,
    policy_of,
)
from pqsec_pki.lifecycle import REVOCATIONS, ParticipantSpec, PublicKeys
from pqsec_pki.server.call import SignerCall
from pqsec_pki.server.configuration import EnrolmentPolicy
from pqsec_pki.server.deciding import REFUSAL, decision_on, demanded, end_of, is_late
from pqsec_pki.server.factories import Factory
from pqsec_pki.server.identifying import APPROVED, NEW_TOKEN, Requesters
from pqsec_pki.server.requester import Admitted, NotAdmittedError, Requester, refuse_many
from pqsec_pki.server.token_lines import TokenState, admission_entry, request_of
from pqsec_pki.server.waiting import WaitingRequests

_NO_CREDENTIAL = "show an enrolment token, or a client certificate"
_ORDERED = "an order"
"""The name of an admission by an order of a registration authority."""
_BY_ORDER = "is enrolled by a registration authority's order, and no order has this request"
_OTHER_RIGHTS = (
    "was enrolled by an order with other rights than the domain file has:"
    " `pqsec apply` gives it those"
)


@dataclass(frozen=True)  # no slots, for cached properties
class Admission:
    """Decides about requests, with the ledger as it is now."""

    keystore: Keystore
    ledger: Ledger
    desired: Desired
    now: datetime
    waiting: WaitingRequests
    """Where requests wait until somebody decides."""
    policy: EnrolmentPolicy
    taken: Counter[str] = field(default_factory=Counter)
    """Names admitted since the ledger was read, and the tokens that admitted them."""
    factories: Mapping[str, Factory] = field(default_factory=dict)
    """Whose devices may enrol, by the names that the domain file has."""

    def of(self, call: SignerCall) -> Admitted:
        """The request that may be answered; NotAdmittedError if it may not."""
        holder = self.requesters.of(call)
        request = _request_in(call.body)
        name = name_asked_for(request)
        ordered = name is not None and self._was_ordered(name, request)
        if holder.by == "" and not ordered:
            raise NotAdmittedError(401, _NO_CREDENTIAL)
        if name is None:
            raise NotAdmittedError(403, f"the request is refused: {NAMELESS}")
        holder.refuse_other_name(name)
        member = self._member(name, call.label)
        held = self._held(name)
        self._refuse_revoked(held, None if ordered else holder.token)
        if ordered:
            return Admitted(name, _ORDERED)
        if holder.device:
            holder = self.requesters.device(holder.device, member, request, call)
        if self._was_answered(name, request, holder):
            return self._again(member, held, holder, request)
        if member.by_order and (held is None or self._by_plan):
            raise NotAdmittedError(403, f"{name} {_BY_ORDER}")
        keys = _keys(request, name, self.keystore.profiles)
        self._refuse_used(holder, name)
        self._refuse_state(held, holder, keys)
        self._refuse_wider(held, holder, member)
        planned = self._by_plan and request.fingerprint in self._requests_of(name)[-1:]
        if holder.by == APPROVED or (self._by_plan and not planned):
            self._refuse_undecided(request, name, call, planned=planned)
        if holder.certificate or holder.device:  # these admit without a limit of uses
            refuse_many(
                f"certificates of {name}", self.ledger.of_name("participant", name), self.now
            )
        self._take(name, holder)
        line = admission_entry(holder.by, name, request, self.now, certificate=holder.device)
        if planned:
            return Admitted(name, holder.by, line=line)
        spec, again = replace(member.spec(), keys=keys), held is not None and is_revoked(held)
        return Admitted(
            name, holder.by, spec, line, replaces=held is not None, after_revocation=again
        )

    def _refuse_revoked(self, held: ParticipantState | None, token: TokenState | None) -> None:
        """NotAdmittedError for a revoked participant, unless the token was made to admit it since.

        By the lines of the ledger: one that was made before is perhaps in the hands of the thief.
        """
        sets = (held, *held.further) if held else ()
        for each in sets:
            if not each.revoked:
                continue
            if token is None or token.readmits <= self.ledger.line_of(REVOCATIONS, each.sha256):
                raise NotAdmittedError(403, f"{each.name} was revoked", problem=WAS_REVOKED)

    def _again(
        self,
        member: Member,
        held: ParticipantState | None,
        holder: Requester,
        request: CertificateRequest,
    ) -> Admitted:
        """The answer that it had; a new certificate if the one it had is not valid yet.

        That one was issued when the clock was ahead, so the robot could not use the answer.
        """
        name = member.name
        if held is None or held.state is not State.NOT_YET_VALID or self._by_plan:
            return Admitted(name, holder.by)
        self._refuse_wider(held, holder, member)
        if self.taken[name]:
            raise _being_answered()
        self.taken.update((name,))
        return Admitted(name, holder.by, self._spec_again(member, request), replaces=True)

    def again(self, name: str, path: Path) -> ParticipantSpec | None:
        """How to answer the participant's request at `path` again; None if that is not needed.

        It is if its certificate is not valid yet. NotAdmittedError if the participant cannot be
        requested over the network.
        """
        held = self._held(name)
        if held is None or held.state is not State.NOT_YET_VALID or self._by_plan:
            return None
        if not exists(path):
            return None  # the CA made its keys
        member = self._member(name, "")
        self._refuse_wider(held, Requester(name, ""), member)
        return self._spec_again(member, CertificateRequest.from_pem(read(path)))

    def _spec_again(self, member: Member, request: CertificateRequest) -> ParticipantSpec:
        name = member.name
        refuse_many(f"certificates of {name}", self._lines("participant", name), self.now)
        return replace(member.spec(), keys=_keys(request, name, self.keystore.profiles))

    def _refuse_undecided(
        self, request: CertificateRequest, name: str, call: SignerCall, *, planned: bool
    ) -> None:
        """NotAdmittedError unless the request was approved; without a decision, it waits.

        Where only a plan issues, it also waits until it was `planned`.
        """
        decision = decision_on(self.ledger, request, name)
        if decision is None:
            self.waiting.add(request, name, call.address, self.now)
        elif decision.kind == REFUSAL:
            raise _ended(403, "the request was refused")
        elif not self._by_plan and is_late(self.ledger, decision):
            raise _ended(403, f"{name} got a certificate since the request was approved")
        elif not planned and self.now > end_of(decision):
            raise _ended(403, f"the approval of the request ended {said(end_of(decision))}")
        if not decision or (self._by_plan and not planned):
            words = f"the request waits for approval: SHA-256 {request.fingerprint}"
            raise NotAdmittedError(202, words, retry_after=self.policy.retry_seconds)

    def _take(self, name: str, holder: Requester) -> None:
        """NotAdmittedError if the name, or the last use of the token, was just given to another."""
        token = holder.token
        last = token is not None and token.used + self.taken[holder.by] >= token.uses
        if last or self.taken[name]:
            raise _being_answered()
        self.taken.update((name, holder.by))

    def _refuse_used(self, holder: Requester, name: str) -> None:
        """NotAdmittedError if its token, or its line of the inventory, was used."""
        holder.refuse_used(self.now)
        if holder.device is None or holder.again:
            return
        lines = self._lines(ADMISSION, holder.by)
        if any(each.details.get("participant") == name for each in lines):
            raise NotAdmittedError(403, f"the device has enrolled as {name} before: {NEW_TOKEN}")

    def _member(self, name: str, label: str) -> Member:
        """The participant; NotAdmittedError if it cannot be requested over the network."""
        if label and label not in self.desired.groups:
            raise NotAdmittedError(404, "unknown label: a label is a group of the domain file")
        member = self.desired.members.get(name)
        if member is None:
            raise NotAdmittedError(403, f"{name} is not in the domain file")
        if label and name not in self.desired.groups[label]:
            raise NotAdmittedError(403, f"{name} is not in the group {label}")
        if member.request is None:
            raise NotAdmittedError(
                403,
                f"the keys of {name} are made by the CA: its entry in the domain file has no"
                " `request`",
            )
        return member

    @cached_property
    def requesters(self) -> Requesters:
        """Finds who asks."""
        return Requesters(
            self.keystore, self.ledger, self._lines, self.policy, self.factories, self.now
        )

    @cached_property
    def _lines(self) -> Callable[[str, str], list[Entry]]:
        """The lines of a kind and name, oldest first; read once for all questions."""
        return cache(self.ledger.of_name)

    @cached_property
    def _by_plan(self) -> bool:
        """Whether only a plan that several people approved may issue."""
        return bool(demanded(policy_of(self.ledger)))

    def _requests_of(self, name: str) -> list[str]:
        """The SHA-256 of the request that each certificate of `name` answers, oldest first."""
        lines = self._lines("participant", name)
        return [each.details.get("request", "") for each in lines]

    def _was_ordered(self, name: str, request: CertificateRequest) -> bool:
        """Whether the newest certificate is what a registration authority ordered for the request.

        Then the order admits every sender of that request: nothing is issued, and the answer is
        public in every handshake.
        """
        line = self._ordered(name) if any(self._requests_of(name)[-1:]) else None
        wanted = (name, request.fingerprint)
        return line is not None and wanted in {
            (each.name, each.request) for each in order_in(line).items
        }

    def _ordered(self, name: str) -> Entry | None:
        """The line of the order that enrolled `name`, unless a later request was answered."""
        asked = [each for each in self._requests_of(name) if each]
        return self._orders.get(asked[-1]) if asked else None

    @cached_property
    def _orders(self) -> dict[str, Entry]:
        """The orders that were performed, by their digests."""
        return {each.sha256: each for each in self.ledger.of_kind(ORDER)}

    def _was_answered(self, name: str, request: CertificateRequest, holder: Requester) -> bool:
        """Whether the newest certificate answers this request, and may be given to this holder.

        A holder of a certificate of the participant may fetch the newest in any case.
        """
        answered = self._requests_of(name)
        if request.fingerprint not in answered:
            return False
        if answered[-1] != request.fingerprint:
            raise _ended(409, "this request was answered, and a later one too")
        admissions = self._lines(ADMISSION, holder.by)
        return holder.certificate is not None or any(
            request_of(each) == request.fingerprint for each in admissions
        )

    def _held(self, name: str) -> ParticipantState | None:
        due = self.desired.renew_before
        states = [
            list(participant_states(each, ledger, [name], now=self.now, due=due))
            for each, ledger in self._sets
        ]
        return next(iter(in_all_sets(states)), None)

    @property
    def _sets(self) -> Iterator[tuple[Keystore, Ledger]]:
        """Each set of credentials with what the ledger says about it."""
        return ((each, self.ledger.of(each.set_name)) for each in self.keystore.sets)

    def _has_other_keys(self, name: str, keys: PublicKeys) -> bool:
        """Whether a certificate of the participant, in any set, is for another key than asked.

        A set in which it has none does not count: so it asks for what it lacks.
        """
        return any(
            state.keys != key_hashes(own.key, own.alternative)
            for (each, ledger), own in zip(self._sets, keys.sets, strict=True)
            for state in participant_states(each, ledger, [name], now=self.now)
        )

    def _refuse_state(
        self, held: ParticipantState | None, holder: Requester, keys: PublicKeys
    ) -> None:
        """NotAdmittedError if this participant may not have a new certificate now."""
        if held is None:
            return
        if holder.by == APPROVED:
            return  # who approved it saw that it replaces a certificate
        if holder.device is not None:
            if not holder.again and self._has_other_keys(held.name, keys):
                raise NotAdmittedError(409, f"{held.name} has a certificate for another key")
            return
        if holder.token is not None:
            if not holder.token.replaces and self._has_other_keys(held.name, keys):
                raise NotAdmittedError(
                    409,
                    f"{held.name} has a certificate for another key: the token must be made"
                    " with --replace",
                )
            return
        if holder.certificate is None or not self._is_current(held.name, holder):
            raise NotAdmittedError(403, f"this is not the current certificate of {held.name}")
        self._refuse_weaker(held.name, holder.set_name)
        due = held.state.calls_for_renewal or held.state is State.INCOMPLETE
        if not (self.policy.renew_any_time or due):
            raise NotAdmittedError(
                403,
                f"its certificate is not due: it ends {said(held.not_after)}, and it is"
                f" {said(self.now)} at the server; if the robot's clock says another time, set it;"
                " else the server renews earlier with `renew: any-time` in serve.yaml",
            )

    def _refuse_weaker(self, name: str, shown: str) -> None:
        """NotAdmittedError if it ever had a certificate of a set that resists more than `shown`.

        Who breaks the weaker key could else get certificates of the stronger set with it.
        """
        levels = {each.set_name: each.profile.participant_level for each in self.keystore.sets}
        for each, ledger in self._sets:
            if levels[each.set_name] > levels[shown] and ledger.count("participant", name):
                raise NotAdmittedError(
                    403,
                    f"show the certificate of profile {each.profile.name}: a weaker one decides"
                    " about no other",
                )

    def _is_current(self, name: str, holder: Requester) -> bool:
        """Whether it shows the newest certificate of a set, or the one that is valid now."""
        lines = self.ledger.of(holder.set_name).of_name("participant", name)
        shown = holder.certificate.fingerprint if holder.certificate else ""
        return shown in {lines[-1].sha256, current_certificate(lines, self.now)}

    def _refuse_wider(
        self, held: ParticipantState | None, holder: Requester, member: Member
    ) -> None:
        """NotAdmittedError if an order enrolled the participant, and the file has other rights.

        A token for new keys, an approval and a listed device are decisions of the keystore's users.
        """
        decided = holder.by == APPROVED or holder.device or (holder.token and holder.token.replaces)
        if held is None or decided or not self._ordered(held.name):
            return
        if not has_rights(self.keystore, member, held, now=self.now):
            raise NotAdmittedError(403, f"{held.name} {_OTHER_RIGHTS}")


def _being_answered() -> NotAdmittedError:
    words = "another request for the same is being answered"
    return NotAdmittedError(503, words, retry_after=1)


def _ended(status: int, words: str) -> NotAdmittedError:
    """The refusal of a request that is never answered; the robot may send another one."""
    return NotAdmittedError(status, words, problem=REQUEST_ENDED)


def _request_in(der: bytes) -> CertificateRequest:
    """NotAdmittedError if it is not a request."""
    try:
        return CertificateRequest.from_der(der)
    except MalformedError as error:
        raise NotAdmittedError(400, str(error)) from None


def _keys(request: CertificateRequest, name: str, profiles: Sequence[Profile]) -> PublicKeys:
    """The keys to be certified; NotAdmittedError without proof of possession of the profiles'."""
    try:
        return validate_csrs([request], profiles, names=[name])[name]
    except VerificationError as error:
        raise NotAdmittedError(400, str(error)) from None
