"""Can a participant's credentials be trusted? Each step of the specification, once.

9.3.3 validate_local_identity: the identity CA, the certificate, the revocation list, the
private key. 9.4.3 validate_local_permissions: the permissions CA, the governance, the
permissions, the grant. Which domains the grant is for is the room `access`'s to say.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import TypeVar

from pqsec_pki.access import SPEC, Action, Question
from pqsec_pki.certificates import Certificate, common_name
from pqsec_pki.credentials.anchors import SignedDocument, TrustAnchors
from pqsec_pki.credentials.enclave import Credentials, alternative_spki
from pqsec_pki.credentials.names import (
    ALT_KEY,
    CERTIFICATE,
    GOVERNANCE,
    KEY,
    PERMISSIONS,
    REVOCATION_LIST,
)
from pqsec_pki.documents import Governance, Grant, Permissions
from pqsec_pki.errors import VerificationError
from pqsec_pki.problems import Code, Problem

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VerifiedCredentials:
    """What `verify_credentials` found to hold."""

    name: str
    certificate: Certificate
    anchors: TrustAnchors
    governance: SignedDocument[Governance]
    permissions: SignedDocument[Permissions]
    grant: Grant
    """The participant's own that is in force."""

    @property
    def files(self) -> Mapping[str, bytes]:
        """All files but the keys, written again from what was verified."""
        anchors, roles = self.anchors, self.anchors.roles
        files = {
            CERTIFICATE: self.certificate.pem,
            PERMISSIONS: self.permissions.verified.message,
            GOVERNANCE: self.governance.verified.message,
        }
        files |= {
            file: b"".join(each.pem for each in found) for file, found in roles.items() if found
        }
        if anchors.revocation_list is not None:
            files[REVOCATION_LIST] = anchors.revocation_list.pem
        return files


def verify_credentials(credentials: Credentials, *, now: datetime) -> VerifiedCredentials:
    """What holds at `now`; VerificationError lists everything that is wrong."""
    found, anchors = _Findings(), credentials.anchors
    # The CAs, then 9.3.3: identity
    found.problems += anchors.problems(now)
    found.problems += identity_problems(credentials, now)
    # 9.4.3: governance and permissions
    governance = found.of(lambda: anchors.signed_governance(credentials.governance))
    permissions = found.of(lambda: anchors.signed_permissions(credentials.permissions))
    grant = None
    if permissions is not None:
        granted = permissions.value
        grant = found.of(lambda: grant_of(credentials.certificate, granted, now))
    if found.problems or governance is None or permissions is None or grant is None:
        raise VerificationError(*(each.of(credentials.name) for each in _once(found.problems)))
    return VerifiedCredentials(
        name=credentials.name,
        certificate=credentials.certificate,
        anchors=anchors,
        governance=governance,
        permissions=permissions,
        grant=grant,
    )


def identity_problems(credentials: Credentials, now: datetime) -> Iterator[Problem]:
    """9.3.3, without the CA itself: the certificate, the revocation list, the keys."""
    certificate = credentials.certificate
    yield from credentials.anchors.identity_problems(certificate, now)
    if certificate.subject_der != common_name(credentials.name):
        words = f"the certificate is for {certificate.subject_name}"
        yield Problem(words, Code.WRONG_SUBJECT, CERTIFICATE)
    yield from _key_problems(credentials)


def _key_problems(credentials: Credentials) -> Iterator[Problem]:
    if credentials.private_key is None:
        return
    if credentials.private_key.public_key.spki != credentials.certificate.spki:
        yield Problem("not the private key of the certificate", Code.KEY_MISMATCH, KEY)
    second = credentials.alternative_key
    known = alternative_spki(credentials.certificate)
    if second is None and known is not None:
        yield Problem("it is missing, and the certificate has one", Code.KEY_MISMATCH, ALT_KEY)
    elif second is not None and second.public_key.spki != known:
        yield Problem("not the alternative key of the certificate", Code.KEY_MISMATCH, ALT_KEY)


def grant_of(certificate: Certificate, permissions: Permissions, now: datetime) -> Grant:
    """The grant that counts for the certificate's subject, if it is in force at `now`.

    VerificationError otherwise (DDS-Security 1.1, 9.4.1.3.2).
    """
    question = Question(
        subject=certificate.subject_name, domain=0, action=Action.JOIN, now=now
    )  # which grant counts does not depend on the domain
    grant = SPEC.grant_for(permissions, question)
    if grant is None:
        words = f"nothing in them is granted to {certificate.subject_name}"
        raise VerificationError(Problem(words, Code.NO_GRANT, PERMISSIONS))
    if SPEC.in_force(grant, now):
        return grant
    code = Code.GRANT_EXPIRED if now > grant.not_after else Code.GRANT_NOT_YET_VALID
    words = f"not valid now, but {grant.not_before:%Y-%m-%d} to {grant.not_after:%Y-%m-%d}"
    raise VerificationError(Problem(words, code, PERMISSIONS))


def _once(problems: list[Problem]) -> list[Problem]:
    """Each once, though several steps met it; a chain does not say in which file its CA is."""
    placed = {(each.code, each.message) for each in problems if each.subject}
    return [
        each
        for each in dict.fromkeys(problems)
        if each.subject or (each.code, each.message) not in placed
    ]


class _Findings:
    """Collects what is wrong, and goes on."""

    def __init__(self) -> None:
        self.problems: list[Problem] = []

    def of(self, check: Callable[[], Result]) -> Result | None:
        try:
            return check()
        except VerificationError as error:
            self.problems += error.problems
            return None
