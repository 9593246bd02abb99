"""Check a participant's own credentials and its peer's permissions, with words for the user.

The room `credentials` decides what can be trusted. This module adds hints, and checks what
the keystore's profile requires in addition.
"""

from collections.abc import Iterator
from dataclasses import field
from datetime import datetime

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access import INTERPRETATIONS, Action, InterpretedPolicy, Question, may_join
from pqsec_pki.algorithms import Profile
from pqsec_pki.certificates import Certificate
from pqsec_pki.credentials import (
    CERTIFICATE,
    Credentials,
    SignedDocument,
    grant_of,
    identity_problems,
)
from pqsec_pki.documents import DomainRule, Governance, Permissions
from pqsec_pki.errors import VerificationError
from pqsec_pki.problems import Code, Problem
from pqsec_pki.selfcheck.stacks import SimulatedStack

_OLD_LIST = "`pqsec ca crl` issues a new revocation list; copy it to every robot"
_RENEW = "reissue it: `pqsec renew {name}` keeps its permissions"
_HINTS = {
    Code.EXPIRED: "`pqsec renew {name}` renews a participant, `pqsec ca rotate` replaces a CA",
    Code.REVOKED: "to issue {name} again, use `pqsec issue` with --force --after-revocation",
    Code.LIST_EXPIRED: _OLD_LIST,
    Code.LIST_NOT_YET_VALID: _OLD_LIST,
    Code.LIST_WRONG_ISSUER: _OLD_LIST,
    Code.LIST_BAD_SIGNATURE: _OLD_LIST,
    Code.LIST_SCOPE: _OLD_LIST,
    Code.ONE_KEY_TWO_ROLES: "create two distinct CA keys: `pqsec ca rotate`",
    Code.KEY_MISMATCH: _RENEW,
    Code.WRONG_SUBJECT: _RENEW,
    Code.PROFILE_MISMATCH: _RENEW,
}
"""How to fix a problem, by its code."""


@dataclass(frozen=True, slots=True)
class Applicant:
    """A remote participant that wants to join a domain; nothing about it is verified yet."""

    name: str
    certificate: Certificate
    permissions: bytes = field(repr=False)
    """The signed permissions document."""


def renewal(name: str) -> str:
    """A hint how to get a new key and certificate without losing permissions."""
    return f"`pqsec renew {name}` keeps its permissions"


def check_identity(participant: Credentials, profile: Profile, now: datetime) -> str:
    """Verify the certificate chain and the keys, and describe them; VerificationError."""
    _refuse(
        participant.name,
        *identity_problems(participant, now),
        *_profile_problems(participant, profile),
    )
    ca = participant.identity_ca
    also = f", and by {profile.alternative_key.name}" if profile.alternative_key else ""
    signer = f"{ca.subject_name} ({_name(ca)}{also})"
    return f"{participant.certificate.subject_name} signed by {signer}"


def check_documents(
    participant: Credentials, domain: int, now: datetime, stack: SimulatedStack
) -> str:
    """Verify its governance and permissions, and describe them; VerificationError."""
    _refuse(participant.name, *participant.anchors.problems(now))
    governance = participant.anchors.governance(participant.governance, now)
    itself = Applicant(participant.name, participant.certificate, participant.permissions)
    own = check_permissions(participant, itself, domain, now, stack)
    return f"governance signed by {_signers(governance)}; {own}"


def check_permissions(
    judge: Credentials, applicant: Applicant, domain: int, now: datetime, stack: SimulatedStack
) -> str:
    """The rule by which `judge` lets `applicant` join `domain`, in words. VerificationError if not.

    The signature, the subject, the validity and the domain of the applicant's
    permissions, against the judge's permissions CA and governance
    (validate_remote_permissions).
    """
    governance = judge.anchors.governance(judge.governance, now)
    signed = judge.anchors.permissions(applicant.permissions, now)
    subject = applicant.certificate.subject_name
    _refuse_crash(stack, governance.value, signed.value, applicant, now)
    decision = may_join(governance.value, signed.value, subject, domain, now)
    if not decision.allowed:
        code = _code(applicant.certificate, signed.value, governance.value.rule_for(domain), now)
        raise VerificationError(
            f"{applicant.name} may not join domain {domain}: {decision.reason}",
            code=code,
            hint="the governance and the permissions must name the domain"
            if code is Code.NO_DOMAIN_RULE
            else f"`pqsec explain --participant {applicant.name} --join` shows where it may",
        )
    return f"permissions signed by {_signers(signed)}; {decision.reason}"


def _refuse_crash(
    stack: SimulatedStack,
    governance: Governance,
    permissions: Permissions,
    applicant: Applicant,
    now: datetime,
) -> None:
    """VerificationError if the documents end the process of the judge's stack, in any version."""
    subject = applicant.certificate.subject_name
    join = Question(subject=subject, domain=0, action=Action.JOIN, now=now)
    for row in INTERPRETATIONS:
        if row.stack == stack.stack_name:
            decision = InterpretedPolicy(governance, permissions, row).unanswered(join)
            if decision:
                name, reading = applicant.name, row.name
                hint = f"`pqsec explain --participant {name} --join --as {reading}` shows the line"
                raise VerificationError(decision.reason, hint=hint)


def _code(
    certificate: Certificate, permissions: Permissions, rule: DomainRule | None, now: datetime
) -> Code:
    """The code of the reason why a participant may not join."""
    if rule is None:
        return Code.NO_DOMAIN_RULE
    try:
        grant_of(certificate, permissions, now)
    except VerificationError as error:
        return error.problems[0].code
    return Code.DOMAIN_DENIED


def _refuse(name: str, *problems: Problem) -> None:
    """VerificationError if there are problems, with the hint of the first that has one."""
    if problems:
        hints = [_HINTS[each.code] for each in problems if each.code in _HINTS]
        raise VerificationError(*problems, hint=hints[0].format(name=name) if hints else None)


def _profile_problems(participant: Credentials, profile: Profile) -> Iterator[Problem]:
    """Keys whose algorithm differs from the profile: no other check would report them."""
    second = participant.certificate.alternative_key
    for what, found, wanted in (
        ("identity CA", participant.identity_ca.public_key, profile.identity_key),
        ("participant", participant.certificate.public_key, profile.participant_key),
        ("alternative", second, profile.alternative_key),
    ):
        kind = found.algorithm if found else None
        if kind is not wanted:
            names = [row.name if row else "no" for row in (kind, wanted)]
            words = f"{names[0]} {what} key, where profile {profile.name} has {names[1]}"
            yield Problem(words, Code.PROFILE_MISMATCH, CERTIFICATE)


def _signers(signed: SignedDocument[Governance] | SignedDocument[Permissions]) -> str:
    return " and ".join(each.algorithm.name for each in signed.verified.signatures)


def _name(certificate: Certificate) -> str:
    return certificate.public_key.algorithm.name
