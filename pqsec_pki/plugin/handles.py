"""Handles: the numbers by which a stack refers to our objects."""

import secrets
from typing import Any, TypeVar

from pqsec_pki.errors import VerificationError

MAX_OBJECTS = 16384
"""Objects of one connection. A peer has an identity, and a handshake with each local
participant."""
SPARE = 256
"""Objects that are reserved for local participants."""

Kind = TypeVar("Kind")


class Handles:
    """The objects of one connection. Handles are random, so none is valid in another connection."""

    def __init__(self) -> None:
        self._objects: dict[int, Any] = {}

    @property
    def are_many(self) -> bool:
        """Whether the objects for another peer would be too many."""
        return len(self._objects) >= MAX_OBJECTS - SPARE

    def add(self, thing: Any) -> int:
        """Add the object: its handle. VerificationError if there are too many objects."""
        if len(self._objects) >= MAX_OBJECTS:
            raise VerificationError(f"more than {MAX_OBJECTS} identities and handshakes")
        handle = 1 + secrets.randbits(62)
        self._objects[handle] = thing
        return handle

    def replace(self, handle: int, thing: Any) -> None:
        """Put another object in the place of that handle's."""
        self._objects[handle] = thing

    def find(self, handle: int, kind: type[Kind]) -> Kind | None:
        """The object of that kind; None if there is none."""
        found = self._objects.get(handle)
        return found if isinstance(found, kind) else None

    def get(self, handle: int, kind: type[Kind]) -> Kind:
        """The object of that kind; VerificationError if there is none."""
        found = self.find(handle, kind)
        if found is None:
            raise VerificationError(
                "the agent does not know the handle: it may have been restarted",
                hint="create the participant again",
            )
        return found

    def drop(self, handle: int) -> Any:
        """Forget the object, and return it; None if there was none."""
        return self._objects.pop(handle, None)

    def all(self, kind: type[Kind]) -> list[tuple[int, Kind]]:
        """The objects of that kind, by handle."""
        return [(handle, each) for handle, each in self._objects.items() if isinstance(each, kind)]

    def __len__(self) -> int:
        return len(self._objects)
