"""The attacker wants to be met with a weaker set of credentials, or mixes what two sets have.

The first set is classical: somebody with a quantum computer has the private keys of its CAs. So a
participant meets with it only those that its policy names.
"""

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace

from pqsec_pki.algorithms import KeyAgreement
from pqsec_pki.attacks._context import AttackContext, Attempt, with_identity
from pqsec_pki.attacks._forgery import Keys, issued, with_broken_key
from pqsec_pki.attacks.attack import COVERED, TRANSCRIPT, Attack, Attacker
from pqsec_pki.certificates import Authority, Certificate, common_name
from pqsec_pki.errors import UsageError
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck import (
    HandshakeRun,
    HandshakeSession,
    SessionSide,
    SideSets,
    Steps,
    StoppedError,
)

_COLLIDING = "/a name with the same 47 bits"
_Forge = Callable[[SessionSide], SessionSide]
"""Takes a participant, and returns the attacker in its place."""


def several_sets(session: HandshakeSession) -> str | None:
    """Why the attacks are not on that session; None if they are."""
    for side in session.sides:
        if side.sets is None:
            return f"{side.name} has one set of credentials here"
        if side.sets.row.is_stock:
            return f"{side.name} may meet its peer with the first set: that is its policy"
    return None


def show_weaker_set(context: AttackContext) -> Iterator[Attempt]:
    """Show genuine credentials of the first set, and announce no other."""
    return _with_first_sets(context, "the first set alone", _first)


def issue_in_weaker_set(context: AttackContext) -> Iterator[Attempt]:
    """Use a certificate that it issued with the private key of the first set's CA."""
    first = _first(context.session.initiator)
    genuine, now = first.terms.own.ca, context.session.now
    key = Keys.like(genuine).plain
    broken = with_broken_key(genuine, key)
    one, other = (_trusting(each, broken) for each in context.session.sides)
    context = replace(context, session=replace(context.session, initiator=one, replier=other))

    def forged(side: SessionSide) -> SessionSide:
        keys = Keys.like(_first(side).participant.certificate)
        certificate = issued(Authority(broken, key), side.name, keys, now)
        return with_identity(_first(side), certificate=certificate, key=keys.both, ca=genuine)

    return _with_first_sets(context, "a forged certificate of the first set", forged)


def announce_other_name(context: AttackContext) -> Iterator[Attempt]:
    """Announce the name of one that the policy names, found so that its GUID is the same."""

    def deceived(side: SessionSide) -> SessionSide:
        sets = _sets_of(side)
        row = replace(sets.row, subject=common_name(_COLLIDING), is_stock=True)
        return replace(side, sets=replace(sets, row=row))

    one, other = map(deceived, context.session.sides)
    context = replace(context, session=replace(context.session, initiator=one, replier=other))
    yield from _with_first_sets(context, "another's announced name", _first)


def mix_documents(context: AttackContext) -> Iterator[Attempt]:
    """Show the strongest set's certificate with the permissions of the first set."""

    def mixed(side: SessionSide, _: SessionSide) -> SessionSide:
        return with_identity(side, permissions=_first(side).terms.own.permissions)

    return context.impersonating("permissions of the first set", mixed)


def replay_weaker_set(context: AttackContext) -> Iterator[Attempt]:
    """Replay messages of a handshake with the first set."""
    one, other = map(_first, context.session.sides)
    agreement = _agreement_of(one)
    earlier = replace(context.session, initiator=one, replier=other, agreement=agreement)
    run = HandshakeRun(earlier, Steps())
    with suppress(StoppedError):
        run.perform()
    recorded = {each.name: each.data for each in run.sent}
    for name in ("request", "reply", "final"):

        def relay(sent: str, data: bytes, name: str = name) -> bytes:
            return recorded[name] if sent == name else data

        yield context.between(f"the {name} of the first set", relay)


def _with_first_sets(context: AttackContext, what: str, forge: _Forge) -> Iterator[Attempt]:
    """Attempts with the attacker's first set in the place of the initiator, then of the replier."""
    session = context.session
    one, other = session.sides
    attacker = forge(one)
    asking = replace(session, initiator=attacker, agreement=_agreement_of(attacker))
    yield Attempt(f"{what}, as initiator", asking, one.name)
    attacker = with_identity(forge(other), ca=_sets_of(one).sides[-1].terms.own.ca)
    policy = replace(attacker.terms.policy, agreements=(session.agreement,))
    attacker = replace(attacker, terms=replace(attacker.terms, policy=policy))
    yield Attempt(f"{what}, as replier", replace(session, replier=attacker), other.name)


def _sets_of(side: SessionSide) -> SideSets:
    """Its sets, which `several_sets` found."""
    if side.sets is None:
        raise UsageError(f"{side.name} has one set of credentials")
    return side.sets


def _first(side: SessionSide) -> SessionSide:
    return _sets_of(side).sides[0]


def _trusting(side: SessionSide, broken: Certificate) -> SessionSide:
    """The side with that identity CA in its first set."""
    sets = _sets_of(side)
    first = with_identity(sets.sides[0], ca=broken, revocation_list=None)
    return replace(side, sets=replace(sets, sides=(first, *sets.sides[1:])))


def _agreement_of(side: SessionSide) -> KeyAgreement:
    return side.terms.policy.agreements[0]


_WEAKER = (Code.C30, Code.WRONG_ISSUER)
"""A Request with a weaker set is refused by policy; a Reply is verified with the Request's set."""

_OWN_SIGNER = "the permissions of each set have a signer of their own"

ATTACKS = (
    Attack(
        name="weaker-set",
        attacker=Attacker.QUANTUM,
        title="shows genuine credentials of the first set, and announces no other",
        refused_at=("reply", "final"),
        checks=_WEAKER,
        also=(Code.WRONG_SIGNER,),
        because=_OWN_SIGNER,
        act=show_weaker_set,
        not_applicable=several_sets,
    ),
    Attack(
        name="forged-weaker-set",
        attacker=Attacker.QUANTUM,
        title="issues itself certificates with the key of the first set's CA",
        refused_at=("reply", "final"),
        checks=_WEAKER,
        also=(Code.WRONG_SIGNER,),
        because=_OWN_SIGNER,
        act=issue_in_weaker_set,
        not_applicable=several_sets,
    ),
    Attack(
        name="other-name",
        attacker=Attacker.INSIDER,
        title="announces the name of a participant that may be met with the first set",
        refused_at=("reply", "final"),
        checks=(Code.C29, Code.WRONG_ISSUER),
        also=(Code.WRONG_SIGNER,),
        because=_OWN_SIGNER,
        act=announce_other_name,
        not_applicable=several_sets,
    ),
    Attack(
        name="mixed-sets",
        attacker=Attacker.QUANTUM,
        title="shows a certificate of the strongest set with permissions of the first set",
        refused_at=("admits",),
        checks=(Code.WRONG_SIGNER,),
        act=mix_documents,
        not_applicable=several_sets,
    ),
    Attack(
        name="replay-weaker-set",
        attacker=Attacker.OUTSIDER,
        title="replays messages of a handshake with the first set",
        refused_at=("reply", "final", "authenticated"),
        checks=(*_WEAKER, Code.C18, Code.C19, Code.C20, Code.C23),
        also=(*TRANSCRIPT, Code.C14, Code.C22, Code.WRONG_SIGNER),
        because=f"{COVERED}; {_OWN_SIGNER}",
        act=replay_weaker_set,
        not_applicable=several_sets,
    ),
)
