"""Performs what a registration authority ordered, within its grant and without a human.

Everything is decided by what is in the ledger: the grant there, what was enrolled by it, and
whether it was ended. So the ledger must have all lines of which the CAs signed a head.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._times import days, said
from pqsec_pki.approvals import EnrolmentOrder, OrderedName, RegistrationGrant
from pqsec_pki.domain._role_values import role_in
from pqsec_pki.domain.desired import Member
from pqsec_pki.enrolment import SignRequest, answered, refuse_large_answer, validate_csrs
from pqsec_pki.errors import KeystoreError, UsageError, VerificationError, shown
from pqsec_pki.keystore import (
    Authorities,
    Entry,
    Keystore,
    Registration,
    anchored_head,
    matching,
    order_entry,
    predates_approvals,
    registration,
)
from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.problems import Code

_SKEW = timedelta(hours=1)
"""How far the clock of the registration authority may be ahead."""


@dataclass(frozen=True, slots=True)
class OrderedIssue:
    """The inputs for issuing the certificates of an order."""

    keystore: Keystore
    """Marked as approved, if those who approve changes approved the grant."""
    specs: tuple[ParticipantSpec, ...]
    line: Entry
    done: bool
    """Whether it was performed before: then nothing is issued."""
    authority: str


def ordered_issue(
    asked: SignRequest, keystore: Keystore, *, now: datetime, anchors: Path | None = None
) -> OrderedIssue:
    """What the order in `asked` makes, if its grant covers all of it.

    VerificationError if not, with everything that is wrong; also if the ledger, by its newest head
    or those in the folder `anchors`, is not whole. UsageError if nothing was ordered.
    """
    order = asked.order
    if order is None:
        raise UsageError("no registration authority ordered this")
    anchored_head(keystore, anchors)
    found = registration(keystore, order.grant)
    order.verify(found.grant)
    specs = _specs(asked, order, found.grant, keystore)
    done = order.digest in found.orders
    if done:
        _refuse_replaced(keystore, order)
    else:
        _refuse_late(order, found, now)
        if problems := [*uncovered(order.items, found.grant, used=found.used)]:
            raise VerificationError(*problems, hint="`pqsec ra list` shows what is granted")
        _refuse_known(keystore, order)
    approved = keystore.approved or not predates_approvals(keystore, found)
    return OrderedIssue(
        keystore=replace(keystore, approved=approved),
        specs=specs,
        line=order_entry(order, found.grant.authority, now),
        done=done,
        authority=found.grant.authority,
    )


def perform_order(
    asked: SignRequest,
    keystore: Keystore,
    authorities: Authorities,
    *,
    now: datetime,
    anchors: Path | None = None,
) -> bytes:
    """Issue what was ordered, or do nothing; returns the answer, a bundle for each request.

    An order is performed once: for the same order again, the answer has the same files, unless
    newer documents or lists are published. Errors as of `ordered_issue` and `issue`.
    """
    with keystore.hold():
        found = ordered_issue(asked, keystore, now=now, anchors=anchors)
        if not found.done:
            refuse_large_answer(asked, keystore)
            issue(found.keystore, authorities, found.specs, now=now, records=[found.line])
        return answered(asked, keystore, now=now)


def _specs(
    asked: SignRequest, order: EnrolmentOrder, grant: RegistrationGrant, keystore: Keystore
) -> tuple[ParticipantSpec, ...]:
    """Participants with the rights of the grant's roles, and the keys of the ordered requests."""
    names = [each.name for each in order.items]
    if [each.fingerprint for each in asked.requests] != [each.request for each in order.items]:
        raise VerificationError(
            "the requests are not those that were ordered", code=Code.CONTENT_CHANGED
        )
    keys = validate_csrs(asked.requests, keystore.profiles, names=names)
    if problems := [*_role_problems(order, grant)]:
        raise VerificationError(*problems)
    return tuple(
        replace(_member(each, grant).spec(), keys=keys[each.name].answering(order.digest))
        for each in order.items
    )


def _role_problems(order: EnrolmentOrder, grant: RegistrationGrant) -> Iterator[str]:
    for each in order.items:
        if each.role not in grant.roles:
            granted = ", ".join(grant.roles)
            yield f"{each.name}: the role {shown(each.role)} is not granted: {granted}"


def _member(item: OrderedName, grant: RegistrationGrant) -> Member:
    role, domains = role_in(item.role, grant.roles[item.role])
    source = Path(f"the grant of {grant.authority}")
    return Member(item.name, role, domains, item.validity, {}, source)


def _refuse_late(order: EnrolmentOrder, found: Registration, now: datetime) -> None:
    found.refuse_ended(now)
    if now >= order.expires:
        raise VerificationError(f"the order expired on {said(order.expires)}", code=Code.EXPIRED)
    if order.at > now + _SKEW:
        raise VerificationError(
            f"the order is of {said(order.at)}, which is in the future",
            code=Code.NOT_YET_VALID,
            hint="correct the clock of the machine where it was made, or of this one",
        )


def uncovered(
    items: Sequence[OrderedName], grant: RegistrationGrant, *, used: int = 0
) -> Iterator[str]:
    """The parts of an order that the grant does not cover, if it enrolled `used` participants
    before."""
    for each in items:
        if not any(matching(pattern, [each.name]) for pattern in grant.names):
            yield f"{each.name}: the grant is for {', '.join(grant.names)}"
        if not timedelta(0) < each.validity <= grant.longest:
            yield (
                f"{each.name}: {days(each.validity)} were ordered, and {days(grant.longest)} at"
                " most are granted"
            )
    if len(items) + used > grant.most:
        yield (
            f"{len(items)} participants were ordered, and {grant.most - used} of {grant.most} are"
            " left"
        )


def _refuse_known(keystore: Keystore, order: EnrolmentOrder) -> None:
    """KeystoreError for names that have, or had, a certificate: an order gives no name away."""
    names = [each.name for each in order.items]
    with keystore.open_ledger() as ledger:
        known = {row[0] for row in ledger.participants(names)}
    if known := known | {name for name in names if keystore.has(name)}:
        raise KeystoreError(
            f"already issued: {', '.join(sorted(known))}",
            hint="an order enrols new names only; `pqsec issue --csr --force` replaces certificate"
            " and permissions",
        )


def _refuse_replaced(keystore: Keystore, order: EnrolmentOrder) -> None:
    """VerificationError if what was issued for the order is not the newest, or was revoked."""
    for each in order.items:
        with keystore.open_ledger() as ledger:
            lines = ledger.of_name("participant", each.name)[-1:]
            revoked = ledger.numbers("revocation")
        fits = [line for line in lines if line.details.get("request") == order.digest]
        if not fits or fits[0].sha256 in revoked:
            raise VerificationError(
                f"the order was performed, and {each.name} was changed since",
                code=Code.CONTENT_CHANGED,
                hint="`pqsec log` shows it; a new order is for new names",
            )
