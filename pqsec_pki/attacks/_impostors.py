"""The attacker in the place of a participant: without its key, or with an invalid certificate."""

from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime, timedelta
from functools import partial

from pqsec_pki.attacks._context import AttackContext, Attempt, with_identity
from pqsec_pki.attacks._forgery import (
    YEAR,
    Keys,
    issued,
    list_of,
    self_signed_authority,
    with_broken_key,
    without_alternative_signature,
)
from pqsec_pki.attacks._relays import Edit, editing
from pqsec_pki.attacks.attack import Attack, Attacker, two_keys
from pqsec_pki.certificates import BACKDATE, Authority, Certificate
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck import SessionSide

_MOMENT = timedelta(seconds=1)
_HOUR = timedelta(hours=1)


def copy_certificate(context: AttackContext) -> Iterator[Attempt]:
    """Use the certificate and permissions, which are sent in the clear, without the key."""
    return context.impersonating(
        "another key", lambda side, _: with_identity(side, key=_new_keys(side).both)
    )


def create_own_ca(context: AttackContext) -> Iterator[Attempt]:
    """Use a certificate issued by a CA of the attacker."""
    now = context.session.now
    genuine = context.session.initiator.participant.identity_ca
    for what, name in (("the same name", None), ("another name", "Another CA")):
        ca = self_signed_authority(genuine, now, name)
        yield from context.impersonating(f"a CA of {what}", partial(_certified_by, ca, now))


def sign_own_certificate(context: AttackContext) -> Iterator[Attempt]:
    """Use a certificate signed with its own key."""

    def self_signed(side: SessionSide, _: SessionSide) -> SessionSide:
        own = self_signed_authority(side.participant.certificate, context.session.now)
        keys = Keys(plain=own.key, alternative=own.alternative_key)
        return with_identity(side, certificate=own.certificate, key=keys.both)

    return context.impersonating("a self-signed certificate", self_signed)


def use_expired_certificate(context: AttackContext) -> Iterator[Attempt]:
    """Use an expired certificate; the permissions are still valid, so only C10 refuses it."""
    ca, context = issue_by_unknown_intermediate(context)
    now = context.session.now
    ended = partial(_certified_for, ca, now - _HOUR, _HOUR - _MOMENT)
    return context.impersonating("a second after the end", ended)


def use_future_certificate(context: AttackContext) -> Iterator[Attempt]:
    """Use a certificate before it is valid."""
    ca, context = issue_by_unknown_intermediate(context)
    begins = context.session.now + _MOMENT + BACKDATE
    return context.impersonating(
        "a second before the begin", partial(_certified_for, ca, begins, YEAR)
    )


def use_revoked_certificate(context: AttackContext) -> Iterator[Attempt]:
    """Use a certificate that is on the CA's revocation list."""
    ca, context = issue_by_unknown_intermediate(context)
    one, other = context.session.sides
    now = context.session.now
    check = replace(
        context.session,
        initiator=with_identity(one, revocation_list=list_of(ca, other.terms.own.certificate, now)),
        replier=with_identity(other, revocation_list=list_of(ca, one.terms.own.certificate, now)),
    )
    unaware = replace(context, session=check)
    return unaware.impersonating(
        "on the list", lambda side, _: with_identity(side, revocation_list=None)
    )


def issue_by_unknown_intermediate(context: AttackContext) -> tuple[Authority, AttackContext]:
    """A new CA in place of the genuine one, whose key is missing, and both certified by it.

    It has revoked no certificate, and the genuine CA's revocation list is not its own.
    """
    now = context.session.now
    ca = self_signed_authority(context.session.initiator.participant.identity_ca, now)
    one, other = (
        with_identity(_certified_by(ca, now, side, side), ca=ca.certificate, revocation_list=None)
        for side in context.session.sides
    )
    return ca, replace(context, session=replace(context.session, initiator=one, replier=other))


def _certified_for(
    ca: Authority, begin: datetime, validity: timedelta, side: SessionSide, _: SessionSide
) -> SessionSide:
    """New keys, and a certificate for them that is valid from a day before `begin`, as usual."""
    keys = _new_keys(side)
    certificate = issued(ca, side.name, keys, begin, validity)
    return with_identity(side, certificate=certificate, key=keys.both)


# With a quantum computer, which computes plain private keys


def sign_plainly(context: AttackContext) -> Iterator[Attempt]:
    """Sign with the plain key alone, as for a stock stack."""
    return context.impersonating(
        "the plain key alone", lambda side, _: with_identity(side, key=side.participant.key)
    )


def sign_half(context: AttackContext) -> Iterator[Attempt]:
    """Sign as with both keys, but with another key for one half, or without that half."""

    def halves(side: SessionSide, _: SessionSide, half: str) -> SessionSide:
        own = {half: getattr(Keys.of(side.participant), half)}
        return with_identity(side, key=replace(_new_keys(side), **own).both)

    for half in ("plain", "alternative"):
        yield from context.impersonating(
            f"the {half} key and a new one", partial(halves, half=half)
        )
    for half, cut in _cuts(context.session.initiator).items():
        for message in ("reply", "final"):
            relay = editing(message, "signature", cut)
            yield context.between(f"the {half} signature alone in the {message}", relay)


