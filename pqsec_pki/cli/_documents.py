"""Documents for access questions: read, verified where asked, with their line numbers."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Generic, TypeAlias, TypeVar

from pqsec_pki._files import exists, read
from pqsec_pki.access import Decision
from pqsec_pki.certificates import Certificate
from pqsec_pki.credentials import (
    CERTIFICATE,
    ENCLAVES,
    GOVERNANCE,
    KEYS,
    PERMISSIONS,
    Credentials,
    TrustAnchors,
    only_certificate,
    subject_problems,
    verify_credentials,
)
from pqsec_pki.documents import (
    DomainRule,
    Governance,
    Kind,
    Permissions,
    TopicRule,
    governance_from_yaml,
    permissions_from_yaml,
    validate,
)
from pqsec_pki.errors import UsageError, VerificationError, located, shown
from pqsec_pki.keystore import Keystore, enclave_files, load_certificate, regular_name
from pqsec_pki.problems import Code
from pqsec_pki.smime import Verified, document_in, is_signed, lines_before_document

Value = TypeVar("Value", Governance, Permissions)
Check: TypeAlias = Callable[[bytes], Verified]
"""Takes an S/MIME file, returns the signed content. VerificationError for a bad signature."""

YAML = (".yaml", ".yml")
_GRANT_PROBLEMS = {Code.NO_GRANT, Code.GRANT_EXPIRED, Code.GRANT_NOT_YET_VALID}
"""Problems that are a "no" to an access question, not an error."""
_GRANTS = re.compile(rb"(?m)^[ \t]*+\{?[ \t]*+[\"']?grants[\"']?\s*+:")
"""Permissions in YAML have this key, governance does not. Possessive: linear on blank lines."""
_XML = re.compile(rb"(?:\xef\xbb\xbf)?\s*<|\xff\xfe|\xfe\xff")


@dataclass(frozen=True, slots=True)
class Loaded(Generic[Value]):
    """A document and where it was read."""

    path: Path
    value: Value
    signed: bool
    verified: bool
    before: int
    """Lines in the file before the document."""

    def line(self, line: int | None) -> int | None:
        """The line in the file for a line of the document."""
        return None if line is None else line + self.before


Document: TypeAlias = Loaded[Governance] | Loaded[Permissions]


@dataclass(frozen=True, slots=True, kw_only=True)
class PolicyInput:
    """A participant and the documents that decide its rights."""

    who: str
    subject: str
    governance: Loaded[Governance]
    permissions: Loaded[Permissions]

    def place(self, decision: Decision) -> tuple[Path, int] | None:
        """The file and line of the rule that decided."""
        part = decision.decided_by
        source = self.governance if isinstance(part, DomainRule | TopicRule) else self.permissions
        line = source.line(part.line) if part else None
        return (source.path, line) if line else None

    def criteria_line(self, decision: Decision) -> int | None:
        """The line, in that file, of the criteria of the rule that matched."""
        return self.permissions.line(decision.criteria.line) if decision.criteria else None


def plain(text: str) -> str:
    """An external name in full, with control characters escaped."""
    return shown(text, limit=len(text))


def signed_by(path: Path, now: datetime) -> Check:
    """A check that the permissions CA with the certificate at `path` signed a document."""
    ca = only_certificate(read(path), str(path))
    return partial(TrustAnchors(identity_cas=(), permissions_ca=ca).verified, now=now)


def governance_in(path: Path, check: Check | None = None) -> Loaded[Governance]:
    """The governance document at `path`: XML, signed or not, or YAML."""
    return _governance(path, read(path), check)


def permissions_in(path: Path, now: datetime, check: Check | None = None) -> Loaded[Permissions]:
    """The permissions document at `path`; durations such as `1y` in YAML count from `now`."""
    return _permissions(path, read(path), now, check)


def document_at(path: Path, now: datetime) -> Document:
    """A document of either kind. Reads `path` once, because it may be a pipe."""
    data = read(path)
    with located(path):
        if _is_yaml(path, data):
            kind = Kind.PERMISSIONS if _GRANTS.search(data) else Kind.GOVERNANCE
        else:
            kind = validate(document_in(data) if is_signed(data) else data)
    if kind is Kind.GOVERNANCE:
        return _governance(path, data)
    return _permissions(path, data, now)


def kind_of(document: Document) -> Kind:
    """Governance or permissions."""
    return Kind.GOVERNANCE if isinstance(document.value, Governance) else Kind.PERMISSIONS


def enclave_file(keystore: Keystore, name: str, file: str) -> Path:
    """The path of that file of a participant. KeystoreError for an unknown participant."""
    keystore.refuse_unknown(name)
    return keystore.root / f"{ENCLAVES}{regular_name(name)}" / file


def anchors_of(keystore: Keystore, now: datetime) -> TrustAnchors:
    """The trust anchors of its participants. VerificationError if they are not valid at `now`."""
    anchors = keystore.anchors
    problems = anchors.problems(now)
    if problems:
        raise VerificationError(*problems)
    return anchors


def identity_of(keystore: Keystore, name: str, anchors: TrustAnchors, now: datetime) -> Certificate:
    """A participant's certificate. VerificationError if it is not valid, or is revoked."""
    path = enclave_file(keystore, name, CERTIFICATE)
    certificate = load_certificate(path)
    with located(path):
        problems = (
            *anchors.identity_problems(certificate, now),
            *subject_problems(regular_name(name), certificate),
        )
        if problems:
            raise VerificationError(*problems)
    return certificate


