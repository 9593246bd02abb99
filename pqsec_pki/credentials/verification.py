"""Verify a participant's credentials, with each step of the specification once.

9.3.3 validate_local_identity: the identity CA, the certificate, the revocation list, the
private key. 9.4.3 validate_local_permissions: the permissions CA, the governance, the
permissions, the grant. The room `access` decides which domains the grant is for.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from datetime import datetime
from typing import TypeVar

from pqsec_pki._dataclass import dataclass
from pqsec_pki._times import said
from pqsec_pki.access import SPEC, Action, Decision, Interpretation, Question, decide
from pqsec_pki.algorithms import PrivateKey
from pqsec_pki.certificates import Certificate, common_name
from pqsec_pki.credentials._signed_documents import SignedDocument
from pqsec_pki.credentials.anchors import TrustAnchors
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
    """Credentials that `verify_credentials` verified."""

    name: str
    certificate: Certificate
    anchors: TrustAnchors
    governance: SignedDocument[Governance]
    permissions: SignedDocument[Permissions]
    grant: Grant
    """The participant's own grant that is valid now."""

    def decide(
        self,
        action: Action,
        topic: str | None = None,
        *,
        domain: int,
        now: datetime,
        interpretation: Interpretation = SPEC,
    ) -> Decision:
        """Whether the participant may do `action` with the DDS topic `topic`, and why.

        `topic` is None for `Action.JOIN` only: UsageError otherwise. `access.decide` also has
        partitions and data tags.
        """
        question = Question(
            subject=self.certificate.subject_name,
            domain=domain,
            action=action,
            topic=topic,
            now=now,
        )
        return decide(self.governance.value, self.permissions.value, question, interpretation)

    @property
    def files(self) -> Mapping[str, bytes]:
        """All files but the keys, written again from the verified values."""
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VerifiedDocuments:
    """Documents that `verify_documents` verified."""

    governance: SignedDocument[Governance]
    permissions: SignedDocument[Permissions]
    grant: Grant
    """The participant's own grant that is valid now."""


def verify_credentials(credentials: Credentials, *, now: datetime) -> VerifiedCredentials:
    """Verify all credentials at `now`; VerificationError lists everything that is wrong."""
    found, anchors = _Findings(), credentials.anchors
    # The CAs, then 9.3.3: identity
    found.problems += anchors.problems(now)
    found.problems += identity_problems(credentials, now)
    # 9.4.3: governance and permissions
    documents = found.of(
        lambda: verify_documents(
            credentials.certificate,
            anchors,
            governance=credentials.governance,
            permissions=credentials.permissions,
            now=now,
        )
    )
    if found.problems or documents is None:
        raise VerificationError(*(each.of(credentials.name) for each in distinct(found.problems)))
    return VerifiedCredentials(
        name=credentials.name,
        certificate=credentials.certificate,
        anchors=anchors,
        governance=documents.governance,
        permissions=documents.permissions,
        grant=documents.grant,
    )


def identity_problems(credentials: Credentials, now: datetime) -> Iterator[Problem]:
    """9.3.3, without the CA: problems of the certificate, the revocation list and the keys."""
    certificate = credentials.certificate
    yield from credentials.anchors.own_identity_problems(certificate, now)
    yield from subject_problems(credentials.name, certificate)
    key, second = credentials.private_key, credentials.alternative_key
    yield from key_problems(certificate, key, second, alone=key is None)


def subject_problems(name: str, certificate: Certificate) -> Iterator[Problem]:
    """Problems if `certificate` is not for the participant called `name`."""
    if certificate.subject_der != common_name(name):
        words = f"the certificate is for {certificate.subject_name}"
        yield Problem(words, Code.WRONG_SUBJECT, CERTIFICATE)


def key_problems(
    certificate: Certificate,
    key: PrivateKey | None,
    second: PrivateKey | None,
    *,
    alone: bool = False,
) -> Iterator[Problem]:
    """Problems if these are not the certificate's keys; with `alone`, `second` may be missing."""
    if key is not None and key.public_key.spki != certificate.spki:
        yield Problem("not the private key of the certificate", Code.KEY_MISMATCH, KEY)
    known = alternative_spki(certificate)
    if second is None and known is not None and not alone:
        yield Problem("it is missing, and the certificate has one", Code.KEY_MISMATCH, ALT_KEY)
    elif second is not None and second.public_key.spki != known:
        yield Problem("not the alternative key of the certificate", Code.KEY_MISMATCH, ALT_KEY)


def verify_documents(
    certificate: Certificate,
    anchors: TrustAnchors,
    *,
    governance: bytes,
    permissions: bytes,
    now: datetime,
) -> VerifiedDocuments:
    """9.4.3: verify S/MIME `governance` and `permissions` for the holder of `certificate`.

    VerificationError lists everything that is wrong, including problems of the CAs.
    """
    found = _Findings()
    found.problems += anchors.problems(now)
    rules = found.of(lambda: anchors.signed_governance(governance))
    granted = found.of(lambda: anchors.signed_permissions(permissions))
    grant = None
    if granted is not None:
        document = granted.value
        grant = found.of(lambda: grant_of(certificate, document, now))
    if found.problems or rules is None or granted is None or grant is None:
        raise VerificationError(*found.problems)
    return VerifiedDocuments(governance=rules, permissions=granted, grant=grant)


def grant_of(certificate: Certificate, permissions: Permissions, now: datetime) -> Grant:
    """The grant for the certificate's subject, if it is valid at `now`.

    VerificationError otherwise (DDS-Security 1.1, 9.4.1.3.2).
    """
    question = Question(
        subject=certificate.subject_name, domain=0, action=Action.JOIN, now=now
    )  # the choice of the grant does not depend on the domain
    grant = SPEC.grant_for(permissions, question)
    if grant is None:
        words = f"they have no grant for {certificate.subject_name}"
        raise VerificationError(Problem(words, Code.NO_GRANT, PERMISSIONS))
    if SPEC.in_force(grant, now):
        return grant
    code = Code.GRANT_EXPIRED if now > grant.not_after else Code.GRANT_NOT_YET_VALID
    words = f"not valid now, but {said(grant.not_before)} to {said(grant.not_after)}"
    raise VerificationError(Problem(words, code, PERMISSIONS))


def distinct(problems: Collection[Problem]) -> list[Problem]:
    """Each problem once, even if several steps found it, one of them without the file's name."""
    placed = {(each.code, each.message) for each in problems if each.subject}
    return [
        each
        for each in dict.fromkeys(problems)
        if each.subject or (each.code, each.message) not in placed
    ]


class _Findings:
    """Collects problems of all steps."""

    def __init__(self) -> None:
        self.problems: list[Problem] = []

    def of(self, check: Callable[[], Result]) -> Result | None:
        try:
            return check()
        except VerificationError as error:
            self.problems += error.problems
            return None
