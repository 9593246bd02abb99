"""Governance and permissions documents for rules, parsed when first needed."""

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import ClassVar

from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents import (
    DomainRule,
    Extensions,
    Governance,
    Grant,
    Kind,
    Node,
    Permissions,
    Token,
    Tree,
    read_tree,
    tokens_of,
    validate,
    with_line_feeds,
)
from pqsec_pki.errors import InvalidDocumentError, PqsecError
from pqsec_pki.lint.documents._extensions import EXTENSIONS
from pqsec_pki.lint.file import Content, File
from pqsec_pki.lint.rule import Affected, Violation
from pqsec_pki.problems import Problem
from pqsec_pki.stacks import Stack

ACTIONS = ("publish", "subscribe", "relay")
"""What a rule of permissions allows or denies."""


class ParsedText:
    """The XML of a document, parsed when first needed; files with the same text share it."""

    def __init__(self, xml: bytes) -> None:
        self.xml = with_line_feeds(xml)

    @cached_property
    def tree(self) -> tuple[Tree | None, str | None]:
        """(the tree, None), or (None, why it is not well-formed)."""
        try:
            return read_tree(self.xml), None
        except PqsecError as error:
            return None, str(error)

    @cached_property
    def nodes(self) -> Mapping[str, tuple[Node, ...]]:
        """All elements by their tag, in document order."""
        found: dict[str, list[Node]] = {}
        for node in self.tree[0].root.walk() if self.tree[0] else ():
            found.setdefault(node.tag, []).append(node)
        return {tag: tuple(nodes) for tag, nodes in found.items()}

    @cached_property
    def problems(self) -> tuple[Problem, ...]:
        """Differences from the schema, of text that is well-formed."""
        if self.permissions or self.governance:  # which are read if they are valid only
            return ()
        return self._problems(None)

    @cached_property
    def problems_beyond(self) -> Mapping[Stack, tuple[Problem, ...]]:
        """Likewise, by stacks that take more than the schema allows."""
        return {stack: self._problems(each) for stack, each in EXTENSIONS.items()}

    def _problems(self, extensions: Extensions | None) -> tuple[Problem, ...]:
        try:
            validate(self.xml, extensions)
        except InvalidDocumentError as error:
            return error.problems
        except PqsecError as error:
            return (Problem(str(error)),)
        return ()

    @cached_property
    def tokens(self) -> tuple[Token, ...]:
        """Its markup as it is written; none if it is not well-formed."""
        return tuple(tokens_of(self.xml)) if self.tree[0] else ()

    @cached_property
    def governance(self) -> Governance | None:
        """The governance; None if it does not match its schema."""
        try:
            return Governance.from_xml(self.xml)
        except PqsecError:
            return None

    @cached_property
    def permissions(self) -> Permissions | None:
        """The permissions, likewise."""
        try:
            return Permissions.from_xml(self.xml)
        except PqsecError:
            return None

    @property
    def is_plain(self) -> bool:
        """Whether it is like the permissions that pqsec writes for most participants."""
        return self.permissions is not None and self.permissions.is_plain


@dataclass(frozen=True)
class Document(Content):
    """A governance or permissions document, unsigned or signed.

    A document that is neither has this class itself, not a subclass.
    """

    kind: ClassVar[Kind | None] = None
    """Which of the two documents it is."""
    text: ParsedText | None
    """None with `reason` if the S/MIME around the document cannot be read."""

    @property
    def xml(self) -> bytes | None:
        """The document itself, with its line ends as in the file."""
        return self.file.signed_text[0] if self.file.is_signed else self.file.data

    @cached_property
    def _first_line(self) -> int:
        """How many lines of the file are before the document."""
        if not self.file.is_signed or self.text is None:
            return 0
        return self.file.signed.lines_before

    def line(self, line: int | None) -> int | None:
        """The line in the file for a line in the document."""
        return None if line is None else line + self._first_line

    @property
    def tree(self) -> Tree | None:
        """The XML as a tree; None with `reason` if it is not well-formed."""
        return self.text.tree[0] if self.text else None

    @property
    def root(self) -> Node | None:
        """The root element."""
        return self.tree.root if self.tree else None

    @property
    def nodes(self) -> Mapping[str, tuple[Node, ...]]:
        """All elements by their tag, in document order."""
        return self.text.nodes if self.text else {}

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
        return self.text.tree[1] if self.text else str(self.file.signed_text[1])

    @property
    def problems(self) -> tuple[Problem, ...]:
        """Differences from the schema; line numbers are those of the document, not the file."""
        return self.text.problems if self.text and self.tree else ()

    @property
    def taken_by(self) -> Affected:
        """The stacks that take it although it does not match the schema."""
        if not self.text or not self.problems:
            return {}
        return {stack: "" for stack, left in self.text.problems_beyond.items() if not left}

    @property
    def tokens(self) -> tuple[Token, ...]:
        """Its markup as it is written."""
        return self.text.tokens if self.text else ()


class GovernanceFile(Document):
    """A governance document."""

    kind = Kind.GOVERNANCE

    @property
    def governance(self) -> Governance | None:
        """The parsed document; None if it does not match its schema."""
        return self.text.governance if self.text else None

    @property
    def domain_rules(self) -> tuple[DomainRule, ...]:
        """Its rules; none if it does not match its schema."""
        return self.governance.domain_rules if self.governance else ()


class PermissionsFile(Document):
    """A permissions document."""

    kind = Kind.PERMISSIONS

    @property
    def permissions(self) -> Permissions | None:
        """The parsed document; None if it does not match its schema."""
        return self.text.permissions if self.text else None

    @property
    def grants(self) -> tuple[Grant, ...]:
        """Its grants; none if it does not match its schema."""
        return self.permissions.grants if self.permissions else ()


class PlainPermissions(PermissionsFile):
    """A permissions document like those that pqsec writes for most participants."""


def same_lines(one: bytes, other: bytes) -> bool:
    """Whether two documents differ in nothing but line ends, and white space around them."""
    if with_line_feeds(one) == with_line_feeds(other):  # so with those that pqsec wrote
        return True
    return one.strip().splitlines() == other.strip().splitlines()


class Documents:
    """Reads documents. A text that two files have, such as signed and unsigned, is parsed once."""

    def __init__(self) -> None:
        self._texts: dict[bytes, ParsedText] = {}

    def of(self, file: File) -> Document:
        """The document in `file`, of the subclass for its kind."""
        xml = file.signed_text[0] if file.is_signed else file.data
        text = None if xml is None else self._text(xml)
        if text and text.is_plain:
            return PlainPermissions(file, text)
        document = Document(file, text)
        root = document.root
        kinds = {"domain_access_rules": GovernanceFile, "permissions": PermissionsFile}
        for child in root.children if root and root.tag == "dds" else ():
            if child.tag in kinds:
                return kinds[child.tag](file, text)
        return document

    def _text(self, xml: bytes) -> ParsedText:
        text = ParsedText(xml)
        return self._texts.setdefault(text.xml, text)
