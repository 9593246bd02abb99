"""Are a participant's own credentials sound? What a DDS stack asks before it speaks.

The order is that of DDS-Security 1.1, 9.3.3 (validate_local_identity) and 9.4.3
(validate_local_permissions).
"""

from datetime import datetime

from pqsec_pki.access import may_join
from pqsec_pki.algorithms import Family, Profile
from pqsec_pki.certificates import Certificate, verify_chain, verify_validity
from pqsec_pki.documents import Governance, Permissions
from pqsec_pki.errors import VerificationError, located
from pqsec_pki.keystore import Participant
from pqsec_pki.smime import Require, Verified, verify


def required_signatures(profile: Profile) -> Require:
    """Which signatures a document must have under that profile."""
    if profile.alternative_key or profile.permissions_key.family is Family.HYBRID:
        return Require.BOTH
    if profile.permissions_key.family is Family.PQ:
        return Require.PQ
    return Require.CLASSICAL


def check_identity(participant: Participant, profile: Profile, now: datetime) -> str:
    """The certificate chain and the keys; VerificationError, or what was found."""
    certificate = participant.certificate
    twice = profile.alternative_key is not None
    verify_chain(certificate, participant.identity_ca, now=now, require_alternative=twice)
    problems = []
    if participant.key.public_key.spki != certificate.spki:
        problems.append(f"key.pem is not the key in the certificate of {participant.name}")
    known, own = certificate.alternative_key, participant.alternative_key
    if twice and (own is None or known is None or own.public_key.spki != known.spki):
        problems.append(f"alt.key.pem is not the alternative key of {participant.name}")
    if problems:
        raise VerificationError(
            *problems, hint=f"issue it again: pqsec issue {participant.name} --force"
        )
    also = f", and by {profile.alternative_key.name}" if profile.alternative_key else ""
    ca = participant.identity_ca
    return f"{certificate.subject_name} signed by {ca.subject_name} ({_name(ca)}{also})"


def check_documents(participant: Participant, profile: Profile, domain: int, now: datetime) -> str:
    """Its own governance and permissions; VerificationError, or what was found."""
    governance = _signers(_verified_governance(participant, profile, now))
    own = check_permissions(participant, participant, profile, domain, now)
    return f"governance signed by {governance}; {own}"


def check_permissions(
    judge: Participant, subject: Participant, profile: Profile, domain: int, now: datetime
) -> str:
    """Does `judge` let `subject` join `domain`? VerificationError, or the rule that decided.

    The signature, the subject, the validity and the domain of the subject's permissions,
    against the judge's permissions CA and governance (validate_remote_permissions).
    """
    governance = Governance.from_xml(_verified_governance(judge, profile, now).document)
    with located("permissions.p7s"):
        verified = _verified(judge, subject.permissions, profile, now)
        permissions = Permissions.from_xml(verified.document)
    decision = may_join(governance, permissions, subject.certificate.subject_name, domain, now)
    if not decision.allowed:
        raise VerificationError(
            f"{subject.name} may not join domain {domain}: {decision.reason}",
            hint="add the domain to enclaves/governance.xml and run `pqsec sign-governance`"
            if governance.rule_for(domain) is None
            else f"issue it with topics on that domain: pqsec issue {subject.name}"
            f" --domain {domain} --publish TOPIC --force",
        )
    return f"permissions signed by {_signers(verified)}; {decision.reason}"


def _verified_governance(judge: Participant, profile: Profile, now: datetime) -> Verified:
    with located("governance.p7s"):
        return _verified(judge, judge.governance, profile, now)


def _verified(judge: Participant, message: bytes, profile: Profile, now: datetime) -> Verified:
    verify_validity(judge.permissions_ca, now=now)
    return verify(
        message,
        judge.permissions_ca,
        alternative_ca=judge.permissions_alt_ca,
        require=required_signatures(profile),
    )


def _signers(verified: Verified) -> str:
    return " and ".join(each.algorithm.name for each in verified.signatures)


def _name(certificate: Certificate) -> str:
    return certificate.public_key.algorithm.name
