"""Profiles of Fast DDS: what a participant's properties say about security."""

from collections.abc import Iterator

from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents import Node
from pqsec_pki.lint.document import Document, PlainPermissions
from pqsec_pki.lint.file import Content
from pqsec_pki.lint.rule import Violation

SECURITY = "dds.sec"


@dataclass(frozen=True, slots=True)
class ProfileProperty:
    """A property, as Fast DDS reads it: white space counts."""

    name: str
    value: str
    line: int

    @property
    def is_of_security(self) -> bool:
        """Whether it is meant for security plugins, even if its name is misspelt."""
        return self.name.strip().lower().startswith(SECURITY)


@dataclass(frozen=True, slots=True)
class ParticipantProfile:
    """The profile of a participant."""

    name: str
    line: int
    properties: tuple[ProfileProperty, ...]

    @property
    def is_secured(self) -> bool:
        """Whether it has a property of security: its author wants a secured participant."""
        return any(each.is_of_security for each in self.properties)

    def has(self, name: str) -> bool:
        """Whether it has a property with exactly that name."""
        return any(each.name == name for each in self.properties)

    def named(self, name: str) -> Iterator[ProfileProperty]:
        """The properties with exactly that name."""
        return (each for each in self.properties if each.name == name)


@dataclass(frozen=True)
class ProfileFile(Content):
    """A file of Fast DDS profiles."""

    root: Node

    @property
    def secured(self) -> Iterator[ParticipantProfile]:
        """The profiles of participants that have a property of security."""
        found = (_profile(each) for each in self.root.walk() if _local(each) == "participant")
        return (each for each in found if each.is_secured)

    def at(self, place: ProfileProperty | ParticipantProfile, message: str) -> Violation:
        """A violation at a property or a profile."""
        return Violation(message, place.line)


def profile_file_of(document: Document) -> ProfileFile | None:
    """The file of `document` as profiles, with `<profiles>` as the root or in it; else None."""
    if document.file.is_signed or isinstance(document, PlainPermissions):
        return None
    root = document.root
    if root is None:
        return None
    holders = (root, *root.children) if _local(root) == "dds" else (root,)
    if any(_local(each) == "profiles" for each in holders):
        return ProfileFile(document.file, root)
    return None


def _profile(node: Node) -> ParticipantProfile:
    properties = tuple(_property(each) for each in node.walk() if _local(each) == "property")
    return ParticipantProfile(dict(node.attributes).get("profile_name", ""), node.line, properties)


def _property(node: Node) -> ProfileProperty:
    words = {_local(each): each.text for each in node.children}
    return ProfileProperty(words.get("name", ""), words.get("value", ""), node.line)


def _local(node: Node) -> str:
    """Its tag without the namespace, which Fast DDS does not look at."""
    return node.tag.rpartition("}")[2]
