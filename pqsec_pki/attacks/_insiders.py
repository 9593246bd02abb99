"""The attacker is a participant with a genuine certificate and key, and wants more rights."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import field, fields, replace
from datetime import datetime
from typing import Any

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import KeyAgreement, KeyPair
from pqsec_pki.attacks._context import AttackContext, Attempt, with_identity
from pqsec_pki.attacks._forgery import Keys, issued, signed_alike, without_countersignature
from pqsec_pki.attacks._relays import Edit
from pqsec_pki.attacks.attack import Attack, Attacker, two_keys
from pqsec_pki.certificates import Authority
from pqsec_pki.credentials import Credentials
from pqsec_pki.documents import Grant, Permissions, parse_subject, same_subject
from pqsec_pki.errors import MalformedError
from pqsec_pki.handshake import adjusted_guid
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck import HandshakeSession, SessionSide
from pqsec_pki.smime import Signer, document_in, sign


def issue_certificates(context: AttackContext) -> Iterator[Attempt]:
    """Issue a certificate for its own name with its own key, as if it were a CA."""

    def prolonged(side: SessionSide, _: SessionSide) -> SessionSide:
        own = side.participant
        ca, keys = (
            Authority(own.certificate, own.key, own.alternative_key),
            Keys.like(own.certificate),
        )
        certificate = issued(ca, side.name, keys, context.session.now)
        return with_identity(side, certificate=certificate, key=keys.both)

    return context.impersonating("a participant as CA", prolonged)


def claim_guid(context: AttackContext) -> Iterator[Attempt]:
    """Use a GUID that belongs to another subject name."""

    def claiming(side: SessionSide, _: SessionSide) -> SessionSide:
        another = side.participant.identity_ca.subject_der
        return with_identity(side, guid=adjusted_guid(another, side.guid))

    return context.impersonating("another's GUID", claiming)


# Permissions


Forger = Callable[[Credentials, Credentials, datetime], bytes]
"""Returns the permissions that the first shows, given the credentials of the second."""


def borrow_permissions(context: AttackContext) -> Iterator[Attempt]:
    """Show the permissions of the other, known from an earlier handshake."""
    return _permitted(context, "the other's", lambda _, other, __: other.permissions)


def shared_permissions(session: HandshakeSession) -> str | None:
    """Why borrowing permissions is not an attack: a grant is for the borrower too; else None."""
    one, other = session.sides
    for borrower, lender in ((one, other), (other, one)):
        document = Permissions.from_xml(document_in(lender.participant.permissions))
        if any(_is_for(borrower, grant) for grant in document.grants):
            return f"the permissions of {lender.name} are for {borrower.name} too"
    return None


def _is_for(side: SessionSide, grant: Grant) -> bool:
    own = parse_subject(side.participant.certificate.subject_name)
    with suppress(MalformedError):  # a text that is not a name matches no subject
        return same_subject(parse_subject(grant.subject_name), own)
    return False


def forge_permissions(context: AttackContext) -> Iterator[Attempt]:
    """Show permissions that the permissions CA did not sign."""
    for what, forger in _FORGERS.items():
        yield from _permitted(context, what, forger)


def strip_countersignature(context: AttackContext) -> Iterator[Attempt]:
    """Show its own permissions without the post-quantum signature."""
    return _permitted(
        context, "one signature alone", lambda own, *_: without_countersignature(own.permissions)
    )


def _permitted(context: AttackContext, what: str, forger: Forger) -> Iterator[Attempt]:
    def permitted(side: SessionSide, peer: SessionSide) -> SessionSide:
        permissions = forger(side.participant, peer.participant, context.session.now)
        return with_identity(side, permissions=permissions)

    with suppress(MalformedError):  # messages of the second version carry signed documents only
        yield from context.impersonating(what, permitted)


def _by_another_ca(own: Credentials, _: Credentials, now: datetime) -> bytes:
    document = document_in(own.permissions)
    return signed_alike(document, own.permissions_ca, own.countersigner, now)


def _by_itself(own: Credentials, _: Credentials, now: datetime) -> bytes:
    return sign(document_in(own.permissions), Signer(own.certificate, own.key), now=now)


def _renamed(own: Credentials, other: Credentials, _: datetime) -> bytes:
    theirs, ours = (each.certificate.subject_name.encode() for each in (other, own))
    return other.permissions.replace(theirs, ours)


_FORGERS: Mapping[str, Forger] = {
    "by a CA of the same name": _by_another_ca,
    "by its own key": _by_itself,
    "the other's, with its own name": _renamed,
    "not signed": lambda own, *_: document_in(own.permissions),
    "none": lambda *_: b"",
}


# Keys for the key agreement


@dataclass(frozen=True, slots=True, kw_only=True)
class _Corrupted(KeyAgreement):
    """A key agreement whose public keys and ciphertexts are corrupted."""

    row: KeyAgreement = field(repr=False)
    corrupt: Edit = field(repr=False)

    @classmethod
    def of(cls, row: KeyAgreement, corrupt: Edit) -> "_Corrupted":
        kept = {each.name: getattr(row, each.name) for each in fields(KeyAgreement)}
        return cls(**kept, row=row, corrupt=corrupt)

    def _fits(self, data: bytes, size: int) -> bool:
        del data, size
        return True  # the genuine row checks the size

    def _generate(self) -> KeyPair:
        return self.row.generate()

    def _public(self, handle: Any) -> bytes:
        return self.corrupt(handle.public)

    def _encapsulate(self, public: bytes) -> tuple[bytes, bytes]:
        ciphertext, secret = self.row.encapsulate(public)
        return self.corrupt(ciphertext), secret

    def _decapsulate(self, handle: Any, ciphertext: bytes) -> bytes:
        secret: bytes = handle.decapsulate(ciphertext)
        return secret


_CORRUPTIONS: Mapping[str, Edit] = {
    "a byte short": lambda value: value[:-1],
    "a byte long": lambda value: value + b"\0",
    "empty": lambda _: b"",
    "a zero byte, which is infinity": lambda _: b"\0",
    "all 0xff": lambda value: b"\xff" * len(value),
    "all zero": lambda value: bytes(len(value)),
    "the last 32 bytes zero": lambda value: value[:-32] + bytes(32),
    "the first byte changed": lambda value: bytes([value[0] ^ 1]) + value[1:],
    "the last byte changed": lambda value: value[:-1] + bytes([value[-1] ^ 1]),
}
"""Some results are still valid public keys or ciphertexts, of a secret that neither side has."""


def send_bad_public_keys(context: AttackContext) -> Iterator[Attempt]:
    """Send a bad dh1. No signature covers it yet, so an attacker on the way can do this too."""
    one, _ = context.session.sides
    for what, corrupt in _CORRUPTIONS.items():
        row = _Corrupted.of(context.session.agreement, corrupt)
        yield Attempt(what, replace(context.session, agreement=row), one.name)


def sign_bad_ciphertexts(context: AttackContext) -> Iterator[Attempt]:
    """Send a bad dh2, under a valid signature.

    One that is still a valid ciphertext shows in the first protected message, to the side
    that reads first: so the attacker's side may be the one that refuses.
    """
    _, other = context.session.sides
    for what, corrupt in _CORRUPTIONS.items():
        row = _Corrupted.of(context.session.agreement, corrupt)
        policy = replace(other.terms.policy, agreements=(row,))
        replier = replace(other, terms=replace(other.terms, policy=policy))
        yield Attempt(what, replace(context.session, replier=replier))


ATTACKS = (
    Attack(
        name="participant-as-ca",
        attacker=Attacker.INSIDER,
        title="issues a certificate with its own key, as if it were a CA",
        refused_at=("reply", "final"),
        checks=(Code.WRONG_ISSUER, Code.ALTERNATIVE_BAD),
        act=issue_certificates,
    ),
    Attack(
        name="claimed-guid",
        attacker=Attacker.INSIDER,
        title="claims a GUID that belongs to another participant",
        refused_at=("reply", "final"),
        checks=(Code.C11,),
        act=claim_guid,
    ),
    Attack(
        name="borrowed-permissions",
        attacker=Attacker.INSIDER,
        title="shows the permissions of another participant",
        refused_at=("admits",),
        checks=(Code.NO_GRANT,),
        act=borrow_permissions,
        not_applicable=shared_permissions,
    ),
    Attack(
        name="forged-permissions",
        attacker=Attacker.INSIDER,
        title="shows permissions that the permissions CA never signed",
        refused_at=("admits",),
        checks=(Code.WRONG_SIGNER, Code.CONTENT_CHANGED, Code.NOT_SIGNED, Code.SIGNATURE_MISSING),
        act=forge_permissions,
    ),
    Attack(
        name="stripped-permissions",
        attacker=Attacker.QUANTUM,
        title="removes the post-quantum signature from its permissions",
        refused_at=("admits",),
        checks=(Code.SIGNATURE_MISSING,),
        act=strip_countersignature,
        not_applicable=two_keys,
    ),
    Attack(
        name="bad-public-key",
        attacker=Attacker.INSIDER,
        title="sends invalid key-agreement keys: of a wrong size, off the curve, all zero",
        refused_at=("reply", "message"),
        checks=(Code.C17, Code.C26),
        act=send_bad_public_keys,
    ),
    Attack(
        name="bad-ciphertext",
        attacker=Attacker.INSIDER,
        title="answers with a changed ciphertext or public key, and signs it",
        refused_at=("final", "message"),
        checks=(Code.C22, Code.C26),
        act=sign_bad_ciphertexts,
    ),
)
