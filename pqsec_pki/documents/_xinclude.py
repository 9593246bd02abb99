"""The part of XInclude that SROS2's policies use.

An include names a file below the policy's folder, by a relative path, and the elements to
include: `xpointer(/profile/*)`. The rest of the standard is refused: it could read other files,
or the network. Files are opened here, never by libxml2.
"""

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import read, resolved
from pqsec_pki.documents._xml import XSI_LOCATIONS, parse, problem
from pqsec_pki.errors import InvalidDocumentError, located, shown

if TYPE_CHECKING:
    from lxml.etree import _Element

MAX_INCLUDES = 1000
"""Includes of one policy in total. A fleet of a hundred nodes has about 400."""
MAX_ELEMENTS = 200_000
"""Elements of a policy with its includes: a file that includes another twice doubles it."""

MAX_CHAIN = 16
"""Nested includes."""

BASE = "{http://www.w3.org/XML/1998/namespace}base"
# The second is not standard, but SROS2's own samples use it, and libxml2 accepts both.
_INCLUDES = tuple(f"{{http://www.w3.org/{year}/XInclude}}include" for year in (2001, 2003))
_ATTRIBUTES = {"href", "xpointer", "parse"}
_POINTER = re.compile(r"xpointer\(((?:/(?:[A-Za-z_][\w.-]*|\*))+)\)", re.ASCII)
_NO_RELATIVE_PATH = re.compile(r"\A\Z|\A[/\\~]|[\0%#?]|\A[A-Za-z][A-Za-z0-9+.-]*:")


def assembled(path: Path, *, root: Path | None = None) -> "_Element":
    """The root element of the file, with its includes in their places.

    Elements from another file than `path` have its name in `xml:base`, on them or on a parent.
    FileError, MalformedError, and InvalidDocumentError for includes that are not supported.
    """
    data = read(path)  # before its folder is resolved: the file may not exist
    folder = resolved(root) if root else resolved(path).parent
    return _Assembly(folder).document(path, data, (resolved(path),))


@dataclass(slots=True)
class _Assembly:
    folder: Path
    includes: int = 0
    elements: int = 0

    def document(self, path: Path, data: bytes, chain: tuple[Path, ...]) -> "_Element":
        """The file's root element, with its includes resolved; `chain` has the including files."""
        with located(path):
            root = parse(data)
            self.elements += sum(1 for _ in root.iter("*"))
            includes = list(root.iter(*_INCLUDES))
            for element in root.iter("*"):
                if BASE in element.attrib and includes:
                    raise _refused(
                        element, "has xml:base, which moves includes and is not supported"
                    )
                element.attrib.pop(BASE, "")
            for include in includes:
                self._replace(include, path, chain)
        return root

    def _replace(self, include: "_Element", path: Path, chain: tuple[Path, ...]) -> None:
        _check(include)
        target = self._target(include, path)
        if target in chain:
            raise _refused(include, f"includes {shown(target.name)} inside itself")
        if len(chain) > MAX_CHAIN:
            raise _refused(include, f"is more than {MAX_CHAIN} includes deep")
        self.includes += 1
        inside = self.document(target, read(target), (*chain, target))
        if self.includes > MAX_INCLUDES or self.elements > MAX_ELEMENTS:
            limits = f"{MAX_INCLUDES} includes, {MAX_ELEMENTS} elements"
            raise _refused(include, f"makes the policy larger than the limits: {limits}")
        for element in _selected(inside, include.get("xpointer")):
            if BASE not in element.attrib:
                element.set(BASE, str(target))
            include.addprevious(element)
        holder = include.getparent()
        if holder is not None:
            holder.remove(include)

    def _target(self, include: "_Element", path: Path) -> Path:
        href = include.get("href", "")
        if _NO_RELATIVE_PATH.search(href):
            raise _refused(include, f"href '{shown(href)}' is not a relative path")
        try:
            target = (path.resolve().parent / href).resolve(strict=True)
            is_file = target.is_file()
        except (OSError, ValueError, RuntimeError):
            raise _refused(include, f"there is no file '{shown(href)}'") from None
        if not target.is_relative_to(self.folder):
            message = f"'{shown(href)}' is outside the policy's folder {self.folder}"
            raise _refused(include, message)
        if not is_file:
            raise _refused(include, f"'{shown(href)}' is not a file")
        return target


def _check(include: "_Element") -> None:
    if unknown := sorted(set(map(str, include.attrib)) - _ATTRIBUTES - XSI_LOCATIONS):
        raise _refused(include, f"has {shown(unknown[0])}, which is not supported")
    if include.get("parse", "xml") != "xml":
        raise _refused(include, "includes a file that is not XML, which is not supported")
    pointer = include.get("xpointer")
    if pointer is not None and not _POINTER.fullmatch(pointer):
        raise _refused(include, f"'{shown(pointer)}' is not of the form xpointer(/profile/*)")
    if len(include):
        raise _refused(include, "has a fallback, which is not supported: the file must exist")
    if include.getparent() is None:
        raise _refused(include, "is the root element: it must be in an element of a policy")


def _selected(root: "_Element", pointer: str | None) -> "list[_Element]":
    """The elements at `xpointer(/a/b/*)`; without a pointer, the root."""
    found = _POINTER.fullmatch(pointer) if pointer else None
    if not found:
        return [root]
    first, *steps = found[1].split("/")[1:]
    elements = [root] if first in {"*", root.tag} else []
    for step in steps:
        elements = [child for each in elements for child in each if step in {"*", child.tag}]
    return elements


def _refused(element: "_Element", message: str) -> InvalidDocumentError:
    found = problem(element, message)
    name = "xi:include" if element.tag in _INCLUDES else found.element
    return InvalidDocumentError([replace(found, element=name)])
