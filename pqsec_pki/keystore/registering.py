"""The ledger's lines about registration authorities: their grants, and the orders performed.

A grant is a line, and its end before its time is another one. The line of an order is written with
the certificates, so how many a grant was used for is what the ledger says.
"""

from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime

from pqsec_pki._dataclass import dataclass
from pqsec_pki._times import said
from pqsec_pki.algorithms import PublicKey
from pqsec_pki.approvals import EnrolmentOrder, RegistrationGrant, SignedGrant
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import KeystoreError, MalformedError, VerificationError, meant
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.problems import Code

GRANT, GRANT_END, ORDER = "ra-grant", "ra-end", "ra-order"
"""Kinds of lines."""
_STATEMENT, _GRANT, _COUNT = "statement", "grant", "participants"


@dataclass(frozen=True, slots=True)
class Registration:
    """A grant in the ledger, and what became of it."""

    signed: SignedGrant
    number: int
    """The number of its line."""
    revoked: bool
    orders: Mapping[str, int]
    """How many participants each order enrolled, by its digest."""

    @property
    def grant(self) -> RegistrationGrant:
        """The grant that the identity CA signed."""
        return self.signed.grant

    @property
    def used(self) -> int:
        """How many participants were enrolled by it."""
        return sum(self.orders.values())

    def state(self, now: datetime) -> str:
        """In one word."""
        if self.revoked:
            return "revoked"
        if now >= self.grant.ends:
            return "expired"
        if self.used >= self.grant.most:
            return "used up"
        return "valid" if now >= self.grant.begins else "not yet valid"

    def ended(self, now: datetime) -> bool:
        """Whether it can never be used again."""
        return self.revoked or now >= self.grant.ends

    def to_json(self, now: datetime) -> dict[str, object]:
        """The grant for --json."""
        return {
            "state": self.state(now),
            "used": self.used,
            "sha256": self.grant.digest,
            **self.grant.to_json(),
        }

    def refuse_ended(self, now: datetime) -> None:
        """VerificationError unless it is in force; it may be used up."""
        grant = self.grant
        if self.revoked:
            raise VerificationError(f"the grant of {grant.authority} was revoked")
        if now >= grant.ends:
            raise VerificationError(
                f"the grant of {grant.authority} expired on {said(grant.ends)}",
                code=Code.EXPIRED,
                hint="`pqsec ra add` makes another one",
            )
        if now < grant.begins:
            raise VerificationError(
                f"the grant of {grant.authority} begins on {said(grant.begins)}",
                code=Code.NOT_YET_VALID,
            )


def grant_entry(signed: SignedGrant, now: datetime) -> Entry:
    """The line with a grant."""
    grant = signed.grant
    details = {"limits": str(grant), _STATEMENT: signed.to_file().decode()}
    return Entry.of(
        GRANT, grant.authority, grant.digest, now, not_after=grant.ends, details=details
    )


def grant_end_entry(grant: RegistrationGrant, now: datetime) -> Entry:
    """The line with which a grant ends."""
    return Entry.of(GRANT_END, grant.authority, grant.digest, now)


def order_entry(order: EnrolmentOrder, authority: str, now: datetime) -> Entry:
    """The line of an order, which is written with its certificates."""
    details = {
        _GRANT: order.grant,
        _COUNT: str(len(order.items)),
        _STATEMENT: order.to_file().decode(),
    }
    return Entry.of(ORDER, authority, order.digest, now, details=details)


def order_in(entry: Entry) -> EnrolmentOrder:
    """The order in a line of that kind; KeystoreError if that is damaged."""
    try:
        found = EnrolmentOrder.from_file(str(entry.details.get(_STATEMENT, "")).encode())
    except MalformedError as error:
        raise entry.damaged(str(error)) from error
    if found.digest != entry.sha256:
        raise entry.damaged("it has another order")
    return found


def registrations(keystore: Keystore) -> list[Registration]:
    """All grants of the ledger, oldest first; KeystoreError if a line is damaged."""
    with keystore.open_ledger() as ledger:
        lines, numbers = ledger.of_kind(GRANT), ledger.numbers(GRANT)
        ended = ledger.numbers(GRANT_END)
        orders: dict[str, dict[str, int]] = {}
        for each in ledger.of_kind(ORDER):
            orders.setdefault(each.details.get(_GRANT, ""), {})[each.sha256] = _count(each)
    return [
        Registration(
            signed=_signed(each),
            number=numbers[each.sha256],
            revoked=each.sha256 in ended,
            orders=orders.get(each.sha256, {}),
        )
        for each in lines
    ]


def registrations_of(known: Sequence[Registration], name: str) -> list[Registration]:
    """The grants of the registration authority with that name; KeystoreError if there is none."""
    own = [each for each in known if each.grant.authority == name]
    if not own:
        raise KeystoreError(
            f"there is no registration authority {name}",
            hint=meant(name, [each.grant.authority for each in known])
            or "`pqsec ra list` shows them",
        )
    return own


def registration(keystore: Keystore, digest: str) -> Registration:
    """The grant with that digest, which is in the ledger, and which its identity CA signed.

    VerificationError if there is none.
    """
    for each in registrations(keystore):
        if each.grant.digest == digest:
            each.signed.verify([*_keys(keystore.identity_ca)])
            _refuse_foreign(keystore, each.grant)
            return each
    raise VerificationError(
        "it was ordered by a grant that this keystore does not have",
        code=Code.WRONG_SUBJECT,
        hint="`pqsec ra list` shows the grants; a grant from before `ca rotate` was for another CA",
    )


def _refuse_foreign(keystore: Keystore, grant: RegistrationGrant) -> None:
    with keystore.open_ledger() as ledger:
        if grant.ledger != ledger.origin:
            raise VerificationError(
                f"the grant of {grant.authority} is for another keystore: {grant.ledger}",
                code=Code.WRONG_SUBJECT,
            )


def enrolled_by(keystore: Keystore, authority: str) -> list[str]:
    """The participants that the orders of that registration authority enrolled, by all grants."""
    orders = {
        order
        for each in registrations(keystore)
        if each.grant.authority == authority
        for order in each.orders
    }
    with keystore.open_ledger() as ledger:
        lines = ledger.of_kind("participant")
    return list(dict.fromkeys(each.name for each in lines if each.details.get("request") in orders))


def predates_approvals(keystore: Keystore, found: Registration) -> bool:
    """Whether the present rule of approvals is newer than the grant, which then has no
    approvals."""
    with keystore.open_ledger() as ledger:
        return found.number < max(ledger.numbers("approvals").values(), default=0)


def _keys(ca: Certificate) -> Iterator[PublicKey]:
    yield ca.public_key
    if ca.alternative_key:
        yield ca.alternative_key


def _count(entry: Entry) -> int:
    text = entry.details.get(_COUNT, "")
    if not text.isascii() or not text.isdigit():
        raise entry.damaged("no number")
    return int(text)


def _signed(entry: Entry) -> SignedGrant:
    try:
        found = SignedGrant.from_file(str(entry.details.get(_STATEMENT, "")).encode())
    except MalformedError as error:
        raise entry.damaged(str(error)) from error
    if found.grant.digest != entry.sha256:
        raise entry.damaged("it has another grant")
    return found
