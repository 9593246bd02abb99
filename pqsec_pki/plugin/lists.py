"""The newest revocation list of each CA that an agent has seen.

Each participant's list is a file that others write, and an older list is signed like a newer
one. Therefore the agent remembers the newest list of each CA, by number, while it runs. That
list applies to all participants of the CA, whatever their own files contain.

A list is shared only between participants that require the same signatures: a participant that
accepts a classical signature alone must not decide for one that requires both signatures.

It is not written to disk: anyone who can replace a newer list by an older one acts as the user,
and could replace the agent's file too. Across restarts the program that installs the list
protects it: `pqsec install` refuses an older one.
"""

from collections.abc import Callable
from dataclasses import field
from datetime import datetime
from typing import TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki.certificates import Certificate, RevocationList
from pqsec_pki.errors import VerificationError

MAX_CAS = 64
"""CAs whose lists are remembered; above it, the list of the least recently used CA is forgotten."""

Issuer: TypeAlias = tuple[bytes, bytes, bytes, bool]
"""A CA by its name and keys, and whether its lists need the alternative signature."""


def _alone(issuer: Issuer, own: RevocationList | None) -> RevocationList | None:
    del issuer
    return own


@dataclass(slots=True)
class NewestLists:
    """The newest lists of one agent, for all connections of a worker."""

    exchange: Callable[[Issuer, RevocationList | None], RevocationList | None] = _alone
    """Shows the agent a worker's newest list of a CA, and returns the newest of all workers."""
    _newest: dict[Issuer, RevocationList] = field(default_factory=dict)
    """CA -> list; the most recently used CA is last."""

    def newest(
        self, ca: Certificate, found: RevocationList, *, alternative: bool, now: datetime
    ) -> RevocationList:
        """`found`, or the newer list of `ca` that was found before; both are verified.

        `alternative`: whether it needs the CA's alternative signature. A list without a number,
        or that is not yet valid, is not remembered.
        """
        issuer = _issuer(ca, alternative=alternative)
        known = self._newest.pop(issuer, None)
        if known is None or is_older(known, found):
            known = found if found.number is not None and found.this_update <= now else known
        known = self.exchange(issuer, known)
        if known is not None:
            self._newest[issuer] = known
        if len(self._newest) > MAX_CAS:
            del self._newest[next(iter(self._newest))]
        return known if known is not None and is_older(found, known) else found


def is_older(one: RevocationList, other: RevocationList) -> bool:
    """Compared by number (RFC 5280 5.2.3). A list without a number is never older."""
    return one.number is not None and other.number is not None and one.number < other.number


def refusal(one: RevocationList, other: RevocationList) -> VerificationError:
    """The error for `one`, which is older than the list in force."""
    return VerificationError(
        f"revocation list {one.number} is older than list {other.number} of the same CA, which"
        " stays in force",
        hint="put the newer list back; `pqsec agent stop` makes the agent forget it",
    )


def _issuer(ca: Certificate, *, alternative: bool) -> Issuer:
    """The CA by its name and keys, which stay when its certificate is renewed."""
    second = ca.alternative_key
    return ca.subject_der, ca.spki, second.spki if second else b"", alternative
