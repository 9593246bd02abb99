"""Documents as questions need them: read, believed for a reason, and with their places."""

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
"""Of an S/MIME file: what is signed in it; VerificationError if a signature does not hold."""

YAML = (".yaml", ".yml")
_ANSWERS = {Code.NO_GRANT, Code.GRANT_EXPIRED, Code.GRANT_NOT_YET_VALID}
"""What a question about rights is answered with, and not refused for."""
_GRANTS = re.compile(rb"(?m)^[ \t]*+\{?[ \t]*+[\"']?grants[\"']?\s*+:")
"""What permissions in YAML must have, and governance cannot; blank lines are gone through once."""
_XML = re.compile(rb"(?:\xef\xbb\xbf)?\s*<|\xff\xfe|\xfe\xff")


@dataclass(frozen=True, slots=True)
class Loaded(Generic[Value]):
    """What a file says."""

    path: Path
    value: Value
    signed: bool
    verified: bool
    before: int
    """Lines of the file that stand before the document."""

    def line(self, line: int | None) -> int | None:
        """The line of the file where that line of the document is."""
        return None if line is None else line + self.before


Document: TypeAlias = Loaded[Governance] | Loaded[Permissions]


@dataclass(frozen=True, slots=True, kw_only=True)
class PolicyInput:
    """Who asks, and the documents that answer."""

    who: str
    subject: str
    governance: Loaded[Governance]
    permissions: Loaded[Permissions]

    def place(self, decision: Decision) -> tuple[Path, int] | None:
        """The file and line of what decided."""
        part = decision.decided_by
        source = self.governance if isinstance(part, DomainRule | TopicRule) else self.permissions
        line = source.line(part.line) if part else None
        return (source.path, line) if line else None

    def criteria_line(self, decision: Decision) -> int | None:
        """The line, in that file, of those criteria of the rule that were met."""
        return self.permissions.line(decision.criteria.line) if decision.criteria else None


def plain(text: str) -> str:
    """A name from outside, whole, without control characters."""
    return shown(text, limit=len(text))


def signed_by(path: Path, now: datetime) -> Check:
    """Did the permissions CA whose certificate is in the file `path` sign it?"""
    ca = only_certificate(read(path), str(path))
    return partial(TrustAnchors(identity_cas=(), permissions_ca=ca).verified, now=now)


def governance_in(path: Path, check: Check | None = None) -> Loaded[Governance]:
    """A governance document: XML, signed or not, or YAML."""
    return _governance(path, read(path), check)


def permissions_in(path: Path, now: datetime, check: Check | None = None) -> Loaded[Permissions]:
    """A permissions document: XML, signed or not, or YAML; `1y` in it counts from `now`."""
    return _permissions(path, read(path), now, check)


def document_at(path: Path, now: datetime) -> Document:
    """A document of either kind, read once: it may be a pipe."""
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
    """Which of the two it is."""
    return Kind.GOVERNANCE if isinstance(document.value, Governance) else Kind.PERMISSIONS


def enclave_file(keystore: Keystore, name: str, file: str) -> Path:
    """That file of a participant; KeystoreError if there is no such participant."""
    keystore.refuse_unknown(name)
    return keystore.root / f"{ENCLAVES}{regular_name(name)}" / file


def anchors_of(keystore: Keystore, now: datetime) -> TrustAnchors:
    """Whom its participants trust; VerificationError if they should not, now."""
    anchors = keystore.anchors
    problems = anchors.problems(now)
    if problems:
        raise VerificationError(*problems)
    return anchors


def identity_of(keystore: Keystore, name: str, anchors: TrustAnchors, now: datetime) -> Certificate:
    """A participant's certificate, if an identity CA stands for it and did not revoke it."""
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
    """A participant's own; VerificationError if a signature on them does not hold.

    They must hold twice: for the keystore, and for who has the enclave's files and no others.
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
    """VerificationError if its own stack would refuse the enclave; a grant is asked about."""
    files = enclave_files(keystore.root, name)
    public = {file: data for file, data in files.items() if file not in KEYS}
    try:
        verify_credentials(Credentials.of(name, public), now=now)
    except VerificationError as error:
        problems = [each for each in error.problems if each.code not in _ANSWERS]
        if problems:
            raise VerificationError(*problems, hint=error.hint) from error


def own_permissions(
    keystore: Keystore, name: str, now: datetime, check: Check | None
) -> Loaded[Permissions]:
    """A participant's."""
    return permissions_in(enclave_file(keystore, name, PERMISSIONS), now, check)


def shared_governance(keystore: Keystore, check: Check | None) -> Loaded[Governance]:
    """The keystore's."""
    return governance_in(keystore.root / ENCLAVES / GOVERNANCE, check)


def own_governance(
    keystore: Keystore, name: str, shared: Loaded[Governance], check: Check | None
) -> Governance:
    """A participant's, which should be the one that all share."""
    path = enclave_file(keystore, name, GOVERNANCE)
    is_shared = not exists(path) or path.samefile(shared.path)
    return shared.value if is_shared else governance_in(path, check).value


def only_subject(permissions: Loaded[Permissions]) -> str:
    """The subject of all grants; UsageError if they are for several."""
    subjects = {grant.subject_name for grant in permissions.value.grants}
    if len(subjects) > 1:
        raise UsageError(
            f"{permissions.path} has grants for {len(subjects)} subjects",
            hint="say whom you ask about: --subject " + repr(min(subjects)),
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
            raise VerificationError("it is not signed", code=Code.NOT_SIGNED)
        value = from_yaml(data) if _is_yaml(path, data) else from_xml(data)
        return Loaded(path, value, False, False, 0)  # noqa: FBT003 -- fields


def _is_yaml(path: Path, data: bytes) -> bool:
    """By its ending; of what has none, as a pipe, by whether it begins as XML does."""
    return path.suffix in YAML or not (path.suffix or _XML.match(data))
