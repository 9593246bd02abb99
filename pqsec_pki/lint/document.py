"""Governance and permissions documents for rules, parsed when first needed."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

from pqsec_pki.documents import (
    DomainRule,
    Governance,
    Grant,
    Node,
    Permissions,
    Tree,
    read_tree,
    validate,
)
from pqsec_pki.errors import InvalidDocumentError, PqsecError
from pqsec_pki.lint.file import Content, File
from pqsec_pki.lint.rule import Violation
from pqsec_pki.problems import Problem
from pqsec_pki.smime import lines_before_document

ACTIONS = ("publish", "subscribe", "relay")
"""What a rule of permissions allows or denies."""


@dataclass(frozen=True)
class Document(Content):
    """A governance or permissions document, unsigned or signed.

    A document that is neither has this class itself, not a subclass.
    """

    @cached_property
    def xml(self) -> bytes | None:
        """The document itself; None with `reason` if the S/MIME around it cannot be read."""
        return self.file.signed_text[0] if self.file.is_signed else self.file.data

    @cached_property
    def _first_line(self) -> int:
        """How many lines of the file are before the document."""
        if not self.file.is_signed or self.xml is None:
            return 0
        return lines_before_document(self.file.data)

    def line(self, line: int | None) -> int | None:
        """The line in the file for a line in the document."""
        return None if line is None else line + self._first_line

    @cached_property
    def _tree(self) -> tuple[Tree | None, str | None]:
        if self.xml is None:
            return None, str(self.file.signed_text[1])
        try:
            return read_tree(self.xml), None
        except PqsecError as error:
            return None, str(error)

    @property
    def tree(self) -> Tree | None:
        """The XML as a tree; None with `reason` if it is not well-formed."""
        return self._tree[0]

    @property
    def root(self) -> Node | None:
        """The root element."""
        return self.tree.root if self.tree else None

    @cached_property
    def nodes(self) -> Mapping[str, tuple[Node, ...]]:
        """All elements by their tag, in document order."""
        found: dict[str, list[Node]] = {}
        for node in self.root.walk() if self.root else ():
            found.setdefault(node.tag, []).append(node)
        return {tag: tuple(nodes) for tag, nodes in found.items()}

    def all(self, *tags: str) -> Iterator[Node]:
        """All elements with one of these tags."""
        for tag in tags:
            yield from self.nodes.get(tag, ())

    def at(self, place: Node | int | None, message: str) -> Violation:
        """A violation at an element or a line of the document."""
        return Violation(message, self.line(place.line if isinstance(place, Node) else place))

    @property
    def reason(self) -> str | None:
        """Why there is no tree; None if there is one."""
        return self._tree[1]

    @cached_property
    def problems(self) -> tuple[Problem, ...]:
        """Differences from the schema; line numbers are those of the document, not the file."""
        if self.xml is None or self.tree is None:
            return ()
        try:
            validate(self.xml)
        except InvalidDocumentError as error:
            return error.problems
        except PqsecError as error:
            return (Problem(str(error)),)
        return ()


class GovernanceFile(Document):
    """A governance document."""

    @cached_property
    def governance(self) -> Governance | None:
        """The parsed document; None if it does not match its schema."""
        try:
            return Governance.from_xml(self.xml or b"")
        except PqsecError:
            return None

    @property
    def domain_rules(self) -> tuple[DomainRule, ...]:
        """Its rules; none if it does not match its schema."""
        return self.governance.domain_rules if self.governance else ()


class PermissionsFile(Document):
    """A permissions document."""

    @cached_property
    def permissions(self) -> Permissions | None:
        """The parsed document; None if it does not match its schema."""
        try:
            return Permissions.from_xml(self.xml or b"")
        except PqsecError:
            return None

    @property
    def grants(self) -> tuple[Grant, ...]:
        """Its grants; none if it does not match its schema."""
        return self.permissions.grants if self.permissions else ()


def document_of(file: File) -> Document:
    """The document in `file`, of the subclass for its kind."""
    document = Document(file)
    root = document.root
    kinds = {"domain_access_rules": GovernanceFile, "permissions": PermissionsFile}
    for child in root.children if root and root.tag == "dds" else ():
        if child.tag in kinds:
            known = kinds[child.tag](file)
            vars(known).update(vars(document))  # keeps the cached tree
            return known
    return document
