"""The policy of a participant: its verified governance and permissions, from a keystore."""

from collections.abc import Mapping
from datetime import datetime
from functools import partial
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import exists
from pqsec_pki.access import SPEC, Decision, Interpretation, Markup, Question
from pqsec_pki.certificates import Certificate
from pqsec_pki.credentials import (
    CERTIFICATE,
    ENCLAVES,
    GOVERNANCE,
    PERMISSIONS,
    Credentials,
    TrustAnchors,
    only_certificate,
    subject_problems,
    verify_credentials,
)
from pqsec_pki.documents import DomainRule, Governance, Kind, Permissions, TopicRule
from pqsec_pki.errors import VerificationError, located
from pqsec_pki.keystore import (
    Keystore,
    public_files,
    refuse_other_governance,
    refuse_other_permissions,
    regular_name,
)
from pqsec_pki.policy.loading import Check, Loaded, governance_in, permissions_in
from pqsec_pki.problems import Code

_GRANT_PROBLEMS = {Code.NO_GRANT, Code.GRANT_EXPIRED, Code.GRANT_NOT_YET_VALID}
"""Problems that are a "no" to an access question, not an error."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PolicyInput:
    """A participant and the documents that decide its rights."""

    who: str
    subject: str
    governance: Loaded[Governance]
    permissions: Loaded[Permissions]
    not_after: datetime | None = None
    """The end of its certificate, or of a CA; None if the documents are files without one."""
    keys: str = ""
    """The algorithms of its certificate's keys, such as `ml-dsa-65`."""

    def until(self, question: Question, interpretation: Interpretation = SPEC) -> datetime | None:
        """The end of its rights: of its grant, certificate or a CA. None if they have no end."""
        return end_of_rights(self.permissions.value, question, interpretation, self.not_after)

    def place(self, decision: Decision) -> tuple[Path, int] | None:
        """The file and line of the rule that decided."""
        part = decision.decided_by
        governing = isinstance(part, DomainRule | TopicRule) or (
            isinstance(part, Markup) and part.document is Kind.GOVERNANCE
        )
        source = self.governance if governing else self.permissions
        line = source.line(part.line) if part else None
        return (source.path, line) if line else None

    def criteria_line(self, decision: Decision) -> int | None:
        """The line, in that file, of the criteria of the rule that matched."""
        return self.permissions.line(decision.criteria.line) if decision.criteria else None


def end_of_rights(
    permissions: Permissions,
    question: Question,
    interpretation: Interpretation,
    not_after: datetime | None,
) -> datetime | None:
    """The end of the grant for the question's subject, or `not_after` if that is earlier."""
    grant = interpretation.grant_for(permissions, question)
    ends = [each for each in (grant.not_after if grant else None, not_after) if each]
    return min(ends, default=None)


def enclave_file(keystore: Keystore, name: str, file: str) -> Path:
    """The path of that file of a participant, which may not exist."""
    return keystore.folder / f"{ENCLAVES}{regular_name(name)}/{file}"


def valid_anchors(anchors: TrustAnchors, now: datetime) -> TrustAnchors:
    """The `anchors`. VerificationError if they are not valid at `now`."""
    problems = anchors.problems(now)
    if problems:
        raise VerificationError(*problems)
    return anchors


def identity_of(
    keystore: Keystore,
    name: str,
    anchors: TrustAnchors,
    now: datetime,
    files: Mapping[str, bytes],
) -> Certificate:
    """A participant's certificate. VerificationError if it is not valid, or is revoked.

    `files` are its `public_files`, here and in the functions below.
    """
    path = enclave_file(keystore, name, CERTIFICATE)
    certificate = only_certificate(files[CERTIFICATE], str(path))
    with located(path):
        problems = (
            *anchors.identity_problems(certificate, now),
            *subject_problems(regular_name(name), certificate),
        )
        if problems:
            expired = any(each.code is Code.EXPIRED for each in problems)
            hint = f"`pqsec renew {regular_name(name)}` issues it again" if expired else None
            raise VerificationError(*problems, hint=hint)
    return certificate


def policy_input_of(keystore: Keystore, name: str, now: datetime) -> PolicyInput:
    """A participant and its documents. VerificationError if a signature is not valid.

    Verified twice: against the keystore, and against the files of the enclave alone. Also if
    another set of credentials says something else.
    """
    keystore.refuse_unknown(name)
    refuse_other_governance(keystore)
    refuse_other_permissions(keystore, name)
    anchors = valid_anchors(keystore.anchors, now)
    check = partial(anchors.verified, now=now)
    files = public_files(keystore.folder, regular_name(name))
    certificate = identity_of(keystore, name, anchors, now, files)
    policy_input = PolicyInput(
        who=regular_name(name),
        subject=certificate.subject_name,
        not_after=min(certificate.not_after, anchors.not_after),
        keys=" and ".join(each.algorithm.name for each in certificate.own_keys),
        governance=governance_in(
            enclave_file(keystore, name, GOVERNANCE), check, files[GOVERNANCE], any_markup=True
        ),
        permissions=own_permissions(keystore, name, now, check, files, any_markup=True),
    )
    _refuse_enclave(policy_input, files, now)
    return policy_input


def _refuse_enclave(policy_input: PolicyInput, files: Mapping[str, bytes], now: datetime) -> None:
    """VerificationError if its own stack would refuse the enclave, apart from its grants.

    Documents with markup in values are read here as valid: `readers differ` is the answer.
    """
    name, answered = policy_input.who, _GRANT_PROBLEMS
    if policy_input.governance.value.markup or policy_input.permissions.value.markup:
        answered = answered | {Code.DOCUMENT_INVALID}
    try:
        verify_credentials(Credentials.of(name, files), now=now)
    except VerificationError as error:
        problems = [each for each in error.problems if each.code not in answered]
        if problems:
            raise VerificationError(*problems, hint=error.hint) from error


def own_permissions(  # noqa: PLR0913 -- what is known of it, the rarer ones by name
    keystore: Keystore,
    name: str,
    now: datetime,
    check: Check | None,
    files: Mapping[str, bytes] | None = None,
    *,
    any_markup: bool = False,
) -> Loaded[Permissions]:
    """The permissions document of a participant; `any_markup` as in `permissions_in`."""
    path, data = enclave_file(keystore, name, PERMISSIONS), files[PERMISSIONS] if files else None
    return permissions_in(path, now, check, data, any_markup=any_markup)


def shared_governance(
    keystore: Keystore, check: Check | None, *, any_markup: bool = False
) -> Loaded[Governance]:
    """The governance document of the keystore; `any_markup` as in `governance_in`."""
    return governance_in(keystore.folder / ENCLAVES / GOVERNANCE, check, any_markup=any_markup)


def own_governance(
    keystore: Keystore,
    name: str,
    shared: Loaded[Governance],
    check: Check | None,
    files: Mapping[str, bytes] | None = None,
) -> Governance:
    """The governance of a participant, normally a link to the shared one."""
    path = enclave_file(keystore, name, GOVERNANCE)
    is_shared = not exists(path) or path.samefile(shared.path)
    if is_shared:
        return shared.value
    data, any_markup = files[GOVERNANCE] if files else None, bool(shared.value.markup)
    return governance_in(path, check, data, any_markup=any_markup).value
