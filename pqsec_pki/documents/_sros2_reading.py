"""Reads policies of SROS2: elements become enclaves, anything else is refused."""

from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from pathlib import Path
from typing import TYPE_CHECKING

from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents import ros
from pqsec_pki.documents._reading import line, text
from pqsec_pki.documents._sros2_words import KINDS, TYPES
from pqsec_pki.documents._xinclude import BASE, assembled
from pqsec_pki.documents._xml import XSI, XSI_LOCATIONS, problem
from pqsec_pki.documents.ros import Endpoints
from pqsec_pki.errors import InvalidDocumentError, UsageError, located, shown

if TYPE_CHECKING:
    from lxml.etree import _Element

_VERSION = "0.2.0"


@dataclass(frozen=True, slots=True)
class Block:
    """The topics of one element of a profile, to publish and to subscribe to."""

    allow: bool
    topics: Endpoints


@dataclass(frozen=True, slots=True)
class PolicyProfiles:
    """One `profiles` element of an enclave; SROS2 writes a grant for each."""

    path: str
    blocks: tuple[Block, ...]
    nodes: tuple[str, ...]
    """Full names, in the order of the policy."""
    line: int | None


def read_policy(path: Path, *, root: Path | None = None) -> tuple[PolicyProfiles, ...]:
    """The enclaves of the policy, with its includes resolved.

    An include of a file outside `root` is refused; by default `root` is the policy's folder.
    FileError for files that cannot be read, InvalidDocumentError if a file is not XML
    or not a policy, and for includes that are not supported.
    """
    policy = assembled(path, root=root)
    with located(path):
        return tuple(_enclaves(policy))


def _enclaves(policy: "_Element") -> Iterator[PolicyProfiles]:
    _require(policy, "policy", {"version"})
    if policy.get("version") != _VERSION:
        raise _refused(policy, f"is not of version {_VERSION}, the only one that exists")
    enclaves, *others = _children(policy, "enclaves")
    if others:
        raise _refused(others[0], "comes twice")
    _require(enclaves, "enclaves")
    for enclave in _children(enclaves, "enclave"):
        _require(enclave, "enclave", {"path"})
        for profiles in _children(enclave, "profiles"):
            _require(profiles, "profiles", optional={"type"})
            yield _enclave(enclave, profiles)


def _enclave(enclave: "_Element", profiles: "_Element") -> PolicyProfiles:
    blocks: list[Block] = []
    nodes: list[str] = []
    first, *rest = _children(profiles, "profile", "metadata")
    if rest and rest[-1].tag == "metadata":
        rest.pop()  # the last element may have any content
    for profile in (first, *rest):
        _require(profile, "profile", {"ns", "node"})
        node = _below(profile.get("ns", ""), profile.get("node", ""))
        _check_node(profile, node)
        nodes.append(node)
        blocks.extend(_blocks(profile, node))
    return PolicyProfiles(enclave.get("path", ""), tuple(blocks), tuple(nodes), line(enclave))


def _check_node(profile: "_Element", node: str) -> None:
    try:
        ros.node_minimum(node)
    except UsageError as error:
        raise _refused(profile, str(error)) from None


def _blocks(profile: "_Element", node: str) -> Iterator[Block]:
    for element in _children(profile, *KINDS, at_least=0):
        inner, uses = KINDS[str(element.tag)]
        _require(element, str(element.tag), optional=set(uses))
        names = [_full_name(each, profile, node) for each in _children(element, inner)]
        for attribute, use in uses.items():
            qualifier = element.get(attribute)
            if qualifier not in {None, "ALLOW", "DENY"}:
                raise _refused(element, f"has {attribute}='{qualifier}', not ALLOW or DENY")
            if qualifier:
                topics = [use(name) for name in names]
                publish = tuple(topic for each in topics for topic in each.publish)
                subscribe = tuple(topic for each in topics for topic in each.subscribe)
                yield Block(qualifier == "ALLOW", Endpoints(publish, subscribe))


def _full_name(element: "_Element", profile: "_Element", node: str) -> str:
    """The name as SROS2 writes it. SROS2 does not check names; white space is refused here."""
    _require(element, str(element.tag))
    name = text(element).strip()
    if not name or len(element) or len(name.split()) > 1:
        raise _refused(element, "is not a ROS 2 name")
    if name.startswith("/"):
        return name
    if name.startswith("~"):
        return f"{node}{name[1:]}"
    return _below(profile.get("ns", ""), name)


def _below(namespace: str, name: str) -> str:
    return f"{namespace}{name}" if namespace.endswith("/") else f"{namespace}/{name}"


def _children(element: "_Element", *names: str, at_least: int = 1) -> "Iterator[_Element]":
    """The element's children, which must have these names; text between them is refused."""
    if len(element) < at_least:
        raise _refused(element, f"lacks <{names[0]}>")
    if any((piece or "").strip() for piece in [element.text, *(e.tail for e in element)]):
        raise _refused(element, "holds elements only, no text")
    for child in element:
        if child.tag not in names:
            raise _refused(
                child, f"is not expected in <{element.tag}>; expected: {', '.join(names)}"
            )
        yield child


def _require(
    element: "_Element",
    name: str,
    required: AbstractSet[str] = frozenset(),
    *,
    optional: AbstractSet[str] = frozenset(),
) -> None:
    """Check that the element has that name, the required attributes, and only optional others."""
    if element.tag != name:
        raise _refused(element, f"is not expected here; expected: {name}")
    given = set(map(str, element.attrib)) - {BASE, *XSI_LOCATIONS} - _own_type(element)
    if missing := sorted(required - given):
        raise _refused(element, f"lacks its attribute '{missing[0]}'")
    if unknown := sorted(given - required - optional):
        raise _refused(element, f"has no attribute '{shown(unknown[0])}'")


def _own_type(element: "_Element") -> set[str]:
    """The attribute xsi:type, if it is there. Only the element's type in SROS2's schema fits,
    so it changes nothing. No element may have xsi:nil.
    """
    given, known = element.get(f"{XSI}type"), TYPES[str(element.tag)]
    if given is None:
        return set()
    if given != known:
        raise _refused(element, f"has xsi:type='{shown(given)}', but its type is {known}")
    return {f"{XSI}type"}


def _refused(element: "_Element", message: str) -> InvalidDocumentError:
    """The error, with the file that contains the element."""
    error = InvalidDocumentError([problem(element, message)])
    files = (each.get(BASE) for each in (element, *element.iterancestors()))
    error.where = next((file for file in files if file), None)
    return error
