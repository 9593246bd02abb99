"""Governance and permissions from files with their lines: XML, signed or not, and YAML."""

import re
from collections.abc import Callable
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Generic, TypeAlias, TypeVar

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import read
from pqsec_pki.credentials import TrustAnchors, only_certificate
from pqsec_pki.documents import (
    Governance,
    Kind,
    Permissions,
    governance_from_yaml,
    permissions_from_yaml,
    validate,
)
from pqsec_pki.errors import InvalidDocumentError, UsageError, VerificationError, located
from pqsec_pki.problems import Code, Problem
from pqsec_pki.smime import SignedFile, Verified, document_in, is_signed

Value = TypeVar("Value", Governance, Permissions)
Check: TypeAlias = Callable[[bytes], Verified]
"""Takes an S/MIME file, returns the signed content. VerificationError for a bad signature."""

_YAML_SUFFIXES = (".yaml", ".yml")
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


def signed_by(path: Path, now: datetime) -> Check:
    """A check that the permissions CA with the certificate at `path` signed a document."""
    ca = only_certificate(read(path), str(path))
    return partial(TrustAnchors(identity_cas=(), permissions_ca=ca).verified, now=now)


def governance_in(
    path: Path, check: Check | None = None, data: bytes | None = None, *, any_markup: bool = False
) -> Loaded[Governance]:
    """The governance document at `path`: XML, signed or not, or YAML; `data` is what it has.

    `any_markup`, here and below: also with markup in values, for questions, which then answer
    `readers differ`.
    """
    data = read(path) if data is None else data
    return _governance(path, data, check, any_markup=any_markup)


def permissions_in(
    path: Path,
    now: datetime,
    check: Check | None = None,
    data: bytes | None = None,
    *,
    any_markup: bool = False,
) -> Loaded[Permissions]:
    """The permissions document at `path`; durations such as `1y` in YAML count from `now`.

    `data` is what it has, if it was read before.
    """
    data = read(path) if data is None else data
    return _permissions(path, data, now, check, any_markup=any_markup)


def document_at(path: Path, now: datetime, *, any_markup: bool = False) -> Document:
    """A document of either kind. Reads `path` once, because it may be a pipe."""
    return _document(path, read(path), now, any_markup=any_markup)


def valid_kind(path: Path, now: datetime) -> tuple[Kind, tuple[Problem, ...]]:
    """The kind of the document at `path`, which is valid: XML by its schema, else its YAML.

    And why it cannot be signed all the same, as it crashes a stack, or readers differ.
    InvalidDocumentError with each problem and its line; MalformedError for another file.
    """
    data = read(path)
    if _is_yaml(path, data):
        kind = kind_of(_document(path, data, now))
    else:
        kind = validate(document_in(data) if is_signed(data) else data)
    try:
        _document(path, data, now).value.to_xml()
    except InvalidDocumentError as error:
        return kind, error.problems
    return kind, ()


def _document(path: Path, data: bytes, now: datetime, *, any_markup: bool = False) -> Document:
    with located(path):
        if _is_yaml(path, data):
            kind = Kind.PERMISSIONS if _GRANTS.search(data) else Kind.GOVERNANCE
        else:
            xml = document_in(data) if is_signed(data) else data
            kind = validate(xml, any_markup=any_markup)
    if kind is Kind.GOVERNANCE:
        return _governance(path, data, any_markup=any_markup)
    return _permissions(path, data, now, any_markup=any_markup)


def kind_of(document: Document) -> Kind:
    """Governance or permissions."""
    return Kind.GOVERNANCE if isinstance(document.value, Governance) else Kind.PERMISSIONS


def only_subject(permissions: Loaded[Permissions]) -> str:
    """The subject of all grants. UsageError if there are several subjects."""
    subjects = {grant.subject_name for grant in permissions.value.grants}
    if len(subjects) > 1:
        raise UsageError(
            f"{permissions.path} has grants for {len(subjects)} subjects",
            hint="choose one: --subject " + repr(min(subjects)),
        )
    return subjects.pop()


def _governance(
    path: Path, data: bytes, check: Check | None = None, *, any_markup: bool = False
) -> Loaded[Governance]:
    from_xml = partial(Governance.from_xml, any_markup=any_markup)
    return _loaded(path, data, check, from_xml, governance_from_yaml)


def _permissions(
    path: Path,
    data: bytes,
    now: datetime,
    check: Check | None = None,
    *,
    any_markup: bool = False,
) -> Loaded[Permissions]:
    from_xml = partial(Permissions.from_xml, any_markup=any_markup)
    return _loaded(path, data, check, from_xml, partial(permissions_from_yaml, now=now))


def _loaded(
    path: Path,
    data: bytes,
    check: Check | None,
    from_xml: Callable[[bytes], Value],
    from_yaml: Callable[[bytes], Value],
) -> Loaded[Value]:
    with located(path):
        if is_signed(data):
            found = check(data) if check else SignedFile(data)
            value = from_xml(found.document)
            return Loaded(path, value, True, check is not None, found.lines_before)  # noqa: FBT003 -- field
        if check:
            raise VerificationError("the document is not signed", code=Code.NOT_SIGNED)
        value = from_yaml(data) if _is_yaml(path, data) else from_xml(data)
        return Loaded(path, value, False, False, 0)  # noqa: FBT003 -- fields


def _is_yaml(path: Path, data: bytes) -> bool:
    """By the file suffix; without one (a pipe), by whether the data begins like XML."""
    if path.suffix:
        return path.suffix in _YAML_SUFFIXES
    return not (is_signed(data) or _XML.match(data))