def policy_input_of(keystore: Keystore, name: str, now: datetime) -> PolicyInput:
    """A participant and its documents. VerificationError if a signature is not valid.

    Verified twice: against the keystore, and against the files of the enclave alone.
    """
    keystore.refuse_unknown(name)
    anchors = anchors_of(keystore, now)
    check = partial(anchors.verified, now=now)
    policy_input = PolicyInput(
        who=regular_name(name),
        subject=identity_of(keystore, name, anchors, now).subject_name,
        governance=governance_in(enclave_file(keystore, name, GOVERNANCE), check),
        permissions=own_permissions(keystore, name, now, check),
    )
    _refuse_enclave(keystore, policy_input.who, now)
    return policy_input


def _refuse_enclave(keystore: Keystore, name: str, now: datetime) -> None:
    """VerificationError if its own stack would refuse the enclave, apart from its grants."""
    files = enclave_files(keystore.root, name)
    public = {file: data for file, data in files.items() if file not in KEYS}
    try:
        verify_credentials(Credentials.of(name, public), now=now)
    except VerificationError as error:
        problems = [each for each in error.problems if each.code not in _GRANT_PROBLEMS]
        if problems:
            raise VerificationError(*problems, hint=error.hint) from error


def own_permissions(
    keystore: Keystore, name: str, now: datetime, check: Check | None
) -> Loaded[Permissions]:
    """The permissions document of a participant."""
    return permissions_in(enclave_file(keystore, name, PERMISSIONS), now, check)


def shared_governance(keystore: Keystore, check: Check | None) -> Loaded[Governance]:
    """The governance document of the keystore."""
    return governance_in(keystore.root / ENCLAVES / GOVERNANCE, check)


def own_governance(
    keystore: Keystore, name: str, shared: Loaded[Governance], check: Check | None
) -> Governance:
    """The governance of a participant, normally a link to the shared one."""
    path = enclave_file(keystore, name, GOVERNANCE)
    is_shared = not exists(path) or path.samefile(shared.path)
    return shared.value if is_shared else governance_in(path, check).value


def only_subject(permissions: Loaded[Permissions]) -> str:
    """The subject of all grants. UsageError if there are several subjects."""
    subjects = {grant.subject_name for grant in permissions.value.grants}
    if len(subjects) > 1:
        raise UsageError(
            f"{permissions.path} has grants for {len(subjects)} subjects",
            hint="choose one: --subject " + repr(min(subjects)),
        )
    return subjects.pop()


def _governance(path: Path, data: bytes, check: Check | None = None) -> Loaded[Governance]:
    return _loaded(path, data, check, Governance.from_xml, governance_from_yaml)


def _permissions(
    path: Path, data: bytes, now: datetime, check: Check | None = None
) -> Loaded[Permissions]:
    from_yaml = partial(permissions_from_yaml, now=now)
    return _loaded(path, data, check, Permissions.from_xml, from_yaml)


def _loaded(
    path: Path,
    data: bytes,
    check: Check | None,
    from_xml: Callable[[bytes], Value],
    from_yaml: Callable[[bytes], Value],
) -> Loaded[Value]:
    with located(path):
        if is_signed(data):
            xml = check(data).document if check else document_in(data)
            verified = check is not None
            return Loaded(path, from_xml(xml), True, verified, lines_before_document(data))  # noqa: FBT003 -- field
        if check:
            raise VerificationError("the document is not signed", code=Code.NOT_SIGNED)
        value = from_yaml(data) if _is_yaml(path, data) else from_xml(data)
        return Loaded(path, value, False, False, 0)  # noqa: FBT003 -- fields


def _is_yaml(path: Path, data: bytes) -> bool:
    """By the file suffix; without one (a pipe), by whether the data begins like XML."""
    return path.suffix in YAML or not (path.suffix or _XML.match(data))