def _cuts(side: SessionSide) -> dict[str, Edit]:
    """Edits that keep one half; the alternative signature comes first and has a fixed size."""
    second = side.participant.alternative_key
    cut = second.algorithm.signature_size if second else 0
    return {"plain": lambda both: both[cut:], "alternative": lambda both: both[:cut]}


def strip_certificate(context: AttackContext) -> Iterator[Attempt]:
    """Use the genuine certificate and keys, without the CA's alternative signature."""
    genuine_ca = context.session.initiator.participant.identity_ca
    key = Keys.like(genuine_ca).plain
    context = _trusted_by_both(with_broken_key(genuine_ca, key), context)

    def stripped(side: SessionSide, _: SessionSide) -> SessionSide:
        genuine = side.participant.certificate
        less = without_alternative_signature(genuine, key)
        return with_identity(side, certificate=less, ca=genuine_ca)

    return context.impersonating("no alternative signature", stripped)


def break_the_ca(context: AttackContext) -> Iterator[Attempt]:
    """Use a certificate signed with the CA's plain key."""
    now = context.session.now
    genuine = context.session.initiator.participant.identity_ca
    own = Keys.like(genuine)
    broken = with_broken_key(genuine, own.plain)
    context = _trusted_by_both(broken, context)
    for what, second in (("no", None), ("its own", own.alternative)):
        ca = Authority(broken, own.plain, second)
        impersonation = partial(_certified_by, ca, now)
        yield from context.impersonating(f"{what} alternative signature", impersonation)


def _trusted_by_both(ca: Certificate, context: AttackContext) -> AttackContext:
    one, other = (
        with_identity(side, ca=ca, revocation_list=None) for side in context.session.sides
    )
    return replace(context, session=replace(context.session, initiator=one, replier=other))


def _certified_by(ca: Authority, now: datetime, side: SessionSide, _: SessionSide) -> SessionSide:
    """New keys, and a certificate for them by `ca`; the peer is checked with the genuine CA."""
    keys = _new_keys(side)
    certificate = issued(ca, side.name, keys, now)
    genuine = side.participant.identity_ca
    return with_identity(side, certificate=certificate, key=keys.both, ca=genuine)


def _new_keys(side: SessionSide) -> Keys:
    """New keys of the same algorithms as the participant's."""
    return Keys.like(side.participant.certificate)


ATTACKS = (
    Attack(
        name="copied-certificate",
        attacker=Attacker.OUTSIDER,
        title="shows the certificate of a participant, without having its key",
        refused_at=("final", "authenticated"),
        checks=(Code.C21, Code.C24),
        act=copy_certificate,
    ),
    Attack(
        name="own-ca",
        attacker=Attacker.OUTSIDER,
        title="creates a CA of the same name, and issues certificates with it",
        refused_at=("reply", "final"),
        checks=(Code.WRONG_ISSUER, Code.BAD_SIGNATURE, Code.ALTERNATIVE_BAD),
        act=create_own_ca,
    ),
    Attack(
        name="self-signed",
        attacker=Attacker.OUTSIDER,
        title="shows a certificate that it signed itself",
        refused_at=("reply", "final"),
        checks=(Code.WRONG_ISSUER, Code.NOT_PARTICIPANT, Code.ALTERNATIVE_BAD),
        act=sign_own_certificate,
    ),
    Attack(
        name="expired",
        attacker=Attacker.INSIDER,
        title="uses its certificate after it expired",
        refused_at=("reply", "final"),
        checks=(Code.EXPIRED,),
        act=use_expired_certificate,
    ),
    Attack(
        name="not-yet-valid",
        attacker=Attacker.INSIDER,
        title="uses its certificate before it is valid",
        refused_at=("reply", "final"),
        checks=(Code.NOT_YET_VALID,),
        act=use_future_certificate,
    ),
    Attack(
        name="revoked",
        attacker=Attacker.INSIDER,
        title="uses its certificate after it was revoked",
        refused_at=("reply", "final"),
        checks=(Code.REVOKED,),
        act=use_revoked_certificate,
    ),
    Attack(
        name="plain-signature",
        attacker=Attacker.QUANTUM,
        title="signs with the classical key alone, as a stock stack does",
        refused_at=("reply", "final"),
        checks=(Code.C16,),
        act=sign_plainly,
        not_applicable=two_keys,
    ),
    Attack(
        name="half-signature",
        attacker=Attacker.QUANTUM,
        title="signs with one of the two keys, and with no key or another key for the second",
        refused_at=("final", "authenticated"),
        checks=(Code.C21, Code.C24),
        act=sign_half,
        not_applicable=two_keys,
    ),
    Attack(
        name="stripped-certificate",
        attacker=Attacker.QUANTUM,
        title="removes the CA's post-quantum signature from the certificate",
        refused_at=("reply", "final"),
        checks=(Code.ALTERNATIVE_MISSING,),
        act=strip_certificate,
        not_applicable=two_keys,
    ),
    Attack(
        name="broken-ca",
        attacker=Attacker.QUANTUM,
        title="issues itself certificates with the classical key of the CA",
        refused_at=("reply", "final"),
        checks=(Code.ALTERNATIVE_MISSING, Code.ALTERNATIVE_BAD),
        act=break_the_ca,
        not_applicable=two_keys,
    ),
)
