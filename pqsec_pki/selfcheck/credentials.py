"""Are a participant's own credentials sound? What a DDS stack asks before it speaks.

The order is that of DDS-Security 1.1, 9.3.3 (validate_local_identity) and 9.4.3
(validate_local_permissions).
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime

from pqsec_pki.access import may_join
from pqsec_pki.algorithms import Profile
from pqsec_pki.certificates import (
    Certificate,
    common_name,
    verify_authority,
    verify_chain,
    verify_not_revoked,
)
from pqsec_pki.documents import Governance, Permissions
from pqsec_pki.errors import VerificationError, located
from pqsec_pki.keystore import Participant, required_signatures
from pqsec_pki.smime import Verified, verify


@dataclass(frozen=True, slots=True)
class Applicant:
    """Who wants to join, as a peer sees it: nothing of it is believed yet."""

    name: str
    certificate: Certificate
    permissions: bytes = field(repr=False)
    """The signed permissions document."""


def renewal(name: str) -> str:
    """How to get a new key and certificate, for a hint: no right is lost."""
    return f"`pqsec renew {name}` keeps what it may do"


def check_identity(participant: Participant, profile: Profile, now: datetime) -> str:
    """The certificate chain and the keys; VerificationError, or what was found."""
    certificate, ca = participant.certificate, participant.identity_ca
    twice = profile.alternative_key is not None
    verify_chain(certificate, ca, now=now, require_alternative=twice)
    _check_not_revoked(participant, now, twice=twice)
    problems = [*_key_problems(participant), *_profile_problems(participant, profile)]
    if certificate.subject_der != common_name(participant.name):
        problems.append(f"cert.pem of {participant.name} is for {certificate.subject_name}")
    if problems:
        raise VerificationError(*problems, hint=f"make it anew: {renewal(participant.name)}")
    also = f", and by {profile.alternative_key.name}" if profile.alternative_key else ""
    return f"{certificate.subject_name} signed by {ca.subject_name} ({_name(ca)}{also})"


def check_documents(participant: Participant, profile: Profile, domain: int, now: datetime) -> str:
    """Its own governance and permissions; VerificationError, or what was found."""
    governance = _signers(_verified_governance(participant, profile, now))
    itself = Applicant(participant.name, participant.certificate, participant.permissions)
    own = check_permissions(participant, itself, profile, domain, now)
    return f"governance signed by {governance}; {own}"


def check_permissions(
    judge: Participant, applicant: Applicant, profile: Profile, domain: int, now: datetime
) -> str:
    """Does `judge` let `applicant` join `domain`? VerificationError, or the rule that decided.

    The signature, the subject, the validity and the domain of the applicant's
    permissions, against the judge's permissions CA and governance
    (validate_remote_permissions).
    """
    governance = Governance.from_xml(_verified_governance(judge, profile, now).document)
    with located("permissions.p7s"):
        verified = _verified(judge, applicant.permissions, profile, now)
        permissions = Permissions.from_xml(verified.document)
    subject = applicant.certificate.subject_name
    decision = may_join(governance, permissions, subject, domain, now)
    if not decision.allowed:
        raise VerificationError(
            f"{applicant.name} may not join domain {domain}: {decision.reason}",
            hint="add the domain to enclaves/governance.xml and run `pqsec sign-governance`"
            if governance.rule_for(domain) is None
            else f"`pqsec explain --participant {applicant.name} --join` tells where it may",
        )
    return f"permissions signed by {_signers(verified)}; {decision.reason}"


def _check_not_revoked(participant: Participant, now: datetime, *, twice: bool) -> None:
    """Stacks refuse their own certificate too, and all once the list is not good."""
    revoked = participant.revocation_list
    if revoked is None:
        return
    try:
        verify_not_revoked(
            participant.certificate,
            revoked,
            participant.identity_ca,
            now=now,
            require_alternative=twice,
        )
    except VerificationError as error:
        error.hint = (
            f"if {participant.name} may come back, `pqsec issue` it with --force --after-revocation"
            if revoked.revocation_of(participant.certificate)
            else "`pqsec ca crl` makes a new list; a robot needs a copy"
        )
        raise


def _key_problems(participant: Participant) -> Iterator[str]:
    certificate = participant.certificate
    if participant.key.public_key.spki != certificate.spki:
        yield f"key.pem is not the key in the certificate of {participant.name}"
    known, own = certificate.alternative_key, participant.alternative_key
    if (known.spki if known else None) != (own.public_key.spki if own else None):
        yield f"alt.key.pem is not the alternative key of {participant.name}"


def _profile_problems(participant: Participant, profile: Profile) -> Iterator[str]:
    """A key of another kind would break what the profile promises, and nothing would show."""
    second = participant.certificate.alternative_key
    for what, found, wanted in (
        ("identity CA", participant.identity_ca.public_key, profile.identity_key),
        ("participant", participant.certificate.public_key, profile.participant_key),
        ("alternative", second, profile.alternative_key),
    ):
        kind = found.algorithm if found else None
        if kind is not wanted:
            names = [row.name if row else "no" for row in (kind, wanted)]
            yield f"{names[0]} {what} key, where profile {profile.name} has {names[1]}"


def _verified_governance(judge: Participant, profile: Profile, now: datetime) -> Verified:
    with located("governance.p7s"):
        return _verified(judge, judge.governance, profile, now)


def _verified(judge: Participant, message: bytes, profile: Profile, now: datetime) -> Verified:
    _check_signers(judge, now)
    # Who is pinned must have signed, whether the profile asks for two or not (C25).
    return verify(
        message,
        judge.permissions_ca,
        alternative_ca=judge.permissions_alt_ca,
        require=required_signatures(profile),
        pinned=True,
    )


def _check_signers(judge: Participant, now: datetime) -> None:
    """They are CAs, good now, and not the identity CA."""
    if judge.permissions_ca.spki == judge.identity_ca.spki:
        raise VerificationError(
            "one key is identity CA and permissions CA: whoever is issued a certificate could"
            " sign permissions (CVE-2023-24010)",
            hint="make two that are distinct: `pqsec ca rotate`",
        )
    verify_authority(judge.permissions_ca, now=now)
    if judge.permissions_alt_ca:
        verify_authority(judge.permissions_alt_ca, now=now)


def _signers(verified: Verified) -> str:
    return " and ".join(each.algorithm.name for each in verified.signatures)


def _name(certificate: Certificate) -> str:
    return certificate.public_key.algorithm.name
