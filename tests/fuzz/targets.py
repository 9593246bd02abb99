"""What takes bytes from outside, by name.

A target gives a value or raises PqsecError. Whatever else comes out of it is a finding.
"""

from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

from pqsec_pki.errors import PqsecError
from tests.fuzz import bundles, files, messages, mutation, plugin, server


class Target(NamedTuple):
    """An entry point, real bytes that it takes, and how these are best spoilt."""

    take: Callable[[bytes], Any]
    seeds: Callable[[], list[bytes]]
    spoilt: Callable[..., bytes] = mutation.plain

    def run(self, data: bytes) -> None:
        """Whatever `data` is, this returns, or there is a finding."""
        with suppress(PqsecError):
            self.take(data)


TARGETS = {
    name: Target(*each)
    for room in (messages, files, plugin, bundles, server)
    for name, each in room.TARGETS.items()
}
