"""Orders of registration authorities that a domain file names: what they make, or why nothing.

The domain file names the participants and their rights; the order has the requests. So an order
enrols only participants of the file, with rights that its grant covers.
"""

from collections.abc import Iterator, Mapping
from datetime import datetime
from pathlib import Path

from pqsec_pki._times import days
from pqsec_pki.domain.desired import Member
from pqsec_pki.domain.ordered import OrderedIssue, ordered_issue
from pqsec_pki.domain.requests import hashes_in, order_in
from pqsec_pki.domain.steps import Step, StepAction
from pqsec_pki.errors import FileError, KeystoreError, VerificationError, located
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec


def order_at(
    path: Path, members: Mapping[str, Member], keystore: Keystore, *, now: datetime
) -> OrderedIssue:
    """What the order in the file makes, all or nothing.

    KeystoreError if it cannot be read, other errors as of `ordered_issue`. VerificationError also
    unless the domain file names this order for each of its participants, with the rights of the
    grant, and for as long.
    """
    with located(path):
        try:
            asked = order_in(path)
        except FileError as error:
            raise KeystoreError(str(error)) from error
        found = ordered_issue(asked, keystore, now=now)
        if problems := [each for spec in found.specs for each in _problems(spec, members, path)]:
            raise VerificationError(*problems)
    return found


def steps_of(found: OrderedIssue) -> tuple[Step, ...]:
    """The steps of an order, one for each participant."""
    return tuple(
        Step(
            StepAction.ENROL,
            spec.name,
            f"ordered by {found.authority}, for {days(spec.validity)}",
            hashes_in(spec.keys),
            found.keystore.approved,
        )
        for spec in found.specs
    )


def _problems(spec: ParticipantSpec, members: Mapping[str, Member], path: Path) -> Iterator[str]:
    member = members.get(spec.name)
    if member is None or not member.by_order or member.request != path:
        yield f"{spec.name}: the domain file does not name this order for it"
        return
    [granted], [wanted] = spec.grants, member.spec().grants
    if (granted.rules, granted.default) != (wanted.rules, wanted.default):
        yield f"{spec.name}: its role ({member.role.label}) has other rights in the grant"
    if spec.validity > member.validity:
        yield (
            f"{spec.name}: {days(spec.validity)} were ordered, and the domain file has"
            f" {days(member.validity)}"
        )
